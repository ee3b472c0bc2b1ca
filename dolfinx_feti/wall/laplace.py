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

#: Of PETSc's options.
PREFIX = "fibres_"

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


def solve_laplace(wall: Wall, values: Mapping[str, float]) -> dolfinx.fem.Function:
    """Solve Δu = 0 with values prescribed on some surfaces and zero flux through the others (P2).

    CG with GAMG solves to 1e-14, and MUMPS what that does not; PETSc's options with the prefix
    ``fibres_`` prevail.

    Args:
        wall: The wall.
        values: Value of u on each of these surfaces, by name.

    Raises:
        ArithmeticError: The solver did not converge.

    Note:
        Collective.
    """
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 2))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    scalar = dolfinx.default_scalar_type
    a = dolfinx.fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
    L = dolfinx.fem.form(dolfinx.fem.Constant(wall.mesh, scalar(0)) * v * ufl.dx)
    dofs = {name: dolfinx.fem.locate_dofs_topological(V, 2, facets(wall, name)) for name in values}
    bcs = [dolfinx.fem.dirichletbc(scalar(t), dofs[name], V) for name, t in values.items()]
    A = dolfinx.fem.petsc.assemble_matrix(a, bcs=bcs)
    A.assemble()
    b = dolfinx.fem.petsc.assemble_vector(L)
    dolfinx.fem.petsc.apply_lifting(b, [a], [bcs])
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    dolfinx.fem.petsc.set_bc(b, bcs)
    x, solution = A.createVecRight(), dolfinx.fem.Function(V)
    try:
        if not any((reason := _solve(A, b, x, options)) > 0 for options in (OPTIONS, DIRECT)):
            raise ArithmeticError(
                f"A Laplace problem for the fibres was not solved (reason {reason}): make sure "
                "that every part of the wall touches an opening, or choose another solver with "
                f"-{PREFIX}ksp_type and -{PREFIX}pc_type"
            )
        solution.x.array[: x.getLocalSize()] = x.array_r
    finally:
        for owned in (A, b, x):
            owned.destroy()
    solution.x.scatter_forward()
    return solution


def _solve(A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec, options: Mapping[str, object]) -> int:
    """Solve A x = b with the options, behind the user's; return PETSc's reason."""
    ksp, users = PETSc.KSP().create(A.comm), PETSc.Options(PREFIX)
    try:
        ksp.setOptionsPrefix(PREFIX)
        ksp.setOperators(A)
        with inserted(PREFIX, {k: v for k, v in options.items() if not users.hasName(k)}):
            ksp.setFromOptions()
            ksp.solve(b, x)
        return int(ksp.getConvergedReason())
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
