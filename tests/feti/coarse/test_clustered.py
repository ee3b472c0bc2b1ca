# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The third level: conjugate gradients on clusters of subdomains in place of a factor."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, dense, equal, norm, small, whole
from hand_torn import brick, random_values, softened, solve

import dolfinx
import ufl

import dolfinx_feti
from dolfinx_feti.feti.coarse import clustered
from dolfinx_feti.feti.coarse.clustered import (
    LARGE,
    TOLERANCE,
    ClusteredSolver,
    number_of_clusters,
    takes_clusters,
)
from dolfinx_feti.feti.coarse.gathered import GatheredSolver
from dolfinx_feti.runtime.petsc_options import inserted

pytestmark = pytest.mark.processes(1, 2, 3, 4, 8)

GRID = {"subdomains": (6, 5), "cells": (3, 3), "components": 2}
LAST = COMM.rank == COMM.size - 1

#: With Q = M the dual form has one coarse solve an iteration, else two.
FORMS = {
    "Q = I": {"feti_formulation": "dual", "feti_coarse_q": "identity"},
    "Q = M": {"feti_formulation": "dual"},
    "primal": {"feti_formulation": "primal"},
}


@pytest.fixture
def large(monkeypatch):
    """Take every coarse matrix for a large one, and make several clusters of it."""
    monkeypatch.setattr(clustered, "LARGE", 0)
    monkeypatch.setattr(clustered, "HUGE", 0)
    monkeypatch.setattr(clustered, "MOST", 8)


@pytest.mark.parametrize("options", FORMS.values(), ids=FORMS)
def test_outer_iterations_are_those_of_an_exact_solve(options, torn_grid, feti, monkeypatch):
    problem = torn_grid(**GRID)
    values, found = random_values(problem), []
    for rows in (20_000, 0):
        monkeypatch.setattr(clustered, "LARGE", rows)
        monkeypatch.setattr(clustered, "HUGE", rows)
        monkeypatch.setattr(clustered, "MOST", 8)
        ksp = feti(problem.A, ksp_rtol=1e-8, **options)
        reason, x = solve(ksp, problem, values)
        agree(reason > 0, ksp.getPythonContext().message)
        found.append((ksp.getPythonContext().iterations, x))
        agree(("clusters" in ksp.getPythonContext().report().coarse_solver) == (rows == 0))
    (exact, x), (its, x_clusters) = found
    agree(its <= 1.15 * exact, found)
    equal(x_clusters, x, 1e-6)


def test_stiff_subdomains_and_further_columns(torn_grid, feti, monkeypatch):
    """Every other one 1e6 times as stiff, with columns beside the rigid motions."""

    def stiffen(K, dofs):
        for i, K_i in enumerate(K):
            K_i *= 1e6 if i % 2 else 1.0

    problem = torn_grid(**GRID, change=stiffen)
    values, found = random_values(problem), []
    for rows in (20_000, 0):
        monkeypatch.setattr(clustered, "LARGE", rows)
        monkeypatch.setattr(clustered, "HUGE", rows)
        ksp = feti(problem.A, feti_formulation="primal", feti_coarse_modes=6, ksp_rtol=1e-8)
        reason, _ = solve(ksp, problem, values)
        context = ksp.getPythonContext()
        agree(reason > 0, context.message)
        agree(("clusters" in context.report().coarse_solver) == (rows == 0))
        found.append(context.iterations)
    agree(found[1] <= 1.15 * found[0] + 1, found)


def test_directions_stay_conjugate(large, torn_grid, feti):
    """Also where the residual falls by as much as the error of a coarse solve leaves."""
    problem = torn_grid(**GRID)
    own = {"feti_dual_ksp_rtol": 1e-12, "feti_type": "all_floating", "feti_coarse_modes": 0}
    ksp = feti(problem.A, feti_formulation="dual", **own)
    reason, _ = solve(ksp, problem, random_values(problem))
    found = ksp.getPythonContext()
    agree(reason > 0 and found.eigenvalues[0] > 0.5, (found.message, found.eigenvalues))


@pytest.mark.processes(1)
def test_switch_heeds_rows_and_processes():
    """A factor, a spread inverse up to four times as large, or clusters.

    With columns that are no rigid motions, a factor on few processes, up to 100 000 rows.
    """
    for rows, processes, columns, expected in (
        (20_000, 1, 6.0, False),
        (20_001, 1, 6.0, True),
        (78_000, 512, 6.0, True),
        (78_000, 10_000, 6.0, False),
        (80_001, 10_000, 6.0, True),
        (21_818, 1, 21.3, False),
        (21_818, 8, 21.3, False),
        (21_818, 64, 21.3, True),
        (78_000, 32, 21.3, False),
        (78_000, 64, 21.3, True),
        (78_000, 10_000, 21.3, False),
        (100_001, 2, 21.3, True),
    ):
        assert takes_clusters(rows, processes, columns) == expected


def test_solves_leave_a_share_of_their_right_hand_side(large, torn_grid, parts):
    coarse = parts(torn_grid(**GRID).A).coarse
    agree(isinstance(coarse.solver, ClusteredSolver) and coarse.solver.clusters == 3)
    agree(coarse.solver.memory() > 0.0 and coarse.solver.pivots() == (0, 0))
    N, x = dense(coarse.N), coarse.N.createVecRight()
    b = x.duplicate()
    b.array[:] = np.random.default_rng(COMM.rank).standard_normal(len(b.array_r))
    for scale in (1.0, 1e-4, 1e-12):
        b.scale(scale / b.norm())
        coarse.solver.solve(b, x)
        error = np.linalg.norm(whole(b.array_r) - N @ whole(x.array_r))
        small(error, 1.01 * TOLERANCE * norm(b.array_r))
    for owned in (b, x):
        owned.destroy()


#: Where the modulus is another one, by the cell of a grid.
PATTERNS = {
    "columns": lambda i: (i[0] % 2 == 0) & (i[1] % 2 == 0),
    "layers": lambda i: i[1] % 2 == 0,
    "channels": lambda i: (i[2] % 4 == 1) & (i[1] % 2 == 1),
    "checkerboard": lambda i: i.sum(axis=0) % 2 == 0,
}


def stiffened_cube(n, grid, pattern, jump, subdomains=None):
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
        petsc_options={"feti_formulation": "primal"},
    )


@pytest.mark.processes(1)
@pytest.mark.parametrize("subdomains", [None, 20], ids=["aligned", "across"])
@pytest.mark.parametrize("jump", [1e2, 1e5, 1e8])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_jumps_are_solved_with_as_with_a_factor(pattern, jump, subdomains, large, monkeypatch):
    """By clusters, or by the factor that takes their place; rounding grows with the jump."""
    found = []
    for rows in (LARGE, 0):
        monkeypatch.setattr(clustered, "LARGE", rows)
        problem = stiffened_cube(6, 3 if subdomains is None else 2, pattern, jump, subdomains)
        problem.solver.setTolerances(rtol=max(1e-8, 1e-12 * jump))
        problem.solve()
        context = problem.solver.getPythonContext()
        agree(("clusters" in context.report().coarse_solver) == (rows == 0))
        found.append(context.iterations)
    agree(found[1] <= 1.1 * found[0] + 2, found)


@pytest.mark.processes(1, 2)
@pytest.mark.parametrize("reason", ["stagnates", "NaN", "later"])
def test_failed_iterations_hand_over_to_a_factor(
    reason, large, torn_grid, feti, monkeypatch, caplog
):
    """At the trial, or in a later solve; the table and the log tell, and the user sees no NaN."""
    if reason == "stagnates":
        monkeypatch.setattr(clustered, "ITERATIONS", 1)
    apply, calls = clustered.SchwarzBlocks.apply, []

    def fail(self, r, y):
        calls.append(0)
        apply(self, r, y)
        if reason != "stagnates" and LAST and len(calls) > (0 if reason == "NaN" else 60):
            y.array[:] = np.nan

    monkeypatch.setattr(clustered.SchwarzBlocks, "apply", fail)
    problem = torn_grid(**GRID)
    ksp = feti(problem.A, **FORMS["primal"])
    values = random_values(problem)
    with caplog.at_level("WARNING", logger="dolfinx_feti"):
        converged, x = solve(ksp, problem, values)
    context = ksp.getPythonContext()
    agree(converged > 0 and np.isfinite(x).all(), context.message)
    agree("clusters of subdomains has failed" in context.report().coarse_solver)
    agree(COMM.rank or "is factored" in caplog.text, caplog.text)


@pytest.mark.processes(1)
def test_its_own_size():
    """One cell in each of 3375 subdomains; nothing is patched."""
    problem = stiffened_cube(15, 15, "columns", 1e6)
    problem.solve()
    context = problem.solver.getPythonContext()
    agree(context.report().coarse_size > LARGE and "clusters" in context.report().coarse_solver)
    agree(context.residual <= max(1.01e-8, context.floor), context.residual)


#: Which of the blocks of some cells are stiff.
STIFF = {
    "columns": lambda i, j: i % 2,
    "layers": lambda i, j: j % 2,
    "channels": lambda i, j: i % 8 == 0 or j % 8 == 4,
    "checkerboard": lambda i, j: (i + j) % 2,
}


@pytest.mark.processes(1)
@pytest.mark.parametrize(
    ("where", "jump", "block"), [("columns", 1e4, 2), ("checkerboard", 1e8, 3)]
)
def test_jumps_above_the_switch(where, jump, block, torn_grid, feti):
    """Of 83² subdomains of two by two cells, along the subdomains or across them.

    The iterations stagnate, and a factor takes over.
    """

    def change(K, dofs):
        for n in range(len(K)):
            corner = 2 * (n // 83), 2 * (n % 83)

            def stiffness(cell, corner=corner):
                place = [(a + b) // block for a, b in zip(corner, cell, strict=True)]
                return jump if STIFF[where](*place) else 1.0

            K[n] = brick((2, 2), 2, stiffness)[1]

    problem = torn_grid((83, 83), (2, 2), components=2, change=change)
    ksp = feti(problem.A)
    reason, _ = solve(ksp, problem, random_values(problem))
    context = ksp.getPythonContext()
    agree(reason > 0 and context.message == "", context.message)
    agree(context.residual <= max(1e-8, np.nan_to_num(context.floor)), context.residual)
    said = context.report()
    agree(said.coarse_size > LARGE and "clusters of subdomains has failed" in said.coarse_solver)


@pytest.mark.processes(1)
def test_clusters_are_small_where_the_inverse_of_their_matrix_is_spread():
    """At most 128 rows a process, six for each cluster."""
    for subdomains, processes, expected in (
        (4096, 2, 64),
        (4096, 16, 341),
        (4096, 64, 512),
        (32_768, 16, 512),
        (10_000, 10_000, 1250),
        (3, 8, 1),
    ):
        assert number_of_clusters(subdomains, processes) == expected


def test_indefinite_matrix_is_factored(large, torn_grid, form):
    """A factor tells its inertia, and solves."""
    problem = torn_grid((3, 2), (4, 4), components=2, change=softened(0.02))
    space = form(problem, type="classical", interior="eliminate", coarse_modes=0).space
    agree(isinstance(space.solver, GatheredSolver) and space.negative() > 0)


def test_options_of_the_coarse_solver_ask_for_a_factor(large, torn_grid, parts):
    with inserted("test_feti_coarse_", {"pc_type": "cholesky"}):
        agree(isinstance(parts(torn_grid(**GRID).A).coarse.solver, GatheredSolver))


def test_block_of_one_process_that_is_not_definite(large, torn_grid, parts, monkeypatch):
    """All processes take the factor."""

    def fail(*_):
        raise np.linalg.LinAlgError("Matrix is not positive definite")

    if LAST:
        monkeypatch.setattr(np.linalg, "cholesky", fail)
    agree(isinstance(parts(torn_grid(**GRID).A).coarse.solver, GatheredSolver))


def test_more_processes_than_subdomains(large, torn_grid, feti):
    """Some have no rows, no block and no cluster."""
    problem = torn_grid((3, 1), (3, 3), components=2)
    for options in FORMS.values():
        ksp = feti(problem.A, feti_type="all_floating", **options)
        reason, _ = solve(ksp, problem, random_values(problem))
        agree(reason > 0, ksp.getPythonContext().message)
