# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Gluing: which dofs have copies, their jumps, and the weights of the copies.

In the order of the data: copies, jump, bodies.
"""
