# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The history of a solve: what each Newton step cost, and how Newton's method fails."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

from dolfinx_feti.feti.solver import FETI
from dolfinx_feti.runtime.compat import residual_is_nan

Reason = PETSc.SNES.ConvergedReason
DOMAIN, SEARCH = Reason.DIVERGED_FUNCTION_DOMAIN, Reason.DIVERGED_LINE_SEARCH
LINEAR = Reason.DIVERGED_LINEAR_SOLVE

#: What helps, {0}, where the unknown is a displacement and where it is not.
CLOSER = (
    "begin closer to the solution, such as with that of another parameter",
    "load in smaller steps",
)

#: PETSc's reason and the message of each failure, {0} for what helps, {1} for its detail.
FAILURES: dict[str, tuple[int, str]] = {
    "inverted": (
        DOMAIN,
        "the volume ratio det F is not positive at the start: begin with u = 0 or an admissible "
        "state",
    ),
    "poor guess": (DOMAIN, "the tangent at the predicted state is indefinite: {0}"),
    "crawls": (SEARCH, "the step lengths stay below {1}: {0}"),
    "no step": (SEARCH, "no admissible step length was found: {0}"),
    "not a number": (
        residual_is_nan(),
        "the residual is NaN or Inf: begin with an admissible state, or {0}",
    ),
    "too many": (
        Reason.DIVERGED_MAX_IT,
        "no convergence within {1} steps: {0} or raise snes_max_it",
    ),
    "indefinite": (LINEAR, "the tangent is indefinite and a shift does not help: {0}"),
    "singular": (
        LINEAR,
        "the tangent at this trial state is singular or indefinite, although the body is held: {0}",
    ),
    "trial": (LINEAR, "the tangent at this trial state is indefinite: {0} (linear solver: {1})"),
    "linear": (LINEAR, "the linear solver: {1}"),
}


class Stop(Exception):  # noqa: N818
    """Newton's method ends here: one of the ``FAILURES``, and its detail. On all processes."""


@dataclass(frozen=True, slots=True)
class NewtonStep:
    """What one Newton step cost; what is not known is nan, or None of a number."""

    residual: float  #: ‖r‖ before the step.
    step_length: float  #: α.
    linear_method: str  #: Krylov method.
    linear_iterations: int  #: Its iterations, those of all linear solves of the step.
    linear_residual: float  #: ‖K ΔU + r‖/‖r‖ of the assembled system.
    condition_number: float  #: Of the preconditioned operator.
    negative: int | None  #: Negative eigenvalues of regularised subdomains and D (with a ``lag``).
    indefinite: int | None  #: Those that the true tangent has at least; None after a shift.
    shift: float  #: σ of the tangent K + σ diag|k| that ΔU solves; zero for the true one.
    solves: int  #: Linear solves; all but the last failed or led uphill.
    seconds_assembly: float  #: Time for residual and tangent.
    seconds_linear: float  #: Time for factors and Krylov method.
    linear_rtol: float = math.nan  #: Largest ``linear_residual`` that was asked for.
    lag: int = 0  #: Matrices since the one that the preconditioner belongs to.
    floor: float = math.nan  #: ‖r‖ that is rounding.
    linear_floor: float = math.nan  #: ``linear_residual`` at its rounding, if that ended the solve.
    tangent_lag: int = 0  #: Steps that the tangent had served before; 0 for a new one.

    @classmethod
    def after(cls, feti: FETI, iterations: Sequence[int], **measured: Any) -> NewtonStep:
        """Record a step after its last linear solve, with the iterations of each of them."""
        return cls(
            linear_method=feti.method,
            linear_iterations=sum(iterations),
            linear_residual=feti.residual,
            condition_number=feti.condition_number,
            negative=None if feti.inertia is None else feti.inertia.dual,
            solves=len(iterations),
            linear_rtol=feti.rtol,
            lag=feti.age,
            linear_floor=feti.floor,
            **measured,
        )


def proved_negative(feti: FETI) -> int | None:
    """Return the negative eigenvalues that the assembled matrix has at least; None if not known."""
    return None if feti.inertia is None else feti.inertia.assembled
