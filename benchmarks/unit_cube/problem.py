# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The linear problem of the paper's cube: elasticity with the fundamental solution all round."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from benchmarks.unit_cube.fundamental import POISSON, YOUNG, boundary_values, fundamental_solution
from meshes.cube import create_cube

__all__ = ["PATTERNS", "CubeProblem", "create_problem"]

#: Which subcubes are stiff, by their places along the three axes and their number on an edge.
PATTERNS = {
    "none": lambda place, edge: np.zeros(len(place), dtype=bool),
    "checkerboard": lambda place, edge: place.sum(axis=1) % 2 == 1,
    "layer": lambda place, edge: place[:, 2] == edge // 2,
}


@dataclass(frozen=True, slots=True)
class CubeProblem:
    """A boundary value problem on the cube.

    Attributes:
        part: Subcube of each owned cell, (n_cells,).
        a: Bilinear form.
        L: Linear form, zero.
        bcs: The nodal values of ``exact`` on the surface.
        exact: The fundamental solution, exact where the coefficient does not jump.
    """

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
    """Mesh the cube and write down the problem.

    Args:
        comm: Communicator of the mesh.
        subdomains: Subcubes along an edge.
        cells: Cells along an edge of a subcube.
        degree: Of the displacements.
        source: Source point of the fundamental solution.
        jump: Young's modulus of the stiff subcubes in units of the others'.
        pattern: Which they are, see :data:`PATTERNS`.

    Note:
        Collective.
    """
    mesh, part = create_cube(comm, subdomains, cells)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    mu = YOUNG / (2 * (1 + POISSON))
    lmbda = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    energy = 2 * mu * ufl.inner(_strain(u), _strain(v)) + lmbda * ufl.div(u) * ufl.div(v)
    if pattern != "none":
        energy = _stiffness(mesh, part, subdomains, jump, pattern) * energy
    zero = dolfinx.fem.Constant(mesh, np.zeros(3))
    exact = fundamental_solution(mesh, source)
    return CubeProblem(
        part=part,
        a=energy * ufl.dx,
        L=ufl.inner(zero, v) * ufl.dx,
        bcs=[boundary_values(V, exact)],
        exact=exact,
    )


def _strain(u: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
    """Return the linearised strain (eq. 19)."""
    return ufl.sym(ufl.grad(u))


def _stiffness(
    mesh: dolfinx.mesh.Mesh,
    part: npt.NDArray[np.int32],
    subdomains: int,
    jump: float,
    pattern: str,
) -> dolfinx.fem.Function:
    """Return the factor of Young's modulus, piecewise constant."""
    place = np.column_stack(np.unravel_index(part, (subdomains,) * 3))
    factor = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    cells = factor.function_space.dofmap.list[: len(part), 0]
    factor.x.array[cells] = np.where(PATTERNS[pattern](place, subdomains), jump, 1.0)
    return factor
