# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Preconditioners of the dual operator: identity, lumped, Dirichlet.

In the order of the data: base, identity, lumped, dirichlet.
"""
