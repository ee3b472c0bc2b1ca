# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The converged reason of each state of a solution, and the iteration limit by digits."""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import pytest
from cases import each

from dolfinx_feti.feti.converged_reason import (
    MAX_ROUNDING_SHARE,
    composed_outcome,
    converged_reason,
)
from dolfinx_feti.feti.solve_info import Accuracy, KrylovInfo, SolveInfo
from dolfinx_feti.feti.solve_settings import ErrorAllowance, SolveSettings, Tolerances

Reason = PETSc.KSP.ConvergedReason

pytestmark = pytest.mark.serial

SMALL = MAX_ROUNDING_SHARE / 10.0
LARGE = MAX_ROUNDING_SHARE * 10.0

CONVERGED = KrylovInfo(Reason.CONVERGED_RTOL)
UNFINISHED = KrylovInfo(Reason.ITERATING, needs_fresh_start=True)
FAILED = KrylovInfo(Reason.DIVERGED_MAX_IT)


@dataclass(frozen=True)
class Case:
    """A state of the solution, and the reason that follows.

    Attributes:
        last: How the last start ended.
        accuracy: What was measured; the residual is finite in all cases but one.
        reason: The converged reason.
        meets_tolerances: Whether both tolerances are met.
        has_krylov_tolerance: Whether the user's tolerance ends the dual Krylov method.
    """

    last: KrylovInfo
    accuracy: Accuracy
    reason: int
    meets_tolerances: bool = False
    has_krylov_tolerance: bool = False


def measured(**floors: float) -> Accuracy:
    """Return what was measured of a solution with a finite residual."""
    return Accuracy(residual=1e-5, error_estimate=1e-4, **floors)


CASES = {
    "residual not finite": Case(CONVERGED, Accuracy(residual=np.inf), Reason.DIVERGED_NANORINF),
    "tolerances met": Case(CONVERGED, measured(), Reason.CONVERGED_RTOL, meets_tolerances=True),
    "tolerances met by a failed start": Case(
        FAILED, measured(), Reason.CONVERGED_RTOL, meets_tolerances=True
    ),
    "little rounding in the residual": Case(
        CONVERGED, measured(residual_floor=SMALL), Reason.CONVERGED_HAPPY_BREAKDOWN
    ),
    "much rounding in the residual": Case(
        CONVERGED, measured(residual_floor=LARGE), Reason.DIVERGED_BREAKDOWN
    ),
    "little rounding in the error": Case(
        CONVERGED, measured(error_floor=SMALL), Reason.CONVERGED_HAPPY_BREAKDOWN
    ),
    "much rounding in the error": Case(
        CONVERGED, measured(error_floor=LARGE), Reason.DIVERGED_BREAKDOWN
    ),
    "much rounding in the error of a tiny component": Case(
        CONVERGED,
        measured(error_floor=LARGE, total_error_estimate=SMALL),
        Reason.CONVERGED_HAPPY_BREAKDOWN,
    ),
    "little in the error, much in the residual": Case(
        CONVERGED, measured(error_floor=SMALL, residual_floor=LARGE), Reason.DIVERGED_BREAKDOWN
    ),
    "user's test, converged": Case(
        CONVERGED, measured(), Reason.CONVERGED_RTOL, has_krylov_tolerance=True
    ),
    "user's test, failed": Case(
        FAILED, measured(), Reason.DIVERGED_MAX_IT, has_krylov_tolerance=True
    ),
    "user's test, no fresh start": Case(
        UNFINISHED, measured(), Reason.CONVERGED_ITS, has_krylov_tolerance=True
    ),
    "last start failed": Case(FAILED, measured(), Reason.DIVERGED_MAX_IT),
    "fresh starts gain nothing": Case(UNFINISHED, measured(), Reason.DIVERGED_BREAKDOWN),
    "converged, but η is too large": Case(CONVERGED, measured(), Reason.DIVERGED_BREAKDOWN),
}


@each("case", CASES)
def test_converged_reason_of_each_state(case):
    """Residual, rounding floors and the last start determine the reason."""
    reason = converged_reason(
        case.last,
        case.accuracy,
        meets_tolerances=case.meets_tolerances,
        has_krylov_tolerance=case.has_krylov_tolerance,
    )
    assert reason == case.reason


@pytest.mark.parametrize(
    ("error_estimate", "total", "reason"),
    [
        (np.nan, np.nan, Reason.CONVERGED_RTOL),
        (1e-9, 1e-9, Reason.CONVERGED_RTOL),
        (SMALL, SMALL, Reason.CONVERGED_HAPPY_BREAKDOWN),
        (LARGE, SMALL, Reason.CONVERGED_HAPPY_BREAKDOWN),
        (LARGE, LARGE, Reason.DIVERGED_BREAKDOWN),
    ],
)
def test_error_of_a_composed_solution_is_rounding_above_its_tolerance(
    error_estimate, total, reason
):
    """A large η is a failure with a message; a small one, or that of a tiny component, is none."""
    info = composed_outcome(
        SolveInfo(Reason.CONVERGED_RTOL),
        error_estimate,
        total_error_estimate=total,
        error_tolerance=1e-8,
    )
    is_rounding = error_estimate > 1e-8
    assert info.reason == reason
    assert bool(info.message) == (reason < 0)
    np.testing.assert_array_equal(info.accuracy.error_estimate, error_estimate)
    assert np.isfinite(info.accuracy.error_floor) == is_rounding


@pytest.mark.parametrize(
    ("rtol", "rate", "limit"),
    [
        (1e-8, np.inf, 100),  # a new preconditioner
        (np.nan, 3.0, 100),  # no load
        (1e-8, 3.0, 24),
        (0.5, 3.0, 3),  # a digit at least
        (1e-30, 3.0, 39),  # 13 digits at most
        (1e-8, 30.0, 100),
    ],
)
def test_iteration_limit_is_proportional_to_the_digits(rtol, rate, limit):
    """It is the rate times the digits to gain, one to thirteen, and at most the user's limit."""
    assert Tolerances(1e-8, 0.0, 100, rate).iteration_limit(rtol) == limit


def test_error_allowance_meets_its_tolerance():
    """An error of the allowed size has η equal to the tolerance for x = 0, and less otherwise."""
    allowed = np.array([3e-4, 4e-4])
    settings = SolveSettings(error_allowance=ErrorAllowance(1e-3, allowed))
    tolerance, reference = settings.loosen(1e-8, 2)
    assert tolerance == 1e-3
    ratio = np.linalg.norm(allowed) / np.linalg.norm(reference)
    assert ratio == pytest.approx(tolerance, rel=1e-14)
    strict, no_reference = SolveSettings().loosen(1e-8, 2)
    assert strict == 1e-8
    np.testing.assert_array_equal(no_reference, 0.0)
