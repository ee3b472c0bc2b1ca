# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the nonlinear study: tables beside the paper's, what holds here, and the picture.

In the order of the data: paper, groups, statements, tables, plots.
"""
