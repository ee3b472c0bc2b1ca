# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""How often a step of a body in contact may overshoot.

Whole steps find the points that touch a tool; short steps hardly do. A whole step may therefore end
anywhere, but only a limited number of times before ‖r‖ falls below all its earlier values.
"""

from __future__ import annotations

from dolfinx_feti.problems.equations.system import System
from dolfinx_feti.problems.iteration.iterate import Direction
from dolfinx_feti.problems.iteration.line import Trial

#: Number of consecutive steps with contact that may overshoot before ‖r‖ reaches a new minimum: a
#: set of touching points that spreads over a thin body takes up to ten. At 0 a ring between plates
#: takes 29 load steps instead of 13; at 24 a solve that fails only fails later.
MAX_OVERSHOOTS = 12


class Overshoots:
    """Number of line searches without an accepted trial since ‖r‖ was lowest."""

    def __init__(self, norm: float) -> None:
        """Create a count of zero at an iterate with ‖r‖ = norm."""
        self._lowest_norm = norm
        self._remaining = MAX_OVERSHOOTS

    def are_allowed(self, system: System, direction: Direction) -> bool:
        """Return True if a whole step along this direction may end anywhere."""
        return system.has_contacts and not direction.is_shifted and self._remaining > 0

    def count(self, trial: Trial) -> None:
        """Count a line search that ended in a trial which is not accepted.

        It has overshot, or found no step length (α = 0), which counts as well.
        """
        if not trial.is_accepted:
            self._remaining -= 1

    def update(self, norm: float) -> None:
        """Reset the count if ‖r‖ of a new iterate is the lowest so far."""
        if norm < self._lowest_norm:
            self._lowest_norm = norm
            self._remaining = MAX_OVERSHOOTS
