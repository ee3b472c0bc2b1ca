# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Walls that nobody has seen, from a generator with seeds, loaded with the defaults.

In the order of the data: lumen, run, page.
"""
