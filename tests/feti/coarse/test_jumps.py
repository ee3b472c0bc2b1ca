# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Stiff parts beside soft ones, and many subdomains: the coarse problem is solved with a factor."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree
from hand_torn import brick, random_values, solve

import dolfinx
import ufl

import dolfinx_feti

FORMULATIONS = {
    "primal": {"feti_formulation": "primal"},
    "Q = I": {"feti_formulation": "dual", "feti_coarse_q": "identity"},
    "Q = M": {"feti_formulation": "dual"},
}

#: Where the modulus is another one, by the cell of a grid.
PATTERNS = {
    "columns": lambda i: (i[0] % 2 == 0) & (i[1] % 2 == 0),
    "layers": lambda i: i[1] % 2 == 0,
    "channels": lambda i: (i[2] % 4 == 1) & (i[1] % 2 == 1),
    "checkerboard": lambda i: i.sum(axis=0) % 2 == 0,
}


def stiffened_cube(n, grid, pattern, jump, subdomains=None, options=FORMULATIONS["primal"]):
    """Set up a cube of n³ cells, whose modulus jumps on a grid of cubes: subdomains, or not."""
    mesh = dolfinx.mesh.create_unit_cube(COMM, n, n, n)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    E = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    place = np.floor(grid * E.function_space.tabulate_dof_coordinates().T).astype(int)
    E.x.array[:] = np.where(PATTERNS[pattern](place), jump, 1.0)[: len(E.x.array)]
    if subdomains is None:
        own = mesh.topology.index_map(3).size_local
        subdomains = np.ravel_multi_index(place[:, :own], (grid,) * 3)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    stress = ufl.sym(ufl.grad(u)) + 0.5 * ufl.div(u) * ufl.Identity(3)
    left = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 0.0))
    dofs = dolfinx.fem.locate_dofs_topological(V, 2, left)
    return dolfinx_feti.LinearProblem(
        E * ufl.inner(stress, ufl.grad(v)) * ufl.dx,
        v[2] * ufl.dx,
        bcs=[dolfinx.fem.dirichletbc(np.zeros(3), dofs, V)],
        subdomains=subdomains,
        petsc_options_prefix="jumps_",
        petsc_options=options,
    )


def solves(problem, rtol=1e-8):
    """Solve; the residual is within the tolerance, or rounding's."""
    problem.solver.setTolerances(rtol=rtol)
    problem.solve()
    context = problem.solver.getPythonContext()
    agree(context.residual <= max(1.01 * rtol, np.nan_to_num(context.floor)), context.residual)
    agree("factor" in (said := context.report().coarse_solver) or "inverse" in said, said)
    return context


@pytest.mark.processes(1, 2)
@pytest.mark.parametrize("subdomains", [None, 20], ids=["aligned", "across"])
@pytest.mark.parametrize("jump", [1e2, 1e5, 1e8])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_jumps_are_solved(pattern, jump, subdomains):
    """Rounding grows with the jump."""
    problem = stiffened_cube(6, 3 if subdomains is None else 2, pattern, jump, subdomains)
    solves(problem, max(1e-8, 1e-15 * jump))


@pytest.mark.processes(1, 2)
@pytest.mark.parametrize("options", FORMULATIONS.values(), ids=FORMULATIONS)
def test_jumps_in_every_formulation(options):
    solves(stiffened_cube(8, 4, "columns", 1e6, options=options))


@pytest.mark.processes(1, 2)
def test_many_subdomains():
    """One cell in each of 3375 subdomains."""
    problem = stiffened_cube(15, 15, "columns", 1e6)
    agree(solves(problem).report().coarse_size > 20_000)


@pytest.mark.processes(1)
def test_jumps_across_many_subdomains(torn_grid, feti):
    """A checkerboard of three by three cells on 83² subdomains of two by two."""

    def change(K, dofs):
        for n in range(len(K)):
            corner = 2 * (n // 83), 2 * (n % 83)

            def stiffness(cell, corner=corner):
                i, j = ((a + b) // 3 for a, b in zip(corner, cell, strict=True))
                return 1e8 if (i + j) % 2 else 1.0

            K[n] = brick((2, 2), 2, stiffness)[1]

    problem = torn_grid((83, 83), (2, 2), components=2, change=change)
    ksp = feti(problem.A)
    reason, _ = solve(ksp, problem, random_values(problem))
    context = ksp.getPythonContext()
    agree(reason > 0 and context.message == "", context.message)
    agree(context.residual <= max(1e-8, np.nan_to_num(context.floor)), context.residual)
    agree(context.report().coarse_size > 20_000)
