# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Classical and all-floating FETI methods for FEniCSx.

In the order of the data: errors, text_tables, runtime, torn, mechanics, workshop, wall, meshes,
fem, feti, diagnosis, scalars, contact, problems, loading, output, comparison.
"""

try:
    # First: the dolfinx of pip's wheels finds the MPI library that mpi4py has loaded.
    from mpi4py import MPI  # noqa: F401
    from petsc4py import PETSc  # noqa: F401

    import dolfinx  # noqa: F401
except (ImportError, RuntimeError, OSError) as error:  # mpi4py: RuntimeError without an MPI library
    import sys

    raise ImportError(
        "dolfinx_feti needs dolfinx 0.9 to 0.11 with petsc4py, and an MPI library "
        f"({error}). Any of these will do:\n"
        '  pip, Python >= 3.12, Linux   pip install ".[wheel]"   in a checkout of dolfinx_feti '
        f"(this is Python {sys.version_info.major}.{sys.version_info.minor})\n"
        "  conda                        conda install -c conda-forge fenics-dolfinx petsc4py\n"
        "  Docker                       docker run -it dolfinx/dolfinx:stable\n"
        "  Debian >= 13, Ubuntu         sudo apt install python3-dolfinx"
    ) from error

from dolfinx_feti.comparison import compare
from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.feti import FETI
from dolfinx_feti.mechanics import kinematics, loads, materials, supports
from dolfinx_feti.problems.linear_problem import LinearProblem
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.torn.matrix import create_torn_matrix, set_condensed_pressures, set_near_kernel

__version__ = "0.1.0"
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
    "set_condensed_pressures",
    "set_near_kernel",
    "supports",
]
