# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The dual system and the Krylov methods that solve it.

In the order of the data: dual, recycling, stopping, method, primal.
"""
