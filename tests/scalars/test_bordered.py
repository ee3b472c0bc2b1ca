# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bordered systems agree with a dense solve, for a regular, indefinite or singular matrix A."""

from petsc4py import PETSc

import numpy as np
import pytest
import scipy.linalg
from cases import case
from collective import agree, equal, small, whole
from hand_torn import softened

from dolfinx_feti import FETI
from dolfinx_feti.scalars.border import Border
from dolfinx_feti.scalars.bordered import BorderedSolver

Reason = PETSc.KSP.ConvergedReason
GRID = case((3, 2), (3, 3), 2)
forms = pytest.mark.parametrize("form", ["dual", "primal", "auto"])
RTOL = 1e-10


def smooth_border(problem, m=2, *, symmetric=True, units=1.0, seed=3):
    """Return smooth columns B and C, (N, m), and D = 0, (m, m), on all processes.

    B is zero on Dirichlet dofs.
    """
    x = problem.x
    bs = len(problem.dirichlet) // len(problem.x)
    waves = np.random.default_rng(seed).standard_normal((m, bs, x.shape[1] + 1))
    columns = [np.sin(x @ w[:, :-1].T / 3 + w[:, -1]).ravel() for w in waves]
    B = np.column_stack(columns) * units ** np.arange(m)
    C = B if symmetric else B[:, ::-1] + 0.2
    return np.where(problem.dirichlet[:, None], 0.0, B), C, np.zeros((m, m))


def dense_solve(problem, b, B, C, D, d):
    """Solve the assembled bordered system; prescribed values are in b."""
    n = len(b)
    is_dirichlet = problem.dirichlet[:, None]
    M = np.block([[np.where(is_dirichlet, np.eye(n), problem.matrix), B], [C.T, D]])
    columns = 1 / np.linalg.norm(M, axis=0)
    rows = 1 / np.linalg.norm(M * columns, axis=1)
    z = columns * np.linalg.solve(rows[:, None] * M * columns, rows * np.concatenate([b, d]))
    return z[:n], z[n:]


def solve_bordered(problem, ksp, b, B, C, D, d, solver=None):
    """Solve a bordered system; return x of all processes, (N,), scalars s, (m,), and the solver."""
    rows = slice(*problem.A.getOwnershipRange())
    solver = solver or BorderedSolver()
    x, s = solver.solve(ksp, problem.A, b[rows], Border(B[rows], C[rows], D), d)
    return whole(x), s, solver


def check(problem, ksp, system, tolerance=1e-6):
    """Assert that a bordered solve agrees with a dense one; return the solver."""
    x, s, solver = solve_bordered(problem, ksp, *system)
    context = ksp.getPythonContext()
    agree(ksp.getConvergedReason() > 0, context.message)
    small(abs(context.rtol / RTOL - 1.0), 1e-9)
    x_0, s_0 = dense_solve(problem, *system)
    equal(x, x_0, tolerance)
    small(np.abs(s / s_0 - 1.0).max(), tolerance)
    return solver


@forms
@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("units", [1.0, 1e6, 1e-9])
def test_regular_bordered_system_is_solved(form, symmetric, units, torn_grid, create_ksp):
    """Columns differ by many orders in their units, and the corner D is not zero."""
    problem = torn_grid(**GRID)
    B, C, D = smooth_border(problem, symmetric=symmetric, units=units)
    rng = np.random.default_rng(1)
    b = rng.standard_normal(len(B))
    d = rng.standard_normal(2) * units ** np.arange(2)
    D = D - 1e-3 * np.diag(units ** (2.0 * np.arange(2)))
    ksp = create_ksp(problem.A, feti_formulation=form, ksp_rtol=RTOL)
    check(problem, ksp, (b, B, C, D, d))


@forms
def test_indefinite_matrix_past_a_limit_point_is_solved(form, torn_grid, create_ksp):
    """A has one negative eigenvalue, and the bordered matrix is as regular as ever."""
    problem = torn_grid(change=softened(0.008), **GRID)
    agree(problem.n_negative == 1)
    b = np.random.default_rng(1).standard_normal(len(problem.dirichlet))
    ksp = create_ksp(problem.A, feti_formulation=form, ksp_rtol=RTOL)
    check(problem, ksp, (b, *smooth_border(problem), np.array([0.3, -0.2])))
    if form == "primal":
        agree(ksp.getPythonContext().method == "cg")


@forms
@pytest.mark.parametrize("distance", [1e-4, 1e-8, -1e-6])
def test_nearly_singular_matrix_at_a_limit_point_is_solved(form, distance, torn_grid, create_ksp):
    """The smallest eigenvalue of A is close to zero, on either side."""
    problem = torn_grid(**GRID)
    copies = problem.T.sum(axis=0)[~problem.dirichlet]
    least = scipy.linalg.eigh(problem.free_matrix, np.diag(copies), eigvals_only=True)[0]

    def soften(K, dofs):
        for K_i in K:
            K_i -= (1.0 - distance) * least * np.eye(len(K_i))

    problem = torn_grid(change=soften, **GRID)
    rng = np.random.default_rng(1)
    system = (
        rng.standard_normal(len(problem.dirichlet)),
        *smooth_border(problem, 1),
        np.array([0.3]),
    )
    ksp = create_ksp(problem.A, feti_formulation=form, ksp_rtol=RTOL)
    check(problem, ksp, system, 1e-5)


@forms
@pytest.mark.parametrize("rolls", [False, True])
@pytest.mark.parametrize("grid", [(3, 2), (1, 1)], ids=["many", "processes-without-dofs"])
def test_floating_body_is_held_by_the_border(grid, form, rolls, torn_grid, create_ksp):
    """Mean values and a rotation hold a body without conditions, or on rollers."""

    def fixed(x):
        mask = np.zeros((len(x), 2), dtype=bool)
        mask[:, 0] = rolls & (x[:, 0] == 0.0)
        return mask

    problem = torn_grid(fixed=fixed, **{**GRID, "subdomains": grid})
    modes = problem.modes[:, 1:2] if rolls else problem.modes
    B = np.where(problem.dirichlet[:, None], 0.0, modes)
    m = B.shape[1]
    rng = np.random.default_rng(1)
    system = (rng.standard_normal(len(B)), B, modes, np.zeros((m, m)), rng.standard_normal(m))
    ksp = create_ksp(problem.A, feti_formulation=form, ksp_rtol=RTOL)
    check(problem, ksp, system)


@forms
def test_springs_are_added_once_and_only_during_a_solve(form, torn_grid, create_ksp):
    """The caller may change the diagonal between two solves, as Newton's shifts do."""
    problem = torn_grid(fixed=lambda x: np.zeros(len(x), dtype=bool), **GRID)
    rng = np.random.default_rng(1)
    n, m = problem.modes.shape
    loads = problem.modes, problem.modes, np.zeros((m, m)), rng.standard_normal(m)
    ksp = create_ksp(problem.A, feti_formulation=form, ksp_rtol=RTOL)
    solver = BorderedSolver()
    K = problem.local

    def diagonal():
        d = K.getDiagonal()
        values = d.array_r.copy()
        d.destroy()
        return values

    diagonals = []
    first_springs = None
    ksp.setMonitor(lambda _ksp, its, rnorm: diagonals.append(diagonal()))
    unit = np.median(np.abs(diagonal())) if len(diagonal()) else 1.0
    for shift in (0.0, 1e-3, 4e-3, -2e-3):
        K.shift(shift * unit)
        assembled = diagonal()
        solve_bordered(problem, ksp, rng.standard_normal(n), *loads, solver)
        agree(ksp.getConvergedReason() > 0, ksp.getPythonContext().message)
        equal(diagonal(), assembled)
        added = np.array(diagonals) - assembled
        springs = whole(np.median(added, axis=0))
        agree(np.count_nonzero(springs) == m, f"{np.count_nonzero(springs)} springs, not {m}")
        small(np.abs(added - np.median(added, axis=0)).max(initial=0.0), 1e-12 * unit)
        first_springs = springs if first_springs is None else first_springs
        equal(springs, first_springs, 1e-12)
        diagonals.clear()


def test_unchanged_matrix_is_set_up_once(torn_grid, create_ksp):
    """Springs come and go, but a second right-hand side has the matrix of the first one."""
    problem = torn_grid(fixed=lambda x: np.zeros(len(x), dtype=bool), **GRID)
    rng = np.random.default_rng(1)
    n, m = problem.modes.shape
    ksp = create_ksp(problem.A, ksp_rtol=RTOL)
    solver = BorderedSolver()
    formulations = []
    for _ in range(3):
        loads = problem.modes, problem.modes, np.zeros((m, m)), rng.standard_normal(m)
        solve_bordered(problem, ksp, rng.standard_normal(n), *loads, solver)
        formulations.append(ksp.getPythonContext().formulation)
    agree(formulations[0] is formulations[1] is formulations[2])
    problem.local.scale(2.0)
    solve_bordered(problem, ksp, rng.standard_normal(n), *loads, solver)
    agree(ksp.getPythonContext().formulation is not formulations[0])


def test_failed_solve_with_new_springs_leaves_no_correction(torn_grid, create_ksp):
    """The elimination before it belongs to a matrix without springs, and to fewer scalars."""
    problem = torn_grid(fixed=lambda x: np.zeros(len(x), dtype=bool), **GRID)
    n, m = problem.modes.shape
    rng = np.random.default_rng(1)
    system = (rng.standard_normal(n), problem.modes, problem.modes, np.zeros((m, m)), np.ones(m))
    ksp = create_ksp(problem.A, ksp_rtol=RTOL)
    rows = slice(*problem.A.getOwnershipRange())
    r = rng.standard_normal(n)[rows]

    problem.local.shift(1.0)  # resists the rigid motions
    _, _, solver = solve_bordered(problem, ksp, *system)
    agree(ksp.getConvergedReason() > 0, ksp.getPythonContext().message)
    agree(solver.correction(ksp, r, np.ones(m)) is not None)

    problem.local.shift(-1.0)
    ksp.setTolerances(max_it=1)
    solve_bordered(problem, ksp, *system, solver)
    agree(ksp.getConvergedReason() == Reason.DIVERGED_MAX_IT)
    agree(solver.correction(ksp, r, np.ones(m)) is None)


def test_last_solution_saves_iterations_for_the_next_matrix(torn_grid, create_ksp):
    """Solves for the border begin with the last solution, if the matrix differs a little."""
    problem = torn_grid(**GRID)
    rng = np.random.default_rng(1)
    b = rng.standard_normal(len(problem.dirichlet))
    d = np.array([0.3, 0.2])
    ksp = create_ksp(problem.A, FETI(newton=True), ksp_rtol=1e-8)
    B, C, D = smooth_border(problem)
    _, _, solver = solve_bordered(problem, ksp, b, B, C, D, d)
    first = solver.iterations
    problem.local.scale(1.0 + 1e-4)
    solve_bordered(problem, ksp, b, B, C, D, d, solver)
    agree(solver.iterations < 0.85 * first, (solver.iterations, first))


def test_error_in_a_solve_for_a_column_restores_the_tolerances(torn_grid, create_ksp):
    """Solves for columns of X have other tolerances than the solve for x."""
    problem = torn_grid(**GRID)
    B, C, D = smooth_border(problem, 1)
    b = np.random.default_rng(1).standard_normal(len(B))
    ksp = create_ksp(problem.A, ksp_rtol=RTOL, ksp_atol=1e-30)
    before = ksp.getTolerances()
    solves = 0

    def fail_in_second_solve(_ksp, its, _rnorm):
        nonlocal solves
        if its == 0:
            solves += 1
        if solves == 2:
            raise RuntimeError

    ksp.setMonitor(fail_in_second_solve)
    with pytest.raises(PETSc.Error):
        solve_bordered(problem, ksp, b, B, C, D, np.array([0.3]))
    agree(ksp.getTolerances() == before, f"{ksp.getTolerances()} instead of {before}")


@pytest.mark.parametrize("second_column", ["twice", "nothing"])
def test_dependent_constraints_are_reported(second_column, torn_grid, create_ksp):
    """Two columns are equal, or one is zero."""
    problem = torn_grid(**GRID)
    B, _, D = smooth_border(problem)
    B[:, 1] = B[:, 0] if second_column == "twice" else 0.0
    b = np.random.default_rng(1).standard_normal(len(B))
    ksp = create_ksp(problem.A, ksp_rtol=RTOL)
    _, _, solver = solve_bordered(problem, ksp, b, B, B.copy(), D, np.array([0.3, 0.2]))
    agree(ksp.getConvergedReason() == Reason.DIVERGED_BREAKDOWN)
    agree("depend on each other" in ksp.getPythonContext().message)
    rows = slice(*problem.A.getOwnershipRange())
    r = np.where(problem.dirichlet, 0.0, b)[rows]
    agree(solver.correction(ksp, r, np.zeros(len(D))) is None)
