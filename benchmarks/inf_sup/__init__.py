# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which pairs of elements for displacement and pressure are stable: their inf-sup constants.

In the order of the data: run, page.
"""
