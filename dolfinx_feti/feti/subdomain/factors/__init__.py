# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Factors of a block of one subdomain: dense, front by front, with pivots.

In the order of the data: protocol, direct, dense, pivoted, multifrontal, regularised.
"""
