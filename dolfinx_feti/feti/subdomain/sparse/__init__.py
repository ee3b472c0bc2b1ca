# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Factors of the sparse blocks of the subdomains: by fronts, or with pivots.

In the order of the data: factors, schur, fronts, fronts_or_pivots, regularised,
interior.
"""
