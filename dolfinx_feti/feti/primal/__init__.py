# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The primal form: conjugate gradients, or GMRES, on the assembled interface.

In the order of the data: assembled, adaptive, deflation, krylov, form.
"""
