# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Is the tangent J the derivative of the residual? A difference quotient decides (docs/theory.md).

.. math:: q = \frac{r(U + h d) - r(U - h d)}{2 h}, \qquad \|q - J d\| > 5 e, \qquad
          e = \frac{\|r(U + h d) - 2 r(U) + r(U - h d)\|}{2 h}

along the last step d. A J that UFL has derived has all terms and the right sign, but F may have a
kink, or data that change with u. PETSc's ``-snes_test_jacobian`` takes a quotient for each dof,
ignores condensed fields, and only prints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.diagnosis.advice import Advice
from dolfinx_feti.problems.equations.state import StateValues
from dolfinx_feti.problems.equations.system import Residual, System
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.iteration.failures import NO_STEP_LENGTH, NewtonFailure, Outcome
from dolfinx_feti.problems.iteration.iterate import Direction, Iterate
from dolfinx_feti.problems.iteration.line import Trial
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import warn
from dolfinx_feti.runtime.norms import dot, max_norm, norm

Reason = PETSc.SNES.ConvergedReason

#: Reasons of a solve that took steps, but got no closer: J may be the cause.
NOT_CLOSER = (Reason.DIVERGED_MAX_IT, Reason.DIVERGED_LINE_SEARCH)

#: What the numbers of an advice are, for its text.
QUANTITY = "difference of J from the derivative of F"

#: Multiple of e above which a difference is a mismatch. With the right J ‖q − J d‖ was 1e-4 e at
#: most, with a wrong one, in slow steps, above 10 e.
MISMATCH_FACTOR = 5.0

#: h |d| over |u|, of the largest entries: the best for a central difference quotient, ε^⅓.
RELATIVE_STEP = float(np.cbrt(np.finfo(float).eps))

#: |cos| of the angle between d and q − J d below which the two count as orthogonal: above rounding,
#: and below the values of other mismatches.
ORTHOGONAL_COSINE = 1e-4

#: Share of ‖r‖ by which r at the same state has to change for a coefficient to be the cause. It is
#: a margin above rounding, not measured.
CHANGED_SHARE = 1e-3

#: ‖q − c J d‖/‖q‖ below which J d is a multiple of the derivative along d. With c < 0 Newton's
#: method fails, whatever the rest of J is. At 0.2 no other mismatch was taken for a wrong sign
#: either; at 1e-4 a J of the wrong sign that lacks a term as well is missed.
PROPORTIONAL_RTOL = 0.1

#: Number of consecutive slow steps after which J is compared.
SLOW_STEPS = 3

#: A step is slow if it leaves more than this share of ‖r‖. Quadratic convergence leaves less.
SLOW_REDUCTION = 0.03

#: Beginning of the messages of a finding.
NO_DERIVATIVE = "J is not the derivative of F along the last step"


class Cause(Enum):
    """Why J differs from the derivative; the value is the cause with its remedy, in words."""

    FREE_RIM = (
        "J is the symmetric part of the derivative, as with the tangent of a pressure whose "
        "surface has a free rim: take follower_pressure_tangent(…, bcs=bcs), or kind='full'."
    )
    MISSING_TERM = (
        "J lacks a term of F, such as the tangent of a pressure: add it, or leave J out, which is "
        "derived then."
    )
    WRONG_SIGN = (
        "J has the wrong sign: give J = ufl.derivative(F, u), and not its negative, or leave J "
        "out, which is derived then."
    )
    CONSTANT_RESIDUAL = (
        "F does not change with u at all: pass before_assembly=update, a function that updates "
        "what F holds, such as a stress from outside of UFL."
    )
    CHANGED_COEFFICIENT = (
        "A coefficient of F changes with u from step to step, as in a monitor: write it as an "
        "expression in u, update it in before_assembly=, or change it between solves."
    )
    KINK = (
        "F has a kink in u ({0}), across which the tangent jumps, as where fibres slacken: smooth "
        "it, such as the positive part of x by (x + sqrt(x**2 + e**2))/2, soften the penalty, or "
        "take smaller steps."
    )
    HIDDEN_DEPENDENCE = (
        "F changes with u in a way that its derivative does not see: write what depends on u as an "
        "expression in u, or give J."
    )


@dataclass(frozen=True, slots=True)
class Finding:
    """A mismatch of J.

    Attributes:
        cause: Its likely cause.
        advice: The remedy in words, a number, and its threshold. The number is ‖q − J d‖/‖q‖, and
            the threshold its error e/‖q‖. For a coefficient that changes, the number is the
            relative change of r at one state, and the threshold ``CHANGED_SHARE``.
    """

    cause: Cause
    advice: Advice


class TangentCheck:
    """Comparison of J with the derivative when something is wrong with a solve.

    J is compared

    * at most once in each solve, after slow steps, or else after a failure;
    * once in all solves, if J is the user's, after the first suspect step: one that had to be
      shifted, or along which d·r has grown.

    No comparison follows one that has found a mismatch.

    Attributes:
        findings: The mismatch that was found in this or an earlier solve; empty if none was.
    """

    def __init__(self, system: System) -> None:
        """Create the check of a system, for all its solves."""
        self.findings: list[Finding] = []
        self._system = system
        self._is_sign_checked = False  # True once J was compared after a suspect step of any solve
        # of the present solve, set back by ``begin``
        self._last_du: Array = np.zeros(system.owned)
        self._has_suspect_step = False  # since the last comparison
        self._is_slow_checked = False  # True once J was compared after slow steps

    def begin(self) -> None:
        """Prepare the check for a solve."""
        self._last_du = np.zeros(self._system.owned)
        self._has_suspect_step = False
        self._is_slow_checked = False

    @property
    def _is_done(self) -> bool:
        """Whether this solve needs no further comparison."""
        return self._is_slow_checked or bool(self.findings)

    @property
    def has_wrong_sign(self) -> bool:
        """Whether J was found to be a negative multiple of the derivative."""
        return any(finding.cause is Cause.WRONG_SIGN for finding in self.findings)

    def add_step(self, direction: Direction, trial: Trial) -> None:
        """Store a step, and whether it is suspect."""
        self._last_du = direction.du
        if self._system.forms.has_given_tangent and not self._is_sign_checked:
            self._has_suspect_step |= trial.ratio > 1.0 or direction.is_shifted

    def compare_if_needed(self, iterate: Iterate, history: Sequence[NewtonStep]) -> None:
        """Compare J after slow or suspect steps. Collective.

        The matrix holds the tangent of the iterate, without a shift.
        """
        if not self._is_done and _is_slow(iterate, history):
            self._is_slow_checked = True
            self._compare(iterate.residual)
        if not self._is_done and self._has_suspect_step:
            self._has_suspect_step = False
            self._is_sign_checked = True
            self._compare(iterate.residual)

    def require_right_sign(self, history: Sequence[NewtonStep]) -> None:
        """Raise an error after a step if J has the wrong sign: no further step can help.

        Raises:
            NewtonFailure: J has the wrong sign; :meth:`explain` adds that to its message.
        """
        if history and self.has_wrong_sign:
            raise NewtonFailure(NO_STEP_LENGTH)

    def explain(
        self, failure: NewtonFailure, history: Sequence[NewtonStep], *, is_displacement: bool
    ) -> Outcome:
        """Return the outcome of a failed solve, with its cause if that is in J or F. Collective.

        A tangent of the wrong sign may leave no direction at all; with other causes in J or F
        Newton's method gets no closer to the solution.

        Args:
            failure: The failure.
            history: Steps of the solve.
            is_displacement: Whether the unknown is a displacement, which the remedy depends on.
        """
        system = self._system
        reason = failure.kind.reason
        has_no_direction = reason == Reason.DIVERGED_LINEAR_SOLVE and system.forms.has_given_tangent
        is_not_closer = reason in NOT_CLOSER and bool(history)
        if not self._is_done and (is_not_closer or has_no_direction):
            system.linearise()
            residual = system.residual()
            if not history:  # no step was taken: compare along the direction of steepest descent
                self._last_du = system.tangent.divide_by_diagonal(residual.condensed)
            self._compare(residual)
        if self.has_wrong_sign:
            reason = Reason.DIVERGED_LINE_SEARCH
        remedy = failure.remedy(is_displacement=is_displacement)
        outcome = Outcome(reason, f"{failure.cause}: {remedy}", failure.kind.error)
        if reason not in NOT_CLOSER:
            return outcome
        if self.findings:
            text = f"{failure.cause}: {NO_DERIVATIVE}: {self.findings[0].advice}"
            return replace(outcome, message=text)
        if system.forms.kinks:
            text = f"{outcome.message}. If that does not help: {_kink(system)}"
            return replace(outcome, message=text)
        return outcome

    def _compare(self, residual: Residual) -> None:
        """Compare J with the derivative along the last ΔU, and log a mismatch. Collective."""
        system = self._system
        if system.has_contacts and not system.forms.has_given_tangent:
            return  # a difference quotient across points that come to touch is no derivative
        finding = find_mismatch(system, residual, self._last_du)
        if finding is None:
            return
        self.findings.append(finding)
        if finding.cause is not Cause.WRONG_SIGN:  # which ends the solve, with this text
            warn(f"{NO_DERIVATIVE}: {finding.advice}", system.comm)


def _is_slow(iterate: Iterate, history: Sequence[NewtonStep]) -> bool:
    """Return True if each of the last steps left more than a share of ‖r‖."""
    norms = np.array([*(step.residual for step in history[-SLOW_STEPS:]), iterate.norm])
    before = norms[:-1]
    after = norms[1:]
    is_slow = (SLOW_REDUCTION * before < after) & (after < before)
    return len(after) == SLOW_STEPS and bool(np.all(is_slow))


def find_mismatch(system: System, residual: Residual, d: Array) -> Finding | None:
    """Compare the tangent with a difference quotient; None if no mismatch is certain. Collective.

    Args:
        system: The equations; the matrix holds the tangent at the present state, without a shift.
        residual: Residual that Newton's method has used at this state.
        d: Last increment of u, (owned,).
    """
    free = system.conditions.free
    d = free(d)
    r = free(residual.force)
    h = _step_size(system, d)
    if h is None:
        return None
    # with the condensed fields along: δp = −K_pp⁻¹ K_pu d
    dp = system.increment(residual, d).p - system.increment(residual, 0.0 * d).p
    ahead, behind = _residuals_around(system, h * d, h * dp)
    q = np.divide(ahead - behind, 2 * h)
    curvature = norm(system.comm, (ahead + behind - 2 * r) / 2)  # e h
    if curvature > CHANGED_SHARE * norm(system.comm, r):
        change = _change_at_same_state(system, r)
        if change > CHANGED_SHARE:
            return _finding(Cause.CHANGED_COEFFICIENT, change, CHANGED_SHARE)
    Jd = free(system.tangent.multiply(d))
    mismatch = norm(system.comm, q - Jd)
    error = curvature / h  # e
    if not mismatch > MISMATCH_FACTOR * error:
        return None
    size = norm(system.comm, q)
    if size == 0.0:
        size = norm(system.comm, Jd)
    if system.condensation is not None:  # subtract all but K_uu d: J is the form of K_uu
        ahead, behind = _residuals_around(system, 0.0 * d, h * dp)
        by_fields = np.divide(ahead - behind, 2 * h)  # K_up δp
        q = q - by_fields
        Jd = Jd - by_fields
    cause = _cause(system, q, Jd, d)
    return _finding(cause, mismatch / size, error / size, kinks=system.forms.kinks)


def _finding(cause: Cause, value: float, threshold: float, *, kinks: Sequence[str] = ()) -> Finding:
    """Return a finding with its advice."""
    text = cause.value.format(", ".join(kinks))
    return Finding(cause, Advice(text, QUANTITY, value, threshold))


def _kink(system: System) -> str:
    """Return the remedy for the kinks of F."""
    return Cause.KINK.value.format(", ".join(system.forms.kinks))


def _step_size(system: System, d: Array) -> float | None:
    """Return h of the difference quotient along d, (owned,); None if d is zero or not finite."""
    largest_u = max_norm(system.comm, system.state.values().u)
    largest_d = max_norm(system.comm, d)
    size = max(largest_u, largest_d)  # u may be zero
    if not 0.0 < largest_d * size < np.inf:
        return None
    return RELATIVE_STEP * size / largest_d


def _change_at_same_state(system: System, r: Array) -> float:
    """Return how much r, (owned,), assembled anew differs from r, relative to it. Collective."""
    again = system.conditions.free(system.residual().force)
    return norm(system.comm, again - r) / norm(system.comm, r)


def _residuals_around(system: System, du: Array, dp: Array) -> tuple[Array, Array]:
    """Return r_u(U + δ) and r_u(U − δ), (owned,), zero on Dirichlet dofs. Collective.

    Args:
        system: The equations, at U, where they are afterwards.
        du: Change of u, (owned,).
        dp: Change of the condensed fields, as in :class:`StateValues`.
    """
    origin = system.state.values()
    change = StateValues(du, dp, np.zeros_like(origin.s))
    residuals = []
    for sign in (1.0, -1.0):
        system.state.set(origin.moved(sign, change))
        residuals.append(system.conditions.free(system.residual().force))
    system.state.set(origin)
    return residuals[0], residuals[1]


def _cause(system: System, q: Array, Jd: Array, d: Array) -> Cause:
    """Return the likely cause of a mismatch. Collective.

    Args:
        system: The equations.
        q: Derivative of the residual along d, (owned,), zero on Dirichlet dofs.
        Jd: J d, (owned,), zero on Dirichlet dofs.
        d: The direction, (owned,), zero on Dirichlet dofs.
    """
    forms = system.forms
    if not forms.has_given_tangent:
        return Cause.KINK if forms.kinks else Cause.HIDDEN_DEPENDENCE
    if not norm(system.comm, q) > 0.0:
        return Cause.CONSTANT_RESIDUAL
    if is_opposite(system, q, Jd):
        return Cause.WRONG_SIGN
    missed = q - Jd
    threshold = ORTHOGONAL_COSINE * norm(system.comm, d) * norm(system.comm, missed)
    is_orthogonal = abs(dot(system.comm, d, missed)) <= threshold
    return Cause.FREE_RIM if is_orthogonal else Cause.MISSING_TERM


def is_opposite(system: System, q: Array, Jd: Array) -> bool:
    """Return True if the derivative is a negative multiple of the tangent along d. Collective.

    Args:
        system: The equations.
        q: Derivative of the residual along d, (owned,).
        Jd: J d, (owned,).
    """
    square = dot(system.comm, Jd, Jd)
    if not square > 0.0:
        return False
    factor = dot(system.comm, q, Jd) / square
    error = norm(system.comm, q - factor * Jd)
    return factor < 0.0 and error <= PROPORTIONAL_RTOL * norm(system.comm, q)
