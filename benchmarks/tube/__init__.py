# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The inflated tube beside its semi-analytical solution.

In the order of the data: run, page.
"""
