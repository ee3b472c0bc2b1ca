# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The dual form: multipliers, the paper's method.

In the order of the data: preconditioner, coarse, system, krylov, form.
"""
