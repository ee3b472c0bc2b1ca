# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Classical and all-floating FETI methods for FEniCSx.

In the order of the data: errors, runtime, torn, mechanics, workshop, wall, fem, feti,
diagnosis, problems, loading, output, comparison.
"""

from dolfinx_feti.comparison.run import compare
from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.feti import FETI
from dolfinx_feti.mechanics import kinematics, loads, materials, supports
from dolfinx_feti.problems.linear_problem import LinearProblem
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.runtime.scotch import repeat_partitions
from dolfinx_feti.torn.matrix import create_torn_matrix, set_near_kernel

__version__ = "0.2.0"
__all__ = [
    "FETI",
    "ConvergenceError",
    "LinearProblem",
    "NonlinearProblem",
    "compare",
    "create_torn_matrix",
    "kinematics",
    "loads",
    "materials",
    "set_near_kernel",
    "supports",
]

repeat_partitions()
