# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Classical and all-floating FETI methods for FEniCSx."""

from dolfinx_feti.feti import FETI
from dolfinx_feti.nonlinear_problem import NonlinearProblem
from dolfinx_feti.problem import ConvergenceError, LinearProblem
from dolfinx_feti.torn import create_torn_matrix, set_near_kernel

__version__ = "0.1.0"
__all__ = [
    "FETI",
    "ConvergenceError",
    "LinearProblem",
    "NonlinearProblem",
    "create_torn_matrix",
    "set_near_kernel",
]
