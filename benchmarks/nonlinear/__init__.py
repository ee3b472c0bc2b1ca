# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's nonlinear study: iterations and seconds per Newton step.

In the order of the data: paper, rims, run, page.
"""
