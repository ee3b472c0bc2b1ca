# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Places of a path, its loads or times: which of them are equal to rounding accuracy.

The times 0.3 and 3 · 0.1 are one time, though they differ by 6e-17. In a step from one to the other
rates would be rounding errors divided by 6e-17. Such targets are merged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

__all__ = ["PlaceTolerance", "check_places"]

#: Relative rounding error of a place that is a sum of many steps. A sum of n equal steps errs by up
#: to n/2 · 1.1e-16, 5e-13 for 10⁴ steps. A value far above it would merge steps that a user means.
SUM_RTOL = 1e-12

#: Rounding error of a difference of places, such as 3 · 0.1 − 0.3, relative to the largest place of
#: the path: each of three rounded terms errs by up to half a unit of rounding, and their sums by as
#: much again. It matters for places near zero only: it is 2e-15 of the largest place, less than any
#: load or time step of a usual path.
DIFFERENCE_RTOL = 8.0 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True)
class PlaceTolerance:
    """The tolerance below which two places of a path are equal.

    Attributes:
        largest: The largest absolute value of the places of the path.
        least: The least increment that the user allows; a longer one is a step.
    """

    largest: float
    least: float

    @classmethod
    def of(cls, places: Sequence[float], least: float) -> PlaceTolerance:
        """Return the tolerance of a path with these places, start included, and least increment."""
        return cls(max(map(abs, places), default=0.0), least)

    def are_equal(self, a: float, b: float) -> bool:
        """Return True if two places differ by rounding alone."""
        rounding = max(SUM_RTOL * max(abs(a), abs(b)), DIFFERENCE_RTOL * self.largest)
        return abs(a - b) <= min(rounding, self.least)

    def without_repeats(self, start: float, targets: Sequence[float]) -> list[float]:
        """Return the targets without those that equal the place before them to rounding."""
        places = [start]
        for target in map(float, targets):
            if not self.are_equal(places[-1], target):
                places.append(target)
        return places[1:]


def check_places(
    start: float,
    targets: Sequence[float],
    least: float,
    *,
    unloading: bool,
    quantity: Literal["load", "time"] = "load",
) -> None:
    """Check the places of a path.

    Args:
        start: Where the path begins.
        targets: Loads or times to be met, in their order.
        least: The least increment.
        unloading: Whether the path may turn back.
        quantity: What a place is, for the message.

    Raises:
        ValueError: A place is not a finite number, the path turns back although it must not, or
            times descend.
    """
    if not all(math.isfinite(place) for place in (start, *targets)):
        raise ValueError(f"start={start}, targets={list(targets)}: {quantity}s are finite numbers.")
    merged = PlaceTolerance.of([start, *targets], least).without_repeats(start, targets)
    directions = set(np.sign(np.diff([start, *merged])))
    if not unloading and directions == {-1.0, 1.0}:
        remedy = "Put the targets in order"
        if quantity == "load":
            remedy += ", or allow it by unloading=True"
        raise ValueError(
            f"start={start}, targets={list(targets)}: the {quantity} turns back on its way. "
            f"{remedy}."
        )
    if quantity == "time" and -1.0 in directions:
        raise ValueError(f"start={start}, targets={list(targets)}: times ascend from the start.")
