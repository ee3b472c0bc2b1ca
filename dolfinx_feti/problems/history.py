# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The history of a solve: what each Newton step cost."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from dolfinx_feti.feti.solver import FETI

__all__ = ["NewtonStep", "is_slow", "proved_negative", "record_step", "share_left"]

#: So many steps, each of which leaves more than this share of the residual, are slow.
SLOW_STEPS, SLOW = 3, 0.03


@dataclass(frozen=True, slots=True)
class NewtonStep:
    """What one Newton step cost.

    Attributes:
        residual: ‖r‖ before the step.
        step_length: α.
        linear_method: Krylov method.
        linear_iterations: Its iterations, those of all linear solves of the step.
        linear_residual: ‖K ΔU + r‖/‖r‖ of the assembled system.
        condition_number: Of the preconditioned operator; nan if not known.
        negative: Negative eigenvalues of the regularised subdomains and of D, those of the matrix
            that the preconditioner belongs to (``lag``); None if they are not known.
        indefinite: Negative eigenvalues that the true tangent has at least, see ``space``; None if
            they are not known, as in a step that begins with a shift.
        shift: σ of the tangent K + σ diag|k| that ΔU solves; zero for the true one.
        solves: Linear solves; all but the last failed or led uphill.
        seconds_assembly: Time for residual and tangent.
        seconds_linear: Time for factors and Krylov method.
        linear_rtol: Largest ``linear_residual`` that was asked for; nan if it is not known.
        lag: Matrices since the one that the preconditioner belongs to.
        floor: ‖r‖ that is rounding; nan if it is not known.
        linear_floor: ``linear_residual`` that is rounding, if the linear solve has ended there
            before ``linear_rtol``; else nan.
        tangent_lag: Steps that the tangent had served before; 0 for a new one.
    """

    residual: float
    step_length: float
    linear_method: str
    linear_iterations: int
    linear_residual: float
    condition_number: float
    negative: int | None
    indefinite: int | None
    shift: float
    solves: int
    seconds_assembly: float
    seconds_linear: float
    linear_rtol: float = math.nan
    lag: int = 0
    floor: float = math.nan
    linear_floor: float = math.nan
    tangent_lag: int = 0


def record_step(
    feti: FETI,
    *,
    residual: float,
    step_length: float,
    indefinite: int | None,
    shift: float,
    iterations: Sequence[int],
    assembly: float,
    linear: float,
    floor: float = math.nan,
    tangent_lag: int = 0,
) -> NewtonStep:
    """Record what a Newton step cost.

    Args:
        feti: Context of the KSP after the last linear solve of the step.
        residual: ‖r‖ before the step.
        step_length: α.
        indefinite: Negative eigenvalues that the true tangent has at least, see ``coarse.space``;
            None if they are not known.
        shift: σ of the last solve.
        iterations: Those of each linear solve.
        assembly: Seconds of assembly.
        linear: Seconds of the solves.
        floor: ‖r‖ that is rounding.
        tangent_lag: Steps that the tangent had served before.
    """
    return NewtonStep(
        residual=residual,
        step_length=step_length,
        linear_method=feti.method,
        linear_iterations=sum(iterations),
        linear_residual=feti.residual,
        condition_number=feti.condition_number,
        negative=None if feti.inertia is None else feti.inertia.dual,
        indefinite=indefinite,
        shift=shift,
        solves=len(iterations),
        seconds_assembly=assembly,
        seconds_linear=linear,
        linear_rtol=feti.rtol,
        lag=feti.age,
        floor=floor,
        linear_floor=feti.floor,
        tangent_lag=tangent_lag,
    )


def proved_negative(feti: FETI) -> int | None:
    """Return the negative eigenvalues that the assembled matrix has at least; None if not known."""
    return None if feti.inertia is None else feti.inertia.assembled


def share_left(history: Sequence[NewtonStep], norm: float) -> float:
    """Return the share of the residual, now ‖r‖, that the last step has left.

    It is infinite before the first step, and after one that was shortened or took a shift.
    """
    whole = history and history[-1].step_length == 1.0 and history[-1].shift == 0.0
    return norm / history[-1].residual if whole else math.inf


def is_slow(history: Sequence[NewtonStep], norm: float) -> bool:
    """Tell whether each of the last steps has left much of the residual, now ‖r‖."""
    last = history[-SLOW_STEPS:]
    norms = [*(step.residual for step in last), norm]
    left = (after / before for before, after in itertools.pairwise(norms))
    return len(last) == SLOW_STEPS and all(SLOW < share < 1.0 for share in left)
