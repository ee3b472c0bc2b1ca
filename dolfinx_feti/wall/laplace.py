# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Laplace problems on a wall, and gradients of their solutions.

PETSc's options with the prefix ``fibres_`` override those of the solver, also for the potentials of
``opening_angles``.
"""

from __future__ import annotations

from collections.abc import Mapping

from petsc4py import PETSc

import numpy as np

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.compat import interpolation_points
from dolfinx_feti.runtime.petsc_options import inserted
from dolfinx_feti.wall.wall import Wall, facets

__all__ = ["gradient", "solve_laplace"]

#: Prefix of PETSc's options.
PREFIX = "fibres_"

#: Options of the first solver. It solves to rounding accuracy, so that a potential that is nearly
#: constant, as in a sac, has a gradient. The threshold saves a third of the time of GAMG.
CG_OPTIONS: dict[str, object] = {
    "ksp_type": "cg",
    "ksp_rtol": 1e-14,
    "ksp_max_it": 1000,
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.03,
}

#: Options of the second solver, if the first one fails, as on meshes with slivers.
DIRECT_OPTIONS: dict[str, object] = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
}


def solve_laplace(wall: Wall, values: Mapping[str, float]) -> dolfinx.fem.Function:
    """Solve Δu = 0 with values on surfaces and zero flux through all others (P2). Collective.

    The solver is CG with GAMG, to 1e-14, and MUMPS if it fails. PETSc's options with the prefix
    ``fibres_`` override both.

    Args:
        wall: The wall.
        values: The value on each surface, by name.

    Raises:
        ArithmeticError: Both solvers fail.
    """
    V = dolfinx.fem.functionspace(wall.mesh, ("Lagrange", 2))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    scalar = dolfinx.default_scalar_type
    a = dolfinx.fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
    zero = dolfinx.fem.Constant(wall.mesh, scalar(0))  # dolfinx needs a right-hand side for lifting
    L = dolfinx.fem.form(zero * v * ufl.dx)
    dofs = {name: dolfinx.fem.locate_dofs_topological(V, 2, facets(wall, name)) for name in values}
    bcs = [dolfinx.fem.dirichletbc(scalar(t), dofs[name], V) for name, t in values.items()]
    A = dolfinx.fem.petsc.assemble_matrix(a, bcs=bcs)
    A.assemble()
    b = dolfinx.fem.petsc.assemble_vector(L)
    dolfinx.fem.petsc.apply_lifting(b, [a], [bcs])
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    dolfinx.fem.petsc.set_bc(b, bcs)
    x = A.createVecRight()
    solution = dolfinx.fem.Function(V)
    try:
        reason = _solve(A, b, x, CG_OPTIONS)
        if reason <= 0:
            reason = _solve(A, b, x, DIRECT_OPTIONS)
        if reason <= 0:
            raise ArithmeticError(
                f"A Laplace problem for the fibres was not solved (reason {reason}). If a "
                "part of the wall touches neither of two surfaces with values, it is singular: "
                f"check the tags. Otherwise choose another solver by -{PREFIX}ksp_type"
            )
        solution.x.array[: x.getLocalSize()] = x.array_r
    finally:
        for petsc_object in (A, b, x):
            petsc_object.destroy()
    solution.x.scatter_forward()
    return solution


def _solve(A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec, options: Mapping[str, object]) -> int:
    """Solve A x = b; return PETSc's converged reason.

    Args:
        A: Matrix.
        b: Right-hand side.
        x: The solution.
        options: Options of the solver; those of the user override them.
    """
    ksp = PETSc.KSP().create(A.comm)
    of_user = PETSc.Options(PREFIX)
    defaults = {key: value for key, value in options.items() if not of_user.hasName(key)}
    try:
        ksp.setOptionsPrefix(PREFIX)
        ksp.setOperators(A)
        with inserted(PREFIX, defaults):
            ksp.setFromOptions()
            ksp.solve(b, x)
        return int(ksp.getConvergedReason())
    finally:
        ksp.destroy()


def gradient(u: dolfinx.fem.Function) -> Array:
    """Return ∇u at the centroids of the local cells, (cells, 3), or (cells, 3, 3) of a vector."""
    shape = (*u.ufl_shape, 3)
    W = dolfinx.fem.functionspace(u.function_space.mesh, ("DG", 0, shape))
    g = dolfinx.fem.Function(W)
    g.interpolate(dolfinx.fem.Expression(ufl.grad(u), interpolation_points(W)))
    g.x.scatter_forward()
    return np.asarray(g.x.array.reshape(-1, *shape))
