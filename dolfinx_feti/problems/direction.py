# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The direction of a Newton step: down a potential, if there is one (docs/theory.md).

.. math:: (K' + σ \operatorname{diag}|k|)\, ΔU = -r

with the stiffness k of the dofs, and σ growing until no negative eigenvalue can be proved and ΔU
leads downhill, ΔU·r < 0. A singular tangent counts as indefinite. A linear solve that stagnates
below 1e-3 of the residual leads on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from petsc4py import PETSc

from dolfinx_feti.feti.solver import FETI
from dolfinx_feti.problems.history import Stop, proved_negative
from dolfinx_feti.problems.system import Residual, System
from dolfinx_feti.runtime.arrays import Array

Reason = PETSc.KSP.ConvergedReason

#: So many plain steps with an indefinite tangent may follow those that have moved the boundary.
PATIENCE = 3

#: Share of the residual down to which a linear solve that stagnates there leads on.
CLOSE = 1e-3

#: The first shift, its growth, and the largest one that is tried.
LEAST_SHIFT, SHIFT_GROWTH = 1e-4, 4.0
LARGEST_SHIFT = LEAST_SHIFT * SHIFT_GROWTH**7


@dataclass(frozen=True, slots=True)
class Direction:
    """Where a Newton step leads, and what that has cost (:class:`NewtonStep`)."""

    du: Array  # ΔU, (owned,)
    shift: float
    iterations: tuple[int, ...]  # of each linear solve
    indefinite: int | None
    plain: bool  # may it lead anywhere, and not only down the potential?


class Directions:
    """The directions of the steps of a solve."""

    def __init__(
        self, system: System, *, moved: bool, refuse: bool, guess: bool, shortens: bool
    ) -> None:
        """Begin a solve.

        Args:
            system: The system.
            moved: Whether the solve moves the boundary.
            refuse: Whether to end where its first tangent is indefinite.
            guess: Whether it begins in a guess, where a singular tangent lacks no support.
            shortens: Whether the caller has a shorter way if a linear solve fails.
        """
        self._system, self._shift, self._patience = system, 0.0, PATIENCE if moved else 0
        self._refuse, self._guess, self._shortens, self._first = refuse, guess, shortens, True

    def along(self, ksp: PETSc.KSP, here: Residual, *, moves: bool) -> Iterator[Direction]:
        """Yield one direction after the other, until one of them leads on.

        The matrix of the linear solver holds the tangent; ``moves`` tells whether the step moves
        the boundary.

        Raises:
            Stop: There is no other.
        """
        system, feti = self._system, ksp.getPythonContext()
        first, self._first = self._first, False
        refuse = self._refuse and first and not system.scalars.size  # who lead on where K does not
        indefinite, iterations, leads = None, [], False
        for sigma, plain in self._tries(moves=moves):
            system.shift(sigma)
            feti.refuse_indefinite = not plain or refuse
            du = system.scalars.solve(ksp, system.A, here.equations, here.scalar)
            reason = ksp.getConvergedReason()
            failed = reason == Reason.DIVERGED_PCSETUP_FAILED
            if sigma == 0.0:
                indefinite = proved_negative(feti)
                system.is_held |= not failed
            if reason != Reason.DIVERGED_INDEFINITE_MAT:
                iterations.append(feti.iterations)
            elif refuse:
                raise Stop("poor guess")
            close = reason == Reason.DIVERGED_BREAKDOWN and feti.residual <= CLOSE
            leads = (reason > 0 or close) and (plain or system.dot(du, here.condensed) < 0.0)
            if leads:
                self._shift = fallen(sigma, grown=sigma > self._shift)
                self._patience -= plain and not moves and indefinite != 0
                yield Direction(du, sigma, tuple(iterations), indefinite, plain)
                iterations = []
            elif failed and (first or not feti.singular):
                break
        self._shift = 0.0
        raise Stop("no step") if leads else self._linear_failure(feti)

    def _tries(self, *, moves: bool) -> Iterator[tuple[float, bool]]:
        """Yield the shifts to be tried, and whether the direction is a plain one.

        With a potential the plain one comes last, but while prescribed displacements move and for a
        few steps after that. Without one a shift is what is left where the plain solve fails.
        """
        down = self._system.has_potential
        plain_first = not down or moves or self._patience > 0
        if plain_first:
            yield 0.0, True
        sigma: float | None = self._shift if down else LEAST_SHIFT
        while sigma is not None and not moves and (down or not self._shortens):
            yield sigma, False
            sigma = raised(sigma)
        if not plain_first:
            yield 0.0, True

    def _linear_failure(self, feti: FETI) -> Stop:
        """Say why there is no direction, and what helps."""
        if not feti.message:
            return Stop("indefinite")
        on_the_way = self._system.is_held or self._guess
        if feti.singular and on_the_way:
            return Stop("singular")
        if on_the_way and (proved_negative(feti) or 0) > 0:
            return Stop("trial", feti.message.rstrip("."))
        return Stop("linear", feti.message)


def raised(sigma: float) -> float | None:
    """Return the next larger shift, or None if there is none to try."""
    larger = max(LEAST_SHIFT, SHIFT_GROWTH * sigma)
    return larger if larger <= LARGEST_SHIFT else None


def fallen(sigma: float, *, grown: bool) -> float:
    """Return the shift with which the next Newton step begins; it falls less if it had to grow."""
    smaller = sigma / (SHIFT_GROWTH if grown else SHIFT_GROWTH**2)
    return smaller if smaller >= LEAST_SHIFT / SHIFT_GROWTH else 0.0
