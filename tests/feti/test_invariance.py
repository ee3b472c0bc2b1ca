# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The same solution on any number of processes and with any number of subdomains."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from collective import COMM, agree, equal, whole
from problems import Cell, cube, elasticity, owned, poisson

import dolfinx_feti

PROBLEMS = {
    "elasticity": (elasticity, (3, 4, Cell.tetrahedron), {"stretched": True}),
    "quadratic elasticity": (elasticity, (2, 6, Cell.triangle), {"degree": 2}),
    "hexahedra": (elasticity, (3, 4, Cell.hexahedron), {}),
    "Poisson": (poisson, (2, 8, Cell.quadrilateral), {"degree": 2, "stretched": True}),
}
every_problem = pytest.mark.parametrize("problem", PROBLEMS.values(), ids=PROBLEMS)
every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])


def by_place(V, values):
    """Values sorted by the coordinates of their nodes, (nodes, bs)."""
    n, bs = V.dofmap.index_map.size_local, V.dofmap.index_map_bs
    x = V.tabulate_dof_coordinates()[:n]
    both = x, values.reshape(n, bs)
    if V.mesh.comm.size > 1:
        both = whole(both[0]), whole(both[1])
    return both[1][np.lexsort(np.round(both[0], 6).T)]


@every_problem
@every_type
def test_solution_does_not_depend_on_the_decomposition(problem, kind, solve):
    """1, 4 and 64 subdomains, against a direct solve of the whole problem on each process."""
    create, mesh, options = problem
    alone = create(cube(*mesh, comm=MPI.COMM_SELF), **options)
    expected = by_place(alone.V, alone.solve_directly())
    together = create(cube(*mesh), **options)
    for subdomains in (1, 4, 64):
        linear = solve(together, subdomains, {"feti_type": kind, "ksp_rtol": 1e-11})
        equal(by_place(together.V, owned(linear.u)), expected, 1e-8)
        report = linear.solver.getPythonContext().report()
        agree(report.subdomains >= max(subdomains, COMM.size))


def test_process_alone_solves_its_own_problem(solve):
    """On MPI.COMM_SELF nothing is collective on the world: each process has other subdomains."""
    problem = elasticity(cube(2, 5, comm=MPI.COMM_SELF), stretched=True)
    linear = dolfinx_feti.LinearProblem(
        problem.a,
        problem.L,
        bcs=problem.bcs,
        subdomains=3 + COMM.rank,
        petsc_options_prefix=f"process{COMM.rank}_",
        petsc_options={"ksp_rtol": 1e-11},
    )
    linear.solve()
    expected = problem.solve_directly()
    error = np.abs(owned(linear.u) - expected).max() / np.abs(expected).max()
    agree(error < 1e-8, error)
    agree(linear.solver.getPythonContext().report().subdomains == 3 + COMM.rank)


def test_same_solution_at_the_default_tolerance(solve):
    """The assembled residual is the judge: all choices end within the same error."""
    problem = elasticity(cube(2, 8), stretched=True)
    expected = whole(problem.solve_directly())
    for options in (
        {},
        {"feti_type": "classical", "feti_pc_type": "lumped"},
        {"feti_pc_type": "identity", "feti_coarse_q": "identity"},
        {"feti_dual_ksp_type": "gmres"},
    ):
        linear = solve(problem, 8, options)
        agree(linear.solver.getPythonContext().residual <= 1e-8)
        equal(whole(owned(linear.u)), expected, 1e-6)
