# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The step length α of a Newton step ΔU (docs/theory.md).

α is one unless the trial state turns a cell inside out, meets a NaN, or overshoots:

.. math:: -η ≤ g(α)/g_0 ≤ 1 + η, \qquad g(α) = ΔU_f·r_f(U + α ΔU), \qquad
          g_0 = ΔU_f·(r_f + K_{fD}\, ΔU_D), \qquad Π(U + α ΔU) ≤ Π_m + 10^{-4}\, α\, ΔU·r

with forces before condensation, and Armijo's rule where a potential has a say. SNES's ``cp`` and
``bt`` search without det F, add lengths u − g to forces, and know no Π.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dolfinx_feti.problems.system import Residual, System
from dolfinx_feti.runtime.arrays import Array

#: η: by how much g(α)/g(0) of an accepted step may leave the interval from zero to one.
ETA = 0.8

#: Shortest step that is tried out of where the problem is defined, and the longest with a shift.
SHORTEST, LONGEST = 1.0 / 1024, 16.0

#: How often a step that overshoots is shortened: a first tangent can be far too soft.
TRIALS = 40

#: Once a step has overshot: by how much g(α)/g(0) may be below zero, or the ratio of two α around.
CLOSE, TIGHT = 0.25, 1.3

#: By what factors a step is shortened at least and at most.
HALF, TENTH = 0.5, 0.1

#: Where g(α)/g(0) is still above this, a step with a shift, or after a longer one, is too short.
WOLFE = 0.9

#: Share of the potential below which its change is rounding.
POTENTIAL_ROUNDING = 1e-9

#: Share of the slope by which a step has to lower the potential (Armijo).
DESCENT = 1e-4


@dataclass(frozen=True, slots=True)
class Trial:
    """A state U + α ΔU, the present one; where a cell is inside out, with the first residual."""

    alpha: float  # zero where a search ends without an admissible step length
    residual: Residual
    ratio: float = np.nan  # g(α)/g(0)
    accepted: bool = False  # may the step end there?
    potential: float = np.nan  # Π, if it is known


def line_search(
    system: System,
    residual: Residual,
    du: Array,
    *,
    shifted: bool,
    height: float = np.nan,
    highest: float = -np.inf,
    early: bool = False,
) -> Trial:
    """Find a step length along ΔU, (owned,), and move there; stay if none is admissible.

    A step that is ``shifted`` leads downhill, but the shift may have made it too short. ``height``
    is Π where the step begins, nan if it does not matter; ``highest``, that of the last states, if
    it is higher; ``early``, whether to give up early a step that overshoots, too. Collective.
    """
    start = system.state()
    highest = height if shifted else max(height, highest)
    move = _mover(system, residual, du, height, highest, shifted=shifted)
    trial, overshot, trials = move(1.0), False, 1
    low, high = Trial(0.0, residual, 1.0), trial
    while not trial.accepted or (overshot and not -CLOSE <= trial.ratio <= WOLFE):
        overshot |= trial.ratio < -ETA
        if trial.accepted and trial.ratio > 0.0:
            low = trial
        else:
            high = trial
        if high.alpha <= TIGHT * low.alpha:
            return low if low is trial else move(low.alpha)
        alpha = _between(low, high)
        if trials == TRIALS or (alpha < SHORTEST and (early or np.isnan(trial.ratio))):
            system.set_state(start)
            return Trial(0.0, residual, potential=height)
        trial, trials = move(alpha), trials + 1
    while shifted and trial.ratio > WOLFE and 1.0 <= trial.alpha < LONGEST:
        longer = move(2.0 * trial.alpha)
        if not longer.accepted:
            trial = move(trial.alpha)
            break
        trial = longer
    return trial


def _mover(
    system: System, residual: Residual, du: Array, height: float, highest: float, *, shifted: bool
) -> Callable[[float], Trial]:
    """Return the function that goes to U + α ΔU and judges the state there."""
    start, step = system.state(), system.increment(residual, du)
    free, lifted, moves = system.free(du), residual.condensed, system.boundary_moves(residual)
    if moves:
        lifted = lifted + system.multiply(du - free)  # r_f + K_fD ΔU_D
    slope = system.dot(free, lifted)  # g_0 < 0
    if system.scalars.size:
        slope = -abs(slope) - abs(system.dot(free, system.scalars.push()))
    known = not (np.isnan(height) or moves)
    rounded = abs(slope) <= POTENTIAL_ROUNDING * abs(height)
    only_down = known and not rounded and (shifted or residual.blocks is None)

    def move(alpha: float) -> Trial:
        system.set_state([a + alpha * b for a, b in zip(start, step, strict=True)])
        if system.least_volume_ratio() <= 0.0:
            return Trial(alpha, residual)
        moved = system.residual()
        ratio = system.dot(free, moved.force) / slope if slope else 0.0  # g(α)/g_0
        bounded = -ETA <= ratio <= 1.0 + ETA
        accepted, there = bounded and not only_down, np.nan
        if not accepted and known:
            there = system.potential()
            most = (highest if bounded else height) + DESCENT * alpha * slope
            accepted = (shifted or ratio >= -ETA) and there <= most
        return Trial(alpha, moved, ratio, accepted, there)

    return move


def _between(low: Trial, high: Trial) -> float:
    """Return the next α: the zero of the line through g, in the lower half of the bracket."""
    secant = low.ratio / (low.ratio - high.ratio) if high.ratio < 0.0 < low.ratio else HALF
    return low.alpha + min(max(secant, TENTH), HALF) * (high.alpha - low.alpha)
