# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cell integrals of eight cells at a time.

In the order of the data: tape, integrand, program, kernel.
"""
