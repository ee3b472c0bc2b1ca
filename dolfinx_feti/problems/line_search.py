# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The step length α of a Newton step ΔU.

α is one unless the trial state U + α ΔU turns a cell inside out, meets a NaN, or overshoots: with
:math:`g(α) = ΔU·r(U + α ΔU)` a step is taken once

.. math:: -η ≤ g(α)/g(0) ≤ 1 + η,

a search for the critical point of the energy along the step. With a condensed pressure, g(α) holds
:math:`r_u(U + α ΔU, p + α Δp)` and not the condensed residual: what condensation adds grows with κ,
though it is linear in Δp and the next step removes it.

If the problem has a potential Π (the strain energy, with the load's part), a step is taken if it
lowers Π enough (Armijo),

.. math:: Π(U + α ΔU) ≤ Π(U) + 10^{-4}\, α\, ΔU·r,

with the condensed pressure that its own equation demands for either state; g then counts only while
prescribed displacements move, and where the change of Π drowns in rounding. A step that a shift has
made too short, :math:`g(α) > 0.9\, g(0)`, is doubled while Π falls (Wolfe's second condition).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.problems.system import Residual, System

__all__ = ["LineSearchResult", "line_search"]

Array = npt.NDArray[np.float64]

#: η: by how much g(α)/g(0) of an accepted step may leave the interval from zero to one.
ETA = 0.8

#: Shortest step that is tried, and the longest with a shift.
SHORTEST, LONGEST = 1.0 / 1024, 16.0

#: By what factors a step is shortened at least and at most.
HALF, TENTH = 0.5, 0.1

#: Where g(α)/g(0) is still above this, a step with a shift is too short (Wolfe).
CURVATURE_CONDITION = 0.9

#: Share of the potential below which its change is rounding.
POTENTIAL_ROUNDING = 1e-9

#: Share of the greatest displacement below which one of a Dirichlet dof is rounding.
MOVED = 1e-10

#: Share of the slope by which a step has to lower the potential (Armijo).
DESCENT = 1e-4


@dataclass(frozen=True, slots=True)
class LineSearchResult:
    """Where a line search ends.

    Attributes:
        alpha: α; zero if no step length is admissible.
        residual: The residual at U + α ΔU, the present state.
        potential: Π there; nan if it is not known.
    """

    alpha: float
    residual: Residual
    potential: float


@dataclass(frozen=True, slots=True)
class _Trial:
    """A state U + α ΔU that is tried.

    Attributes:
        alpha: α.
        residual: The residual there; None where a cell is inside out.
        ratio: g(α)/g(0); nan where a cell is inside out.
        accepted: Whether the step may end there.
        potential: Π there; nan if nobody had to know.
    """

    alpha: float
    residual: Residual | None
    ratio: float
    accepted: bool
    potential: float = np.nan


def line_search(
    system: System, residual: Residual, du: Array, *, lengthen: bool, potential: float = np.nan
) -> LineSearchResult:
    """Find a step length, and move there; stay if none is admissible.

    Args:
        system: The system; its state is the one where the step begins, then the one where it ends.
        residual: Its residual where the step begins.
        du: ΔU, (owned,).
        lengthen: Whether a step that is too short may be doubled.
        potential: Π where the step begins; nan if it is not known.

    Note:
        Collective.
    """
    start = system.state()
    if system.has_potential and np.isnan(potential):
        potential = system.potential()
    move = _mover(system, residual, du, potential)
    trial = move(1.0)
    while not trial.accepted:
        shorter = trial.alpha * _shortening(trial.ratio)
        if shorter < SHORTEST:
            system.set_state(start)
            return LineSearchResult(0.0, residual, potential)
        trial = move(shorter)
    while lengthen and trial.ratio > CURVATURE_CONDITION and 1.0 <= trial.alpha < LONGEST:
        longer = move(2.0 * trial.alpha)
        if not longer.accepted:
            trial = move(trial.alpha)
            break
        trial = longer
    assert trial.residual is not None
    return LineSearchResult(trial.alpha, trial.residual, trial.potential)


def _mover(
    system: System, residual: Residual, du: Array, height: float
) -> Callable[[float], _Trial]:
    """Return the function that goes to U + α ΔU and judges the state there."""
    start, step = system.state(), system.increment(residual, du)
    slope = system.dot(du, residual.condensed)  # g(0) < 0
    only_down = abs(slope) > POTENTIAL_ROUNDING * abs(height) and not _moves_boundary(system, du)

    def move(alpha: float) -> _Trial:
        system.set_state((start[0] + alpha * step[0], start[1] + alpha * step[1]))
        if system.least_volume_ratio() <= 0.0:
            return _Trial(alpha, None, np.nan, accepted=False)
        moved = system.residual()
        ratio = system.dot(du, moved.force) / slope if slope else 0.0  # g(α)/g(0)
        accepted, there = not only_down and -ETA <= ratio <= 1.0 + ETA, np.nan
        if not accepted and system.has_potential:
            there = system.potential()
            accepted = there <= height + DESCENT * alpha * slope
        return _Trial(alpha, moved, ratio, accepted, there)

    return move


def _moves_boundary(system: System, du: Array) -> bool:
    """Tell whether an increment, (owned,), moves Dirichlet dofs beyond rounding. Collective."""
    most, moved = (
        system.comm.allreduce(float(np.abs(part).max(initial=0.0)), op=MPI.MAX)
        for part in (du, du[system.dirichlet])
    )
    return moved > MOVED * most


def _shortening(ratio: float) -> float:
    """Return the factor of the next, shorter step: to the zero of the line through g, in bounds."""
    secant = 1.0 / (1.0 - ratio) if ratio < 0.0 else HALF
    return min(max(secant, TENTH), HALF)
