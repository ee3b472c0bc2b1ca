# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the studies share: the harness, bodies, walls, pictures, the paper's tables.

In the order of the data: paper, records, command, pages, plots, study, clock, bodies,
direct, cube, walls, compare, scaling, verification.
"""
