# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The linear problem of the paper's cube: elasticity with the fundamental solution all round.

Kelvin's fundamental solution is the displacement of the whole space under a unit force at
:math:`x^*` in the direction of the first axis, and the exact solution in the cube:

.. math:: U^*_{1k}(x, x^*) = \frac{1}{8π} \frac{1}{E} \frac{1 + ν}{1 - ν} \left[
          (3 - 4ν) \frac{δ_{1k}}{|x - x^*|} +
          \frac{(x_1 - x^*_1)(x_k - x^*_k)}{|x - x^*|^3} \right], \qquad k = 1, 2, 3

(eq. 52, Augustin_eq:fundSol).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti import LinearProblem
from dolfinx_feti.runtime import compat
from meshes.cube import create_cube

__all__ = ["PATTERNS", "CubeProblem", "create_problem", "l2_error", "tear"]

YOUNG, POISSON = 210.0, 0.45

#: Degree of the quadrature that measures the error.
QUADRATURE = 6

#: Which subcubes are stiff, by their places along the three axes and their number on an edge.
PATTERNS = {
    "none": lambda place, edge: np.zeros(len(place), dtype=bool),
    "checkerboard": lambda place, edge: place.sum(axis=1) % 2 == 1,
    "layer": lambda place, edge: place[:, 2] == edge // 2,
}


@dataclass(frozen=True, slots=True)
class CubeProblem:
    """A boundary value problem: the subcube of each owned cell, (n_cells,), forms and conditions.

    ``exact`` is the fundamental solution, exact where the coefficient does not jump.
    """

    mesh: dolfinx.mesh.Mesh
    part: npt.NDArray[np.int32]
    a: ufl.Form
    L: ufl.Form
    bcs: list[dolfinx.fem.DirichletBC]
    exact: ufl.core.expr.Expr


def create_problem(
    comm: MPI.Comm,
    *,
    subdomains: int,
    cells: int,
    degree: int,
    source: Sequence[float],
    jump: float = 1.0,
    pattern: str = "none",
) -> CubeProblem:
    """Mesh the cube, of subcubes and cells in them along an edge, and write down the problem."""
    mesh, part = create_cube(comm, subdomains, cells)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    mu = YOUNG / (2 * (1 + POISSON))
    lmbda = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    energy = 2 * mu * ufl.inner(_strain(u), _strain(v)) + lmbda * ufl.div(u) * ufl.div(v)
    if pattern != "none":
        place = np.column_stack(np.unravel_index(part, (subdomains,) * 3))
        factor = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
        own = factor.function_space.dofmap.list[: len(part), 0]
        factor.x.array[own] = np.where(PATTERNS[pattern](place, subdomains), jump, 1.0)
        energy = factor * energy
    zero = dolfinx.fem.Constant(mesh, np.zeros(3))
    exact = _fundamental_solution(mesh, source)
    values = dolfinx.fem.Function(V)
    values.interpolate(dolfinx.fem.Expression(exact, compat.interpolation_points(V)))
    mesh.topology.create_connectivity(2, 3)
    surface = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    dofs = dolfinx.fem.locate_dofs_topological(V, 2, surface)
    return CubeProblem(
        mesh=mesh,
        part=part,
        a=energy * ufl.dx,
        L=ufl.inner(zero, v) * ufl.dx,
        bcs=[dolfinx.fem.dirichletbc(values, dofs)],
        exact=exact,
    )


def tear(problem: CubeProblem, options: dict[str, object]) -> LinearProblem:
    """Tear a problem into its subcubes. Collective."""
    return LinearProblem(
        problem.a,
        problem.L,
        bcs=problem.bcs,
        subdomains=problem.part,
        petsc_options_prefix="cube_",
        petsc_options=options,
    )


def l2_error(u_h: dolfinx.fem.Function, u: ufl.core.expr.Expr) -> float:
    """Return the norm of the error, ‖u − u_h‖ in L₂ (eq. 53). Collective."""
    difference = u_h - u
    dx = ufl.dx(metadata={"quadrature_degree": QUADRATURE})
    square = dolfinx.fem.assemble_scalar(dolfinx.fem.form(ufl.inner(difference, difference) * dx))
    return float(np.sqrt(u_h.function_space.mesh.comm.allreduce(square, op=MPI.SUM)))


def _strain(u: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
    """Return the linearised strain (eq. 19)."""
    return ufl.sym(ufl.grad(u))


def _fundamental_solution(mesh: dolfinx.mesh.Mesh, source: Sequence[float]) -> ufl.core.expr.Expr:
    d = ufl.SpatialCoordinate(mesh) - ufl.as_vector([float(c) for c in source])
    r = ufl.sqrt(ufl.dot(d, d))
    scale = (1 + POISSON) / (8 * np.pi * YOUNG * (1 - POISSON))
    direction = ufl.as_vector([1.0, 0.0, 0.0])
    return scale * ((3 - 4 * POISSON) * direction / r + d[0] * d / r**3)
