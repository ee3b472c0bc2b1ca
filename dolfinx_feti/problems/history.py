# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The record of a Newton step: its cost, and how it ended."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dolfinx_feti.feti.solver import FETI


@dataclass(frozen=True, slots=True)
class NewtonStep:
    """Cost and outcome of one Newton step; the solve of a linear problem is one step from zero.

    An unknown number is nan, and an unknown count None. Numbers whose names begin with ``linear``
    are those of the last linear solve of the step.
    """

    residual: float  #: ‖r‖ before the step.
    step_length: float  #: α.
    linear_method: str  #: Krylov method.
    linear_iterations: int  #: Its iterations, summed over all linear solves of the step.
    linear_residual: float  #: ‖K' ΔU + r‖/‖r‖ of the assembled system.
    condition_number: float  #: Of the preconditioned operator.
    #: Number of negative eigenvalues of the regularised subdomain matrices and of D; those of an
    #: earlier tangent if ``lag`` is not zero. None if a factorisation does not count them.
    negative: int | None
    #: Proved lower bound of the number of negative eigenvalues of the true tangent; None without a
    #: proof, or if only shifted tangents were factored.
    indefinite: int | None
    shift: float  #: σ of the tangent K' + σ diag|k| that ΔU solves; zero for the true one.
    #: Linear solves; those before the last one failed, or led uphill. Solves that were refused
    #: because the tangent is indefinite do not count.
    solves: int
    seconds_assembly: float  #: Time for residual, tangent and the line search before it [s].
    seconds_linear: float  #: Time for factors and Krylov method [s].
    linear_rtol: float = math.nan  #: Tolerance of ``linear_residual``.
    lag: int = 0  #: Age of the preconditioner: number of matrices since its own.
    floor: float = math.nan  #: ‖r‖ that is rounding.
    linear_floor: float = math.nan  #: ``linear_residual``, if its rounding ended the linear solve.
    linear_error: float = math.nan  #: Estimated error of ΔU, relative to it.
    linear_error_floor: float = math.nan  #: ``linear_error``, if its rounding ended the solve.
    error: float = math.nan  #: Estimated error of U after the step, if ‖r‖ is small there.
    tangent_lag: int = 0  #: Number of steps that the tangent had served before; 0 for a new one.

    @classmethod
    def after(
        cls,
        feti: FETI,
        iterations: Sequence[int],
        *,
        residual: float,
        step_length: float,
        indefinite: int | None,
        shift: float,
        seconds_assembly: float,
        seconds_linear: float,
        floor: float = math.nan,
        tangent_lag: int = 0,
    ) -> NewtonStep:
        """Return the record of a step, after its last linear solve.

        Args:
            feti: Context of the linear solver.
            iterations: Krylov iterations of each linear solve of the step.
            residual: The attribute of this name, like all arguments below.
            step_length: α.
            indefinite: Proved number of negative eigenvalues of the true tangent.
            shift: σ.
            seconds_assembly: Time for assembly and line search [s].
            seconds_linear: Time for the linear solves [s].
            floor: ‖r‖ that is rounding.
            tangent_lag: Number of earlier steps with this tangent.
        """
        return cls(
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
            seconds_assembly=seconds_assembly,
            seconds_linear=seconds_linear,
            linear_rtol=feti.rtol,
            lag=feti.age,
            floor=floor,
            linear_floor=feti.floor,
            linear_error=feti.error_estimate,
            linear_error_floor=feti.error_floor,
            tangent_lag=tangent_lag,
        )


def proved_negative(feti: FETI) -> int | None:
    """Return a lower bound of the negative eigenvalues of the assembled matrix; None if unknown."""
    return None if feti.inertia is None else feti.inertia.assembled
