# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The dual and the primal system and the Krylov methods that solve them.

In the order of the data: dual, recycling, stopping, primal, deflation, method.
"""
