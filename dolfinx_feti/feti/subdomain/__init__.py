# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One subdomain alone: its matrix, its kernel, its generalised inverse.

In the order of the data: panels, blocks, orthonormal, factors, modes, nullspace, analysis,
operator, soft, pseudoinverse.
"""
