# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the studies share: command lines, records, the machine, bodies, pages and pictures.

In the order of the data: machine, records, command, clock, bodies, cube, walls,
pages, plots.
"""
