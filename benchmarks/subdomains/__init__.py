# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""How many subdomains: the time of a linear solve over their size.

In the order of the data: run, page.
"""
