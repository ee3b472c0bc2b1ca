# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's linear study: elasticity on the unit cube, torn into subcubes.

In the order of the data: paper, memory, case, study, plan, solvers, run, page.
"""
