# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Laplace problems between surfaces of a wall, and the gradients of their solutions in the cells.

Δu = 0,   u given on some named surfaces,   ∂u/∂n = 0 on all others.
"""

from __future__ import annotations

from collections.abc import Mapping

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti.runtime.compat import interpolation_points
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.wall.wall import Wall, facets

__all__ = ["gradient", "solve_laplace"]

# Solved to rounding, so that a nearly flat potential (in a sac) has a consistent direction.
# Without couplings below the threshold in its aggregates GAMG takes two thirds of the time.
OPTIONS: dict[str, object] = {
    "ksp_type": "cg",
    "ksp_rtol": 1e-14,
    "ksp_max_it": 1000,
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.03,
}

# Where that fails, as it does on meshes with slivers.
DIRECT: dict[str, object] = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
}


def solve_laplace(
    wall: Wall,
    values: Mapping[str, float],
    *,
    prefix: str,
    petsc_options: Mapping[str, object] | None = None,
) -> dolfinx.fem.Function:
    """Solve Δu = 0 with values prescribed on some surfaces and zero flux through the others.

    Args:
        wall: The wall.
        values: Value of u on each of these surfaces, by name.
        prefix: Prefix of the solver, the same on all processes.
        petsc_options: Its options, without prefix, which override CG with GAMG to 1e-14. Without
            them MUMPS solves what CG does not.

    Raises:
        ArithmeticError: The solver did not converge.

    Note:
        Collective.
    """
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 2))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = dolfinx.fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
    L = dolfinx.fem.form(
        dolfinx.fem.Constant(wall.mesh, dolfinx.default_scalar_type(0)) * v * ufl.dx
    )
    bcs = [
        dolfinx.fem.dirichletbc(
            dolfinx.default_scalar_type(value),
            dolfinx.fem.locate_dofs_topological(V, 2, facets(wall, name)),
            V,
        )
        for name, value in values.items()
    ]
    A = dolfinx.fem.petsc.assemble_matrix(a, bcs=bcs)
    A.assemble()
    b = dolfinx.fem.petsc.assemble_vector(L)
    dolfinx.fem.petsc.apply_lifting(b, [a], [bcs])
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    dolfinx.fem.petsc.set_bc(b, bcs)
    solution = dolfinx.fem.Function(V)
    x = A.createVecRight()
    attempts = [{**OPTIONS, **petsc_options}] if petsc_options else [OPTIONS, DIRECT]
    try:
        for options in attempts:
            reason, iterations = _solve(A, b, x, prefix, options)
            if reason > 0:
                break
        else:
            raise ArithmeticError(
                f"A Laplace problem for the fibres was not solved (reason {reason} after "
                f"{iterations} iterations): make sure that every part of the wall touches an "
                f"opening, or choose another solver with -{prefix}ksp_type and -{prefix}pc_type"
            )
        solution.x.array[: x.getLocalSize()] = x.array_r
    finally:
        for owned in (A, b, x):
            owned.destroy()
    solution.x.scatter_forward()
    return solution


def _solve(
    A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec, prefix: str, options: Mapping[str, object]
) -> tuple[int, int]:
    """Solve A x = b with the options under the prefix; return PETSc's reason and iterations."""
    ksp = PETSc.KSP().create(A.comm)
    try:
        ksp.setOptionsPrefix(prefix)
        ksp.setOperators(A)
        with inserted(prefix, options):
            ksp.setFromOptions()
            ksp.solve(b, x)
        return ksp.getConvergedReason(), ksp.getIterationNumber()
    finally:
        ksp.destroy()


def gradient(u: dolfinx.fem.Function) -> npt.NDArray[np.float64]:
    """Return ∇u at the centroids of the local cells, (cells, 3), or (cells, 3, 3) of a vector."""
    shape = (*u.ufl_shape, 3)
    W = dolfinx.fem.functionspace(u.function_space.mesh, ("DG", 0, shape))
    g = dolfinx.fem.Function(W)
    g.interpolate(dolfinx.fem.Expression(ufl.grad(u), interpolation_points(W)))
    g.x.scatter_forward()
    return np.asarray(g.x.array.reshape(-1, *shape))
