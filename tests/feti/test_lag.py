# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A preconditioner that is kept for later matrices: solutions are the same, and it is renewed."""

import logging
import weakref

from petsc4py import PETSc

import numpy as np
import pytest
from cases import case, every_interior, every_type
from collective import COMM, agree, equal
from hand_torn import own_subdomains, random_values, softened, solve, solved

from dolfinx_feti import FETI
from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.report import format_report
from dolfinx_feti.feti.subdomain.schur_operator import create_schur_operator
from dolfinx_feti.torn.matrix import set_condensed_pressures

Reason = PETSc.KSP.ConvergedReason

GRID = case((2, 2), (4, 3), 2)
OTHER = [1e4, 1.0, 1e-3, 1e2]


def scale(problem, factors):
    """Multiply the matrices of all subdomains, in the torn matrix and in ``problem.K``."""
    diagonal = problem.local.createVecLeft()
    rows = [np.full(len(problem.K[i]), factors[i]) for i in own_subdomains(len(problem.K))]
    diagonal.array[:] = np.concatenate([*rows, np.zeros(0)])
    problem.local.diagonalScale(diagonal)
    problem.local.assemble()
    diagonal.destroy()
    for K_i, factor in zip(problem.K, factors, strict=True):
        K_i *= factor


@pytest.fixture
def primal(torn_grid, create_ksp):
    """Make a problem and a KSP in the primal form whose preconditioner lasts."""

    def create(*, newton=True, **options):
        problem = torn_grid(**GRID)
        given = {"feti_formulation": "primal", "ksp_rtol": 1e-11, **options}
        return problem, create_ksp(problem.A, FETI(newton=newton), **given)

    return create


def check(problem, ksp):
    """Solve, compare with LU, and return the age of the preconditioner."""
    return solved(ksp, problem).age


def fail(*args, **kwargs):
    raise SetUpError("no room today")


def push(K, dofs):
    K[1] -= 0.002 * np.diag(K[1].diagonal())  # D of this subdomain gets negative eigenvalues


@every_type
@every_interior
def test_serves_later_matrices(kind, interior, primal):
    problem, ksp = primal(feti_type=kind, feti_interior=interior, feti_lag=2)
    ages = [check(problem, ksp)]
    for factor in (1.1, 0.9, 1.2, 0.95):
        scale(problem, [factor, 1.0, 1.0 / factor, 1.0])
        ages.append(check(problem, ksp))
    agree(ages == [0, 1, 2, 0, 1], ages)
    report = ksp.getPythonContext().report()
    agree(report.age == 1 and "dirichlet, set up 1 matrix ago" in format_report(report))
    scale(problem, [1.1, 1.0, 1.0, 1.0])
    ksp.getPythonContext().renew()
    agree(check(problem, ksp) == 0)


@pytest.mark.parametrize("lag", [0, 6])
def test_nothing_is_left_of_an_operator(lag, primal, monkeypatch):
    """It is freed before that of the next matrix is set up, since memory may not hold both."""
    problem, ksp = primal(feti_interior="eliminate", feti_lag=lag)
    left = []
    last = []

    def watched(*arguments):
        left.extend(S() is not None for S in last)
        return create_schur_operator(*arguments)

    monkeypatch.setattr("dolfinx_feti.feti.setup.create_schur_operator", watched)
    for factor in (1.0, 1.1, 0.9):
        scale(problem, [factor, 1.0, 1.0, 1.0])
        check(problem, ksp)
        operator = ksp.getPythonContext().formulation.operator
        last = [weakref.ref(S_i.matrix) for S_i in operator.by_subdomain]
    agree(not any(left) and COMM.allreduce(len(left)) == 8, left)


@every_interior
@pytest.mark.parametrize("lag", [0, 6])
def test_ritz_vectors_serve_later_matrices(interior, lag, primal):
    """They outlive the preconditioner, but not the Newton solve."""
    counts = {}
    for most in (0, 3):
        problem, ksp = primal(feti_interior=interior, feti_lag=lag, feti_deflation=most)
        context = ksp.getPythonContext()
        counts[most] = []
        for factor in (1.0, 0.3, 1.1, 0.9, 1.0):
            scale(problem, [factor, 1.0, 1.0 / factor, 1.0])
            if len(counts[most]) == 4:
                context.renew()
            check(problem, ksp)
            counts[most].append(context.report().ritz_vectors)
    agree(counts[0] == [0] * 5, counts)
    agree(counts[3][0] == counts[3][4] == 0 and max(counts[3]) <= 3, counts)
    if lag:
        agree(min(counts[3][2:4]) > 0, counts)
        agree("Ritz vectors" not in format_report(context.report()))


def test_linear_solves_leave_no_vectors(torn_grid, create_ksp):
    """Each matrix outside Newton's method is deflated by its own soft fields."""
    options = {"feti_formulation": "primal", "feti_coarse_modes": 0, "ksp_rtol": 1e-11}
    problem = torn_grid(**case((4, 3), (3, 3), 2), change=softened(0.0004))

    def deflation_vectors(ksp):
        check(problem, ksp)
        return ksp.getPythonContext().formulation.deflation.W

    ksp = create_ksp(problem.A, FETI(), **options)
    of_first_matrix = deflation_vectors(ksp)
    scale(problem, [1.0 + 0.1 * (i % 3) for i in range(len(problem.K))])
    of_later_matrix = deflation_vectors(ksp)
    expected = deflation_vectors(create_ksp(problem.A, FETI(), **options))
    agree(COMM.allreduce(of_first_matrix.size) > 0, of_first_matrix.shape)
    agree(COMM.allreduce(expected.size) > 0, expected.shape)
    equal(of_later_matrix, expected, 1e-9)


@pytest.mark.parametrize(
    "options", [{"feti_lag": 0}, {"feti_formulation": "dual"}, {"newton": False}]
)
def test_never_lasts(options, primal):
    problem, ksp = primal(**options)
    ages = [check(problem, ksp)]
    scale(problem, [1.1, 1.0, 1.0, 1.0])
    agree([*ages, check(problem, ksp)] == [0, 0])


def test_solve_without_an_iteration_sets_no_rate(primal):
    """The start is enough for a first matrix, and the next one takes as many as it needs."""
    problem, ksp = primal()
    ksp.setTolerances(atol=1e30)
    reason, _ = solve(ksp, problem, random_values(problem))
    agree(reason > 0 and ksp.getPythonContext().iterations == 0)
    ksp.setTolerances(atol=0.0)
    scale(problem, [1.5] * len(problem.K))
    agree(check(problem, ksp) == 1)


@every_type
def test_ends_where_iterations_grow(kind, primal, monkeypatch):
    """Another material: a solve that is given up is repeated, and its iterations count."""
    problem, ksp = primal(feti_type=kind)
    check(problem, ksp)
    scale(problem, OTHER)
    with monkeypatch.context() as patience:
        patience.setattr("dolfinx_feti.feti.cache.MAX_GROWTH", 1.0)
        agree(check(problem, ksp) == 0, "the preconditioner of the first material is of no use")
        spent = ksp.getIterationNumber()
        same, limited = primal(feti_type=kind, ksp_max_it=spent - 1)
        check(same, limited)
        scale(same, OTHER)
        reason, _ = solve(limited, same, random_values(same))
        agree(reason == Reason.DIVERGED_MAX_IT and limited.getIterationNumber() == spent - 1)
    scale(problem, [1.01, 1.0, 1.0, 1.0])
    agree(check(problem, ksp) == 1, "that of the repeated solve lasts: what was spent before it")
    agree(spent > ksp.getIterationNumber(), (spent, ksp.getIterationNumber()))


def test_set_up_that_fails_with_an_old_preconditioner_is_repeated(primal, monkeypatch):
    """The present matrix may still be set up on its own."""
    problem, ksp = primal()
    check(problem, ksp)
    scale(problem, [1.1, 1.0, 1.0, 1.0])
    monkeypatch.setattr("dolfinx_feti.feti.cache.set_up_operator", fail)
    agree(check(problem, ksp) == 0)


def test_indefinite_matrix_is_told(primal, caplog):
    """Negative curvature is that of the matrix, whatever the preconditioner's age."""
    problem, ksp = primal()
    check(problem, ksp)
    scale(problem, [1.0, 1.0, 1.0, -1.0])
    with caplog.at_level(logging.INFO, "dolfinx_feti"):
        reason, _ = solve(ksp, problem, random_values(problem))
    agree(reason == Reason.DIVERGED_INDEFINITE_MAT, reason)
    agree("indefinite" in ksp.getPythonContext().message)
    agree(not caplog.records, "it is for Newton's method to say what this means")


@pytest.mark.parametrize("how", ["", "condensed", "fails"])
def test_other_form_where_matrix_turns_indefinite(
    how, torn_grid, create_ksp, monkeypatch, stops_at_negative_curvature
):
    """``auto`` switches to the dual formulation, with new factors in double precision.

    Where these fail, there is a reason and a message, and no exception out of the solve.
    """
    problem = torn_grid(**GRID, change=push)
    if how == "condensed":
        set_condensed_pressures(problem.A, 3)
    ksp = create_ksp(problem.A, FETI(newton=True), ksp_rtol=1e-11)
    check(problem, ksp)
    agree(ksp.getPythonContext().report().formulation == "primal")
    scale(problem, [1.0, 1.0, -1.0, 1.0])
    if how == "fails":
        monkeypatch.setattr("dolfinx_feti.feti.cache.create_dual_formulation", fail)
        reason, _ = solve(ksp, problem, random_values(problem))
        agree(reason == Reason.DIVERGED_PCSETUP_FAILED, reason)
        agree("no room today" in ksp.getPythonContext().message)
    else:
        agree(check(problem, ksp) == 0)
        agree(ksp.getPythonContext().report().formulation == "dual")
