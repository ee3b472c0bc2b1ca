# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""How a solve has ended: one record for each level.

- :class:`KrylovInfo`: how one start of a Krylov method ended; a result of ``Formulation.solve``.
- :class:`Accuracy`: what the outer loop has measured of the solution x.
- :class:`SolveInfo`: the outcome of a solve with converged reason and message, for the user.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.arrays import Array

#: PETSc's reasons for the end of CG if a quadratic form is negative.
NEGATIVE_CURVATURE = (
    PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT,
    PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC,
)

#: Extreme Ritz values (λ_min, λ_max) of a method that does not compute them.
NO_RITZ_VALUES = (np.nan, np.nan)


@dataclass(frozen=True, slots=True)
class DeflationVectors:
    """Vectors by which solves in the primal form are deflated, by copies of the interface dofs.

    They are Ritz vectors of an earlier solve, or soft fields before the first one.

    Attributes:
        W: The vectors, (n_Γ, k).
        M_inverse_W: M⁻¹ W, with the M for which W was computed, (n_Γ, k).
    """

    W: Array
    M_inverse_W: Array


@dataclass(frozen=True, slots=True)
class ErrorMeasurement:
    """The estimated error that a Krylov method has measured for its solution.

    Attributes:
        error_estimate: η of the solution, or of the iterate before it.
        residual: The residual b − A x that the method updates, (N,) after ``Formulation.solve``.
            If it is also the true residual, η need not be measured again.
    """

    error_estimate: float
    residual: Array


@dataclass(frozen=True, slots=True)
class KrylovInfo:
    """How one start of a Krylov method ended.

    Attributes:
        reason: PETSc's converged reason; ``ITERATING`` if ``needs_fresh_start``.
        iterations: Number of iterations.
        ritz_values: Extreme Ritz values (λ_min, λ_max) of CG, which approximate the extreme
            eigenvalues of the preconditioned operator; nan for other methods.
        needs_fresh_start: Whether the method has neither converged nor failed, so that the outer
            loop has to compute the true residual and start the method again.
        ritz_vectors: Ritz vectors for solves with later matrices (primal form).
        measured_error: η and the residual that it belongs to, if the method has tested η.
    """

    reason: int
    iterations: int = 0
    ritz_values: tuple[float, float] = NO_RITZ_VALUES
    needs_fresh_start: bool = False
    ritz_vectors: DeflationVectors | None = None
    measured_error: ErrorMeasurement | None = None


@dataclass(frozen=True, slots=True)
class Accuracy:
    """What the outer loop has measured of a solution x; a number that was not measured is nan.

    Attributes:
        residual: ‖b − A x‖/‖b − A x_D‖.
        rtol: Largest residual that meets the tolerances.
        residual_floor: Residual that rounding leaves, if rounding has ended the solve; else nan.
        error_estimate: Estimated error η of x, the largest over the components (``accuracy``).
        error_floor: η that rounding leaves, if rounding has ended the solve; else nan.
        total_error_estimate: η of all components together, in units of energy; nan also if only the
            Krylov method has measured η.
    """

    residual: float = np.nan
    rtol: float = np.nan
    residual_floor: float = np.nan
    error_estimate: float = np.nan
    error_floor: float = np.nan
    total_error_estimate: float = np.nan


@dataclass(frozen=True, slots=True)
class SolveInfo:
    """The outcome of a solve.

    Attributes:
        reason: PETSc's converged reason, negative after a failure.
        iterations: Number of Krylov iterations, over all starts.
        accuracy: What has been measured of the solution.
        ritz_values: Extreme Ritz values (λ_min, λ_max) of the first start; later starts are short.
        ritz_vectors: Ritz vectors of the first start, for solves with later matrices.
        message: Why the solve failed and what helps; empty otherwise.
    """

    reason: int
    iterations: int = 0
    accuracy: Accuracy = Accuracy()
    ritz_values: tuple[float, float] = NO_RITZ_VALUES
    ritz_vectors: DeflationVectors | None = None
    message: str = ""
