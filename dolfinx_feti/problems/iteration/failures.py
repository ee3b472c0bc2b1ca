# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""How Newton's method fails: PETSc's reason, cause and remedy, and the error that a caller gets."""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

from dolfinx_feti.errors import (
    ConvergenceError,
    InadmissibleStartError,
    IndefiniteTangentError,
    LinearSolverError,
)
from dolfinx_feti.runtime.compat import nan_residual_reason

Reason = PETSc.SNES.ConvergedReason

#: The remedy {0} of most failures, for an unknown without a deformation gradient.
CLOSER_START = "begin closer to the solution, such as with that of another parameter"

#: The remedy {0} of most failures, for a displacement.
SMALLER_LOAD_STEPS = (
    "load in smaller steps (check the unit of the load; loading.follow_load halves steps down to "
    "Steps(least=…))"
)

#: Appended to the message if a tangent was singular although there are contacts.
UNSUPPORTED = (
    "Without contact nothing supports the body, and the contact does not: prescribe a displacement "
    "in place of the load, begin where body and tool touch, or add a weak spring (supports."
    "spring_energy)"
)

#: Message of a solve that a script's convergence test ends with a negative reason {0}.
TEST_FAILED = "the convergence test of problem.solver ended the solve with reason {0}"


@dataclass(frozen=True, slots=True)
class Failure:
    """A way to fail.

    Attributes:
        reason: PETSc's converged reason.
        cause: First part of the message, perhaps with a place {1} for a detail of this failure.
        remedy: Second part of the message, after a colon, perhaps with places {0} for one of the
            two remedies above, by the kind of unknown, and {1} for the detail.
        error: Class of the error that the problem raises; a path decides by it what to try next.
    """

    reason: int
    cause: str
    remedy: str = "{0}"
    error: type[ConvergenceError] = ConvergenceError


INVERTED_START = Failure(
    Reason.DIVERGED_FUNCTION_DOMAIN,
    "the volume ratio det F is not positive at the start",
    "begin with u = 0 or an admissible state; if another expression is the volume ratio, pass it "
    "as volume_ratio=",
    InadmissibleStartError,
)
INDEFINITE_START = Failure(
    Reason.DIVERGED_FUNCTION_DOMAIN,
    "the tangent at the predicted state is indefinite",
    error=InadmissibleStartError,
)
CRAWLING = Failure(Reason.DIVERGED_LINE_SEARCH, "the step lengths stay below {1}")
NO_STEP_LENGTH = Failure(Reason.DIVERGED_LINE_SEARCH, "no admissible step length was found")
NOT_A_NUMBER = Failure(
    nan_residual_reason(), "the residual is NaN or Inf", "begin with an admissible state, or {0}"
)
TOO_MANY_STEPS = Failure(
    Reason.DIVERGED_MAX_IT, "no convergence within {1} steps", "{0} or raise snes_max_it"
)
INDEFINITE = Failure(
    Reason.DIVERGED_LINEAR_SOLVE,
    "the tangent is indefinite and a shift does not help",
    error=IndefiniteTangentError,
)
SINGULAR_TRIAL = Failure(
    Reason.DIVERGED_LINEAR_SOLVE,
    "the tangent at this trial state is singular or indefinite, although the body is supported",
    error=IndefiniteTangentError,
)
INDEFINITE_TRIAL = Failure(
    Reason.DIVERGED_LINEAR_SOLVE,
    "the tangent at this trial state is indefinite",
    "{0} (linear solver: {1})",
    IndefiniteTangentError,
)
LINEAR_SOLVER = Failure(
    Reason.DIVERGED_LINEAR_SOLVE, "the linear solver failed", "{1}", LinearSolverError
)

#: All of them, for tests of their texts.
FAILURES = (
    INVERTED_START,
    INDEFINITE_START,
    CRAWLING,
    NO_STEP_LENGTH,
    NOT_A_NUMBER,
    TOO_MANY_STEPS,
    INDEFINITE,
    SINGULAR_TRIAL,
    INDEFINITE_TRIAL,
    LINEAR_SOLVER,
)


class NewtonFailure(Exception):  # noqa: N818
    """Newton's method failed, on all processes.

    Attributes:
        kind: One of ``FAILURES``.
    """

    def __init__(self, kind: Failure, detail: object = "") -> None:
        """Create the exception.

        Args:
            kind: One of ``FAILURES``.
            detail: Fills {1} in cause and remedy.
        """
        super().__init__(kind, detail)
        self.kind = kind
        self._detail = detail

    @property
    def cause(self) -> str:
        """The cause in words."""
        return self.kind.cause.format("", self._detail)

    def remedy(self, *, is_displacement: bool) -> str:
        """Return the remedy for a displacement with a known det F, or for another unknown."""
        general = SMALLER_LOAD_STEPS if is_displacement else CLOSER_START
        return self.kind.remedy.format(general, self._detail)


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a solve has ended, as the SNES and the problem report it.

    Attributes:
        reason: PETSc's converged reason; negative after a failure.
        message: Cause and remedy of a failure; empty otherwise.
        error: Class of the error that the problem raises after a failure.
        is_within_tolerances: Whether the SNES's own tolerances are met: an intermediate solve ends
            before that.
        is_rounding: Whether rounding ended the solve: all of the residual is rounding.
    """

    reason: int
    message: str = ""
    error: type[ConvergenceError] = ConvergenceError
    is_within_tolerances: bool = False
    is_rounding: bool = False
