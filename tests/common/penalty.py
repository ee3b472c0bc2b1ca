# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Loads that hide an error from the residual: stiff springs, Nitsche's terms, masses, jumps.

A bar of length 3 is clamped at x = 0. Its far end is to follow a displacement g, which a penalty k
enforces; a body force is E/250 per volume. E is Young's modulus.
"""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from collective import lu_solve
from problems import Problem, dirichlet, left, tagged

import dolfinx
import ufl

from dolfinx_feti.comparison import assembled_system

Array = npt.NDArray[np.float64]
COMM = MPI.COMM_WORLD
LENGTH = 3.0
YOUNG = 5.0
POISSON = 0.25


def far(x: Array) -> npt.NDArray[np.bool_]:
    """Mark the far end."""
    return np.isclose(x[0], LENGTH)


def bar_mesh(
    dim: int, cell: dolfinx.mesh.CellType | None = None, cells: int = 4
) -> dolfinx.mesh.Mesh:
    """Mesh the bar with so many cells across, and twice as many along each unit of length."""
    corners = [np.zeros(dim), np.array([LENGTH, *[1.0] * (dim - 1)])]
    along = 3 * cells if dim == 3 else 6 * cells
    if dim == 2:
        kind = cell or dolfinx.mesh.CellType.triangle
        return dolfinx.mesh.create_rectangle(COMM, corners, (along, 2 * cells), kind)
    kind = cell or dolfinx.mesh.CellType.tetrahedron
    return dolfinx.mesh.create_box(COMM, corners, (along, cells, cells), kind)


def _stress(u: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
    mu = YOUNG / (2 * (1 + POISSON))
    lmbda = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    e = ufl.sym(ufl.grad(u))
    return 2 * mu * e + lmbda * ufl.tr(e) * ufl.Identity(len(u))


def _given(x: ufl.SpatialCoordinate, dim: int) -> ufl.core.expr.Expr:
    """Return g, the displacement that the far end is to follow, (dim,)."""
    return ufl.as_vector([0.15, 0.1 * x[1] - 0.2, 0.05][:dim])


def _bar(
    mesh: dolfinx.mesh.Mesh, degree: int, end: Callable[..., tuple[ufl.Form, ufl.Form]]
) -> Problem:
    """Set up the bar with what ``end(u, v, ds)`` adds to both forms."""
    dim = mesh.geometry.dim
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    a, L = end(u, v, tagged(mesh, far)(1))
    a += ufl.inner(_stress(u), ufl.grad(v)) * ufl.dx
    L -= YOUNG / 250 * v[1] * ufl.dx
    return Problem(V, a, L, [dirichlet(V, left)])


def spring_bar(mesh: dolfinx.mesh.Mesh, ratio: float, degree: int = 1) -> Problem:
    """Hold the far end by springs of the stiffness k = ratio E."""

    def end(u, v, ds):
        g = _given(ufl.SpatialCoordinate(mesh), len(u))
        return ratio * YOUNG * ufl.inner(u, v) * ds, ratio * YOUNG * ufl.inner(g, v) * ds

    return _bar(mesh, degree, end)


def nitsche_bar(mesh: dolfinx.mesh.Mesh, ratio: float, degree: int = 1) -> Problem:
    """Impose g by Nitsche's symmetric method with α = ratio."""

    def end(u, v, ds):
        g = _given(ufl.SpatialCoordinate(mesh), len(u))
        n = ufl.FacetNormal(mesh)
        k = ratio * YOUNG / ufl.CellDiameter(mesh)
        a = k * ufl.inner(u, v) - ufl.inner(_stress(u) * n, v) - ufl.inner(_stress(v) * n, u)
        return a * ds, (k * ufl.inner(g, v) - ufl.inner(_stress(v) * n, g)) * ds

    return _bar(mesh, degree, end)


def heavy_bar(mesh: dolfinx.mesh.Mesh, ratio: float, degree: int = 1) -> Problem:
    """Add the mass of a short time step in the outer half, ρ/Δt² = ratio E, and its load."""

    def end(u, v, ds):
        x = ufl.SpatialCoordinate(mesh)
        mass = ratio * YOUNG * ufl.conditional(ufl.gt(x[0], LENGTH / 2), 1.0, 0.0)
        g = _given(x, len(u))
        return mass * ufl.inner(u, v) * ufl.dx, mass * ufl.inner(g, v) * ufl.dx

    return _bar(mesh, degree, end)


def jump_bar(mesh: dolfinx.mesh.Mesh, ratio: float, degree: int = 1) -> Problem:
    """Make the outer half stiffer by a ratio; a traction at the far end grows with it."""

    def end(u, v, ds):
        x = ufl.SpatialCoordinate(mesh)
        more = (ratio - 1.0) * ufl.conditional(ufl.gt(x[0], LENGTH / 2), 1.0, 0.0)
        a = more * ufl.inner(_stress(u), ufl.grad(v)) * ufl.dx
        return a, ratio * YOUNG / 50 * v[1] * ds

    return _bar(mesh, degree, end)


def direct_solution(problem: object) -> Array:
    """Solve a torn problem's system with MUMPS, refined once; return the owned values."""
    A, b = problem.linear_system()
    K, f = assembled_system(A, b)
    x = lu_solve(K, f)
    for owned in (K, f, b):
        owned.destroy()
    return x


def greatest(x: Array) -> float:
    """Return max |x| over all processes."""
    return COMM.allreduce(float(np.abs(x).max(initial=0.0)), op=MPI.MAX)


def off_by(x: Array, exact: Array) -> float:
    """Return max |x − exact| over max |exact|."""
    return greatest(x - exact) / greatest(exact)
