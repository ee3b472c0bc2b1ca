# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Classical and all-floating FETI for a torn matrix; knows PETSc, and no finite elements.

In the order of the data: options, solution, gluing, subdomain, coarse, regularity,
pattern, setup, dual, primal, lasting, report, solver, bordered.
"""

from dolfinx_feti.feti.solver import FETI

__all__ = ["FETI"]
