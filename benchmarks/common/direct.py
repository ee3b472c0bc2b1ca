# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Newton's method of dolfinx with MUMPS: a reference that shares no solver with this package."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from functools import partial

from petsc4py import PETSc

import dolfinx
import dolfinx.fem.petsc
import dolfinx.nls.petsc
import ufl

#: PETSc's options for a direct solver.
MUMPS = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}


def create_newton(
    F: ufl.Form,
    u: dolfinx.fem.Function,
    bcs: Sequence[dolfinx.fem.DirichletBC],
    *,
    rtol: float = 1e-9,
) -> Callable[[], object]:
    """Return a function that solves F(u) = 0 by dolfinx's Newton solver. Collective.

    The function raises a RuntimeError or a PETSc.Error, depending on the version of dolfinx, if
    Newton's method does not converge.

    Args:
        F: Residual.
        u: Unknown, which has the first guess.
        bcs: Dirichlet conditions.
        rtol: Relative tolerance of the residual.
    """
    own = dolfinx.fem.petsc.NonlinearProblem  # since dolfinx 0.10 it has a SNES
    if hasattr(dolfinx.fem.petsc, "NewtonSolverNonlinearProblem"):
        options = {"snes_rtol": rtol, "snes_linesearch_type": "none", **MUMPS}
        options |= {"snes_error_if_not_converged": True}
        prefix = f"direct_{random.randrange(10**9)}_"
        solve = own(F, u, bcs=bcs, petsc_options_prefix=prefix, petsc_options=options).solve
        for name in options:  # dolfinx leaves them in the global database
            PETSc.Options(prefix).delValue(name)
        return solve
    newton = dolfinx.nls.petsc.NewtonSolver(u.function_space.mesh.comm, own(F, u, list(bcs)))
    newton.rtol = rtol
    newton.krylov_solver.setType("preonly")
    newton.krylov_solver.getPC().setType("lu")
    newton.krylov_solver.getPC().setFactorSolverType("mumps")
    for name in ("ksp_type", "pc_type"):
        PETSc.Options("nls_solve_").delValue(name)
    return partial(newton.solve, u)
