# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The comparison of speed: a load path with FETI and MUMPS, and the page with all solvers.

In the order of the data: phases, path, groups, statements, tables, plots.
"""
