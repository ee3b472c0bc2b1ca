# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One subdomain at a time: its matrix, its factors, its kernel, its generalised inverse.

In the order of the data: blocks, direct, dense, sparse, kernel, nullspace, elimination, matrices,
enrichment, modes, pseudoinverse.
"""
