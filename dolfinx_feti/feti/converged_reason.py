# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The converged reason of a solve, and a message that names the remedy.

The first case that applies determines the reason:

=============================================  ==============================  ==================
state of the solution after the last start     reason                          message
=============================================  ==============================  ==================
the residual is not finite                     ``DIVERGED_NANORINF``           NaN or Inf
both tolerances are met                        ``CONVERGED_RTOL``              –
rounding ended the solve, share ≤ 1e-3         ``CONVERGED_HAPPY_BREAKDOWN``   –
rounding ended the solve, share > 1e-3         ``DIVERGED_BREAKDOWN``          lower a penalty
feti_dual_ksp_rtol or _atol ended the solve    PETSc's; ``CONVERGED_ITS`` if   by the reason
                                               the method needs a fresh start
the last start failed                          that of the Krylov method       by the reason
fresh starts gain nothing                      ``DIVERGED_BREAKDOWN``          better options
=============================================  ==============================  ==================

The *share* is what rounding leaves: of ‖b − A x_D‖ as residual, or of ‖x‖ as estimated error. In
messages, b is the lifted load b − A x_D. A solve that does not begin has no last start: the outer
loop gives ``DIVERGED_NULL`` as that of the Krylov method if the load has a part in the null space,
and ``solver`` sets the reason if a set-up failed or a matrix is refused.
"""

from __future__ import annotations

from dataclasses import replace

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.formulation import Formulation
from dolfinx_feti.feti.options import DEFAULTS
from dolfinx_feti.feti.solve_info import NEGATIVE_CURVATURE, Accuracy, KrylovInfo, SolveInfo

Reason = PETSc.KSP.ConvergedReason

#: PETSc's names of the reasons for a failure.
REASON_NAMES = {value: name for name, value in vars(Reason).items() if name.startswith("DIVERGED_")}

#: Largest residual, relative to ‖b − A x_D‖, and error, relative to ‖x‖, that rounding may leave of
#: a converged solution. It is a choice, not measured: smaller errors are invisible in a plot.
MAX_ROUNDING_SHARE = 1e-3

#: Error left by rounding, relative to ‖x‖, above which it is logged: seven digits are correct. A
#: choice, not measured.
LOGGED_ROUNDING_SHARE = 1e-7

#: Warning about an error above :data:`LOGGED_ROUNDING_SHARE`, with the error and its tolerance.
ERROR_FLOOR_WARNING = (
    "The linear solver ends with an estimated error of %.0e of x, which rounding leaves, above its "
    "tolerance of %.0e: lower a penalty or a jump of the stiffness, or raise ksp_rtol."
)

#: Cause of ``DIVERGED_NULL``: the load has a part in the null space.
INCOMPATIBLE_LOAD = (
    "the load is not orthogonal to the null space of A, so that nothing balances it; call "
    "A.setTransposeNullSpace, too: PETSc then removes that part from each load"
)


def converged_reason(
    last: KrylovInfo, accuracy: Accuracy, *, meets_tolerances: bool, has_krylov_tolerance: bool
) -> int:
    """Return PETSc's converged reason of a solve: the table at the head of this file.

    Args:
        last: How the last start of the Krylov method ended.
        accuracy: What has been measured of the solution.
        meets_tolerances: Whether residual and estimated error meet their tolerances.
        has_krylov_tolerance: Whether a tolerance that the user has set for the Krylov method of the
            dual form ends the solve.
    """
    if not np.isfinite(accuracy.residual):
        return Reason.DIVERGED_NANORINF
    if meets_tolerances:
        return Reason.CONVERGED_RTOL
    if _is_ended_by_rounding(accuracy):
        if _rounding_share(accuracy) <= MAX_ROUNDING_SHARE:
            return Reason.CONVERGED_HAPPY_BREAKDOWN
        return Reason.DIVERGED_BREAKDOWN
    if has_krylov_tolerance:
        return Reason.CONVERGED_ITS if last.needs_fresh_start else last.reason
    if last.reason < 0:
        return last.reason
    return Reason.DIVERGED_BREAKDOWN


def _is_ended_by_rounding(accuracy: Accuracy) -> bool:
    """Return True if residual or estimated error are at the floor that rounding leaves."""
    return not (np.isnan(accuracy.residual_floor) and np.isnan(accuracy.error_floor))


def _rounding_share(accuracy: Accuracy) -> float:
    """Return the larger of the residual and error that rounding leaves; nan if it leaves none."""
    return float(np.fmax(accuracy.residual_floor, _relevant_error_floor(accuracy)))


def _relevant_error_floor(accuracy: Accuracy) -> float:
    """Return the error that rounding leaves: η of all components together, if that is smaller.

    A large error of a tiny component alone is no failure. The result is nan if rounding has not
    ended the solve.
    """
    if accuracy.total_error_estimate < accuracy.error_floor:
        return accuracy.total_error_estimate
    return accuracy.error_floor


def composed_outcome(
    info: SolveInfo, error_estimate: float, *, total_error_estimate: float, error_tolerance: float
) -> SolveInfo:
    """Return the outcome of a solution that another solver composed of several converged solves.

    ``scalars.bordered`` composes one: it eliminates scalar unknowns, and refines the result while
    that lowers η enough. An η that is still above its tolerance thus counts as one that rounding
    leaves.

    Args:
        info: How the first solve ended; it converged.
        error_estimate: η of the composed solution, the largest over the components; nan if not
            measured.
        total_error_estimate: η of all of its components together.
        error_tolerance: Tolerance of η.
    """
    accuracy = replace(
        info.accuracy,
        error_estimate=error_estimate,
        error_floor=np.nan,
        total_error_estimate=total_error_estimate,
    )
    if np.isnan(error_estimate) or error_estimate <= error_tolerance:
        return replace(info, accuracy=accuracy)
    accuracy = replace(accuracy, error_floor=error_estimate)
    info = replace(info, accuracy=accuracy)
    floor = _relevant_error_floor(accuracy)
    if floor <= MAX_ROUNDING_SHARE:
        return replace(info, reason=Reason.CONVERGED_HAPPY_BREAKDOWN)
    message = f"{_error_floor_cause(floor)} (estimated error of x {error_estimate:.2e})."
    return replace(info, reason=Reason.DIVERGED_BREAKDOWN, message=message)


def failure_message(reason: int, accuracy: Accuracy, formulation: Formulation, prefix: str) -> str:
    """Return why a solve has failed, what helps, and what it has achieved.

    Args:
        reason: PETSc's converged reason.
        accuracy: What has been measured of the solution.
        formulation: The formulation that failed.
        prefix: Options prefix of the KSP.
    """
    cause = _floor_cause(accuracy)
    if not cause:
        cause = cause_and_remedy(reason, formulation, prefix)
    negative = formulation.inertia.assembled
    if negative:
        cause += (
            f"; the assembled matrix is indefinite, with at least {negative} negative eigenvalue(s)"
        )
    achieved = f"‖b − A x‖/‖b‖ = {accuracy.residual:.2e}"
    if not np.isnan(accuracy.error_estimate):
        achieved += f", estimated error of x {accuracy.error_estimate:.2e}"
    return f"{cause} ({achieved})."


def _floor_cause(accuracy: Accuracy) -> str:
    """Return the cause for a share of rounding above its bound; empty if it is below."""
    if accuracy.residual_floor > MAX_ROUNDING_SHARE:
        return (
            f"rounding alone leaves a residual of {accuracy.residual_floor:.0e} ‖b‖, because the "
            "entries of A are too large for b: lower a penalty such as κ (and correct its effect "
            "by an augmented Lagrangian), or scale the unknowns so that their stiffness is similar"
        )
    error_floor = _relevant_error_floor(accuracy)
    return _error_floor_cause(error_floor) if error_floor > MAX_ROUNDING_SHARE else ""


def _error_floor_cause(error_estimate: float) -> str:
    """Return the cause for an estimated error that rounding leaves."""
    return (
        f"rounding alone leaves an estimated error of {error_estimate:.0e} of x: the entries of A "
        "differ too much in size; lower a penalty or a jump of the stiffness"
    )


def cause_and_remedy(reason: int, formulation: Formulation, prefix: str) -> str:
    """Return why a solve has failed, and what helps, by its reason.

    Options that have been set already are not recommended.

    Args:
        reason: PETSc's converged reason.
        formulation: The formulation that failed.
        prefix: Options prefix of the KSP.
    """
    if reason == Reason.DIVERGED_NANORINF:
        return (
            "NaN or Inf appeared in the solve: check the matrix and the load for entries that are "
            "not finite"
        )
    if reason == Reason.DIVERGED_NULL:
        return INCOMPATIBLE_LOAD
    if reason == Reason.DIVERGED_MAX_IT:
        remedy = _more_iterations(formulation, prefix)
        return f"no convergence within -{prefix}ksp_max_it iterations; {remedy}"
    if reason == Reason.DIVERGED_BREAKDOWN:
        return f"the residual stagnates; {_better_options(formulation, prefix)}"
    if reason in NEGATIVE_CURVATURE and formulation.method != "gmres":
        return _indefinite(reason, formulation, prefix)
    return f"the Krylov method ended with the reason {REASON_NAMES.get(reason, reason)}"


def _more_iterations(formulation: Formulation, prefix: str) -> str:
    """Return what helps if the iterations do not suffice."""
    remedy = "raise it"
    if _primal_may_serve(formulation):
        remedy += f", or use -{prefix}feti_formulation primal"
        default = DEFAULTS.pc_type
        if formulation.pattern.options.pc_type != default:
            remedy += f" -{prefix}feti_pc_type {default}"
    return remedy


def _better_options(formulation: Formulation, prefix: str) -> str:
    """Return what helps against stagnation: better options, or a matrix of better scales.

    If entries of A differ by more than 1/ε in size, no option helps; the estimated floor of
    rounding may miss that.
    """
    options = formulation.pattern.options
    recommended = []
    for name in ("pc_type", "scaling", "coarse_q"):
        value = getattr(DEFAULTS, name)
        if getattr(options, name) != value:
            recommended.append(f"-{prefix}feti_{name} {value}")
    if not recommended and _primal_may_serve(formulation):
        recommended = [f"-{prefix}feti_formulation primal"]
    scales = "reduce the range of the entries of A, such as penalties and jumps of the stiffness"
    if not recommended:
        return f"raise -{prefix}ksp_rtol, or {scales}"
    return f"use {' '.join(recommended)}, or {scales}"


def _indefinite(reason: int, formulation: Formulation, prefix: str) -> str:
    """Return the message for conjugate gradients that met a negative quadratic form."""
    use = f"use -{prefix}feti_formulation dual"
    if formulation.solves_indefinite:
        use = f"use -{prefix}feti_dual_ksp_type gmres"
    if reason == Reason.DIVERGED_INDEFINITE_PC:
        return f"the preconditioner is indefinite; {use}"
    cause = "negative curvature: the assembled matrix is indefinite"
    if formulation.solves_indefinite:
        cause += f", or a subdomain is, and the options choose {formulation.method}"
    return f"{cause}; {use}"


def _primal_may_serve(formulation: Formulation) -> bool:
    """Return True if the dual formulation is used although the primal one could be.

    The preconditioner of the primal one needs positive definite K_ρ.
    """
    return formulation.name == "dual" and formulation.inertia.local == 0
