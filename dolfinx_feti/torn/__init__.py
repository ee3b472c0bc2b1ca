# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The torn matrix, which finite elements hand over to the solver, and what is known of it at once.

In the order of the data: matrix, rounding, null_space.
"""
