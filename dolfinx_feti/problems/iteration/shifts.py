# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The directions of Newton's method: shifts of the tangent that lead downhill (docs/theory.md).

.. math:: (K' + σ \operatorname{diag}|k|)\, ΔU = -r

With a potential, σ grows until no negative eigenvalue can be proved any more and ΔU leads downhill,
ΔU·r < 0. Plain Newton steps converge to saddle points as readily as to minima, and the equilibria
that a body assumes are minima. A singular tangent counts as indefinite. Without a potential, shifts
are tried only if the solve without a shift fails.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum, auto

from petsc4py import PETSc

from dolfinx_feti.feti.solver import FETI
from dolfinx_feti.problems.equations.system import System
from dolfinx_feti.problems.history import proved_negative
from dolfinx_feti.problems.iteration.early_end import EarlyEnd
from dolfinx_feti.problems.iteration.failures import (
    INDEFINITE,
    INDEFINITE_START,
    INDEFINITE_TRIAL,
    LINEAR_SOLVER,
    NO_STEP_LENGTH,
    SINGULAR_TRIAL,
    NewtonFailure,
)
from dolfinx_feti.problems.iteration.iterate import Direction, Iterate, Start
from dolfinx_feti.problems.iteration.support import KnownSupport
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.norms import dot
from dolfinx_feti.runtime.petsc_errors import python_errors

KSPReason = PETSc.KSP.ConvergedReason

#: σ of each level: none, and 2.5e-5 to 1.6 by factors of 4. Beyond 1.6 the direction is that of
#: steepest descent, scaled by the diagonal.
SHIFTS = (0.0, *(1e-4 * 4.0**k for k in range(-1, 8)))

#: Level of the first shift that is tried, σ = 1e-4. The level below it, σ = 2.5e-5, is used only in
#: a step that follows one with a larger shift.
FIRST_LEVEL = 2

#: Number of steps with an indefinite tangent, after those that moved prescribed values, whose
#: direction need not lead downhill: the body follows its boundary through states that are no
#: equilibria. At 0 a cube that slides and is pulled at once takes 17 steps instead of at most 6
#: (test_cold_start).
FREE_STEPS = 3


@dataclass(frozen=True, slots=True)
class Attempt:
    """A shift to try."""

    level: int  # of SHIFTS
    #: Whether ΔU has to lead downhill. If not, the tangent may also be indefinite.
    requires_descent: bool

    @property
    def shift(self) -> float:
        """σ."""
        return SHIFTS[self.level]


class LinearOutcome(Enum):
    """How the linear solve of an attempt has ended."""

    USABLE = auto()  # a step along ΔU may follow
    UPHILL = auto()  # solved, but ΔU does not lead downhill
    INDEFINITE = auto()  # refused: a negative eigenvalue is proved, mostly before any iteration
    NOT_FACTORED = auto()  # the set-up failed, as with a singular tangent (``FETI.singular``)
    NOT_SOLVED = auto()  # the Krylov method failed


class ShiftedDirections:
    """The directions of the steps of one solve.

    Attributes:
        lacks_support: Whether the last tangent without a shift was singular although there are
            contacts: they do not support the body yet.
    """

    def __init__(
        self,
        system: System,
        ksp: PETSc.KSP,
        start: Start,
        first: Iterate,
        *,
        early_end: EarlyEnd,
        support: KnownSupport,
    ) -> None:
        """Create the directions of a solve.

        Args:
            system: The equations.
            ksp: KSP with a FETI context.
            start: How the solve begins.
            first: Its first iterate.
            early_end: Its rules for an early end.
            support: The conditions that are known to support the body; regular tangents are noted.
        """
        self.lacks_support = False
        self._system = system
        self._ksp = ksp
        self._feti: FETI = ksp.getPythonContext()
        self._early_end = early_end
        self._support = support
        self._follows_equilibrium = start.follows_equilibrium
        self._level = 0  # where the next step begins
        self._free_steps_left = FREE_STEPS if first.violates_constraints else 0

    def directions(self, iterate: Iterate, *, is_first: bool) -> Iterator[Direction]:
        """Yield directions in the order of :meth:`_attempts`.

        The caller asks for another one only if the last has no step length. Each direction sets the
        level where the next step begins; that of the last one counts.

        Args:
            iterate: Where the step begins; the matrix holds its tangent.
            is_first: Whether it is the first step of the solve.

        Raises:
            NewtonFailure: No further shift helps.
        """
        refuses_indefinite = self._refuses_indefinite(is_first=is_first)
        indefinite: int | None = None  # negative eigenvalues of the tangent without a shift
        iterations: list[int] = []  # of each linear solve since the last direction
        outcome = LinearOutcome.NOT_SOLVED
        for attempt in self._attempts(iterate):
            du, ds = self._solve(attempt, iterate, refuses_indefinite=refuses_indefinite)
            outcome = self._linear_outcome(attempt, du, iterate)
            if attempt.level == 0:
                indefinite = proved_negative(self._feti)
                self._note_support(outcome)
            if outcome is LinearOutcome.INDEFINITE:
                if refuses_indefinite:
                    raise NewtonFailure(INDEFINITE_START)
                continue  # not recorded as a solve: mostly it ends before any iteration
            iterations.append(self._feti.iterations)
            if outcome is LinearOutcome.USABLE:
                self._choose_next_level(attempt)
                self._count_free_step(attempt, iterate, indefinite)
                yield Direction(
                    du,
                    ds,
                    shift=attempt.shift,
                    iterations=tuple(iterations),
                    indefinite=indefinite,
                    is_descent=attempt.requires_descent,
                )
                iterations = []
            elif outcome is LinearOutcome.NOT_FACTORED:
                if not self._shift_may_help(is_first=is_first):
                    break
        if outcome is LinearOutcome.USABLE:  # but the last direction has no step length
            raise NewtonFailure(NO_STEP_LENGTH)
        raise self._linear_failure()

    def _refuses_indefinite(self, *, is_first: bool) -> bool:
        """Return True if an indefinite tangent ends the solve.

        With scalars none does: they may stabilise it.
        """
        has_scalars = self._system.scalars.size > 0
        return self._early_end.refuses_first_tangent and is_first and not has_scalars

    def _attempts(self, iterate: Iterate) -> list[Attempt]:
        """Return the shifts to try, in their order.

        The *plain solve* has no shift, accepts an indefinite tangent, and need not lead downhill.
        The *shifts* begin at the level that the last step has chosen, which may be no shift.

        ============  =======================  ====================================================
        potential     constraints              attempts
        ============  =======================  ====================================================
        any           violated                 the plain solve alone
        yes           met a few steps ago      the plain solve, then the shifts
        yes           met                      the shifts, then the plain solve
        no            met, early end allowed   the plain solve alone: a load step is cheaper
        no            met                      the plain solve, then the shifts
        ============  =======================  ====================================================
        """
        has_potential = self._system.has_potential
        plain = Attempt(0, requires_descent=False)
        if iterate.violates_constraints:
            return [plain]
        if not has_potential and self._early_end.is_allowed:
            return [plain]
        # the level chosen by the step before, and then all levels above it from FIRST_LEVEL on
        first_level = self._level if has_potential else FIRST_LEVEL
        levels = [first_level, *range(max(FIRST_LEVEL, first_level + 1), len(SHIFTS))]
        shifts = [Attempt(level, requires_descent=True) for level in levels]
        if not has_potential or self._free_steps_left > 0:
            return [plain, *shifts]
        return [*shifts, plain]

    def _solve(
        self, attempt: Attempt, iterate: Iterate, *, refuses_indefinite: bool
    ) -> tuple[Array, Array]:
        """Solve with the tangent and a shift. Collective.

        Returns:
            ΔU, (owned,), and Δs, (m,), converged or not.
        """
        system = self._system
        residual = iterate.residual
        system.tangent.set_shift(attempt.shift)
        allow_indefinite = not attempt.requires_descent and not refuses_indefinite
        settings = replace(self._feti.settings, allow_indefinite=allow_indefinite)
        with self._feti.solving_with(settings), python_errors(self._ksp):
            du, ds = system.scalars.solve(
                self._ksp, system.tangent.A, residual.of_u, residual.of_scalars
            )
        return system.tangent.remove_null_space(du), ds

    def _linear_outcome(self, attempt: Attempt, du: Array, iterate: Iterate) -> LinearOutcome:
        """Return how the last linear solve has ended. Collective.

        Args:
            attempt: Its shift, and whether ΔU has to lead downhill.
            du: Its solution ΔU, (owned,).
            iterate: Where the step begins.
        """
        reason = self._ksp.getConvergedReason()
        if reason == KSPReason.DIVERGED_INDEFINITE_MAT:
            return LinearOutcome.INDEFINITE
        if reason == KSPReason.DIVERGED_PCSETUP_FAILED:
            return LinearOutcome.NOT_FACTORED
        if reason <= 0:
            return LinearOutcome.NOT_SOLVED
        if attempt.requires_descent:
            slope = dot(self._system.comm, du, iterate.residual.condensed)
            if not slope < 0.0:
                return LinearOutcome.UPHILL
        return LinearOutcome.USABLE

    def _note_support(self, outcome: LinearOutcome) -> None:
        """Record whether the tangent without a shift was singular."""
        is_factored = outcome is not LinearOutcome.NOT_FACTORED
        if is_factored:
            self._support.note(self._system)
        is_singular = not is_factored and self._feti.singular
        self.lacks_support = is_singular and self._system.has_contacts

    def _choose_next_level(self, attempt: Attempt) -> None:
        """Choose the level where the next step begins: σ/16, or σ/4 if σ had to grow now."""
        has_grown = attempt.level > self._level
        self._level = max(0, attempt.level - (1 if has_grown else 2))

    def _count_free_step(self, attempt: Attempt, iterate: Iterate, indefinite: int | None) -> None:
        """Count a step that need not lead downhill, if the tangent may be indefinite."""
        if attempt.requires_descent or iterate.violates_constraints:
            return
        if indefinite is None or indefinite > 0:
            self._free_steps_left -= 1

    def _shift_may_help(self, *, is_first: bool) -> bool:
        """Return True if a larger shift may be factored where the last tangent was not."""
        if not self._feti.singular:
            return False  # the set-up failed for another reason
        return self._system.has_contacts or not is_first  # else the body lacks a support

    def _linear_failure(self) -> NewtonFailure:
        """Return why no attempt gave a direction, by the last linear solve."""
        feti = self._feti
        has_support = self._support.is_known(self._system) or self._follows_equilibrium
        if not feti.message:  # nothing failed: ΔU led uphill, or an indefinite tangent was refused
            return NewtonFailure(INDEFINITE)
        if feti.singular and has_support:
            return NewtonFailure(SINGULAR_TRIAL)
        if has_support and (proved_negative(feti) or 0) > 0:
            return NewtonFailure(INDEFINITE_TRIAL, feti.message.rstrip("."))
        return NewtonFailure(LINEAR_SOLVER, feti.message)
