# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A preconditioner that is kept for later matrices leaves solutions as they are, and is renewed."""

import logging
import weakref

from petsc4py import PETSc

import numpy as np
import pytest
from cases import case, every_interior, every_type
from collective import COMM, agree, equal
from hand_torn import own_subdomains, random_values, softened, solve, solve_and_check

from dolfinx_feti import FETI
from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.report import format_report
from dolfinx_feti.feti.subdomain.schur_operator import create_schur_operator
from dolfinx_feti.torn.matrix import set_condensed_pressures

Reason = PETSc.KSP.ConvergedReason

GRID = case((2, 2), (4, 3), 2)
OTHER_MATERIAL = [1e4, 1.0, 1e-3, 1e2]


def scale_subdomains(problem, factors):
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
def create_primal_ksp(torn_grid, create_ksp):
    """Return a function that creates a problem and a KSP with a lasting primal preconditioner."""

    def create(*, newton=True, **options):
        problem = torn_grid(**GRID)
        settings = {"feti_formulation": "primal", "ksp_rtol": 1e-11, **options}
        return problem, create_ksp(problem.A, FETI(newton=newton), **settings)

    return create


def age_after_solve(problem, ksp):
    """Assert that a solve agrees with LU; return the age of the preconditioner."""
    return solve_and_check(ksp, problem).age


def raise_set_up_error(*args, **kwargs):
    """Fail in place of a part of the set-up."""
    raise SetUpError("no room today")


def soften_second_subdomain(K, dofs):
    """Reduce the diagonal so that D of the second subdomain has negative eigenvalues."""
    K[1] -= 0.002 * np.diag(K[1].diagonal())


@every_type
@every_interior
def test_preconditioner_serves_later_matrices(kind, interior, create_primal_ksp):
    """Its age grows up to -feti_lag, and renew() has it set up at the next solve."""
    problem, ksp = create_primal_ksp(feti_type=kind, feti_interior=interior, feti_lag=2)
    ages = [age_after_solve(problem, ksp)]
    for factor in (1.1, 0.9, 1.2, 0.95):
        scale_subdomains(problem, [factor, 1.0, 1.0 / factor, 1.0])
        ages.append(age_after_solve(problem, ksp))
    agree(ages == [0, 1, 2, 0, 1])
    report = ksp.getPythonContext().report()
    agree(report.age == 1 and "dirichlet, set up 1 matrix ago" in format_report(report))
    scale_subdomains(problem, [1.1, 1.0, 1.0, 1.0])
    ksp.getPythonContext().renew()
    agree(age_after_solve(problem, ksp) == 0)


@pytest.mark.parametrize("lag", [0, 6])
def test_operator_is_freed_before_the_next_is_set_up(lag, create_primal_ksp, monkeypatch):
    """Memory may not hold the Schur complements of two matrices."""
    problem, ksp = create_primal_ksp(feti_interior="eliminate", feti_lag=lag)
    survivors = []
    previous = []

    def create_watched(*arguments):
        survivors.extend(S() is not None for S in previous)
        return create_schur_operator(*arguments)

    monkeypatch.setattr("dolfinx_feti.feti.setup.create_schur_operator", create_watched)
    for factor in (1.0, 1.1, 0.9):
        scale_subdomains(problem, [factor, 1.0, 1.0, 1.0])
        age_after_solve(problem, ksp)
        operator = ksp.getPythonContext().formulation.operator
        previous = [weakref.ref(S_i.matrix) for S_i in operator.by_subdomain]
    agree(not any(survivors) and COMM.allreduce(len(survivors)) == 8, survivors)


@every_interior
@pytest.mark.parametrize("lag", [0, 6])
def test_ritz_vectors_serve_later_matrices(interior, lag, create_primal_ksp):
    """Ritz vectors outlast the preconditioner, and end with the Newton solve."""
    counts = {}
    for max_vectors in (0, 3):
        problem, ksp = create_primal_ksp(
            feti_interior=interior, feti_lag=lag, feti_deflation=max_vectors
        )
        context = ksp.getPythonContext()
        counts[max_vectors] = []
        for factor in (1.0, 0.3, 1.1, 0.9, 1.0):
            scale_subdomains(problem, [factor, 1.0, 1.0 / factor, 1.0])
            if len(counts[max_vectors]) == 4:
                context.renew()
            age_after_solve(problem, ksp)
            counts[max_vectors].append(context.report().ritz_vectors)
    agree(counts[0] == [0] * 5, counts)
    agree(counts[3][0] == counts[3][4] == 0 and max(counts[3]) <= 3, counts)
    if lag:
        agree(min(counts[3][2:4]) > 0, counts)
        agree("Ritz vectors" not in format_report(context.report()))


def test_linear_solves_keep_no_ritz_vectors(torn_grid, create_ksp):
    """Each matrix outside Newton's method is deflated by its own soft fields."""
    options = {"feti_formulation": "primal", "feti_coarse_modes": 0, "ksp_rtol": 1e-11}
    problem = torn_grid(**case((4, 3), (3, 3), 2), change=softened(0.0004))

    def deflation_vectors(ksp):
        age_after_solve(problem, ksp)
        return ksp.getPythonContext().formulation.deflation.W

    ksp = create_ksp(problem.A, FETI(), **options)
    of_first_matrix = deflation_vectors(ksp)
    scale_subdomains(problem, [1.0 + 0.1 * (i % 3) for i in range(len(problem.K))])
    of_later_matrix = deflation_vectors(ksp)
    expected = deflation_vectors(create_ksp(problem.A, FETI(), **options))
    agree(COMM.allreduce(of_first_matrix.size) > 0, of_first_matrix.shape)
    agree(COMM.allreduce(expected.size) > 0, expected.shape)
    equal(of_later_matrix, expected, 1e-9)


@pytest.mark.parametrize(
    "options", [{"feti_lag": 0}, {"feti_formulation": "dual"}, {"newton": False}]
)
def test_preconditioner_is_set_up_for_each_matrix(options, create_primal_ksp):
    """It is kept neither without a lag, nor in the dual form, nor outside of Newton's method."""
    problem, ksp = create_primal_ksp(**options)
    ages = [age_after_solve(problem, ksp)]
    scale_subdomains(problem, [1.1, 1.0, 1.0, 1.0])
    agree([*ages, age_after_solve(problem, ksp)] == [0, 0])


def test_solve_without_iterations_does_not_limit_the_next(create_primal_ksp):
    """The iteration limit of a kept preconditioner follows from earlier iterations, if any."""
    problem, ksp = create_primal_ksp()
    ksp.setTolerances(atol=1e30)
    reason, _ = solve(ksp, problem, random_values(problem))
    agree(reason > 0 and ksp.getPythonContext().iterations == 0)
    ksp.setTolerances(atol=0.0)
    scale_subdomains(problem, [1.5] * len(problem.K))
    agree(age_after_solve(problem, ksp) == 1)


@every_type
def test_slow_solve_is_repeated_with_a_new_preconditioner(kind, create_primal_ksp, monkeypatch):
    """The iterations of the solve that is given up count, too."""
    problem, ksp = create_primal_ksp(feti_type=kind)
    age_after_solve(problem, ksp)
    scale_subdomains(problem, OTHER_MATERIAL)
    with monkeypatch.context() as patience:
        patience.setattr("dolfinx_feti.feti.cache.MAX_GROWTH", 1.0)
        agree(age_after_solve(problem, ksp) == 0, "the first preconditioner is too slow")
        spent = ksp.getIterationNumber()
        second_problem, limited = create_primal_ksp(feti_type=kind, ksp_max_it=spent - 1)
        age_after_solve(second_problem, limited)
        scale_subdomains(second_problem, OTHER_MATERIAL)
        reason, _ = solve(limited, second_problem, random_values(second_problem))
        agree(reason == Reason.DIVERGED_MAX_IT and limited.getIterationNumber() == spent - 1)
    scale_subdomains(problem, [1.01, 1.0, 1.0, 1.0])
    agree(age_after_solve(problem, ksp) == 1, "the new preconditioner was not kept")
    agree(spent > ksp.getIterationNumber(), "iterations of the slow solve were not counted")


def test_failed_set_up_with_a_kept_preconditioner_is_repeated(create_primal_ksp, monkeypatch):
    """The present matrix may still be set up on its own."""
    problem, ksp = create_primal_ksp()
    age_after_solve(problem, ksp)
    scale_subdomains(problem, [1.1, 1.0, 1.0, 1.0])
    monkeypatch.setattr("dolfinx_feti.feti.cache.set_up_operator", raise_set_up_error)
    agree(age_after_solve(problem, ksp) == 0)


def test_indefinite_matrix_is_reported_but_not_logged(create_primal_ksp, caplog):
    """Negative curvature is a property of the matrix, whatever the preconditioner's age."""
    problem, ksp = create_primal_ksp()
    age_after_solve(problem, ksp)
    scale_subdomains(problem, [1.0, 1.0, 1.0, -1.0])
    with caplog.at_level(logging.INFO, "dolfinx_feti"):
        reason, _ = solve(ksp, problem, random_values(problem))
    agree(reason == Reason.DIVERGED_INDEFINITE_MAT)
    agree("indefinite" in ksp.getPythonContext().message)
    agree(not caplog.records, caplog.messages)  # Newton's method logs what follows from it


@pytest.mark.parametrize("variant", ["plain", "condensed", "fails"])
def test_auto_switches_to_the_dual_form_if_the_matrix_turns_indefinite(
    variant, torn_grid, create_ksp, monkeypatch, stops_at_negative_curvature
):
    """The dual formulation gets new factors in double precision.

    If these fail, the solve has a reason and a message, and raises nothing.
    """
    problem = torn_grid(**GRID, change=soften_second_subdomain)
    if variant == "condensed":
        set_condensed_pressures(problem.A, 3)
    ksp = create_ksp(problem.A, FETI(newton=True), ksp_rtol=1e-11)
    age_after_solve(problem, ksp)
    agree(ksp.getPythonContext().report().formulation == "primal")
    scale_subdomains(problem, [1.0, 1.0, -1.0, 1.0])
    if variant == "fails":
        monkeypatch.setattr("dolfinx_feti.feti.cache.create_dual_formulation", raise_set_up_error)
        reason, _ = solve(ksp, problem, random_values(problem))
        agree(reason == Reason.DIVERGED_PCSETUP_FAILED)
        agree("no room today" in ksp.getPythonContext().message)
    else:
        agree(age_after_solve(problem, ksp) == 0)
        agree(ksp.getPythonContext().report().formulation == "dual")
