# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Steps of a path: how long they are, and what they have cost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dolfinx_feti.mechanics.values import require_positive, require_within
from dolfinx_feti.problems.history import NewtonStep

__all__ = ["Lengths", "LoadStep", "Steps", "load_step"]


@dataclass(frozen=True, slots=True)
class Lengths:
    """How long the steps of a path are, in the unit of its load or time.

    Attributes:
        first: The first increment.
        least: The increment below which there is no further halving.
        growth: Factor of the increment from one step to the next, at most.
    """

    first: float
    least: float
    growth: float = 1.5

    def __post_init__(self) -> None:
        """Check the values."""
        require_positive(first=self.first, least=self.least)
        if self.least > self.first:
            raise ValueError(f"least={self.least} is above first={self.first}.")
        require_within(1.0, math.inf, {"growth": self.growth}, remedy="a number of 1 or more")


@dataclass(frozen=True, slots=True)
class Steps(Lengths):
    """How to choose the increments of the load; they grow after a quick step.

    Attributes:
        quick: Newton steps with a new tangent up to which a load step counts as quick.
        rtol: Newton's relative tolerance at the loads on the way; None for the solver's own.
        linear_rtol: That of the linear solves there, likewise; nothing is gained below ``rtol``.
    """

    quick: int = 6
    rtol: float | None = None
    linear_rtol: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        Lengths.__post_init__(self)
        given = {"rtol": self.rtol, "linear_rtol": self.linear_rtol}
        require_within(0.0, 1.0, {k: v for k, v in given.items() if v is not None}, ends=False)


@dataclass(frozen=True, slots=True)
class LoadStep:
    """An accepted load step.

    Attributes:
        load: The load that was reached.
        increment: By how much it grew.
        history: What each Newton step cost.
        failures: Attempts with longer increments that failed before.
        lost: What each Newton step of the failed attempts cost.
        seconds: Time, failures included.
    """

    load: float
    increment: float
    history: tuple[NewtonStep, ...]
    failures: int
    lost: tuple[NewtonStep, ...]
    seconds: float

    @property
    def all_steps(self) -> tuple[NewtonStep, ...]:
        """All Newton steps, those of failed attempts included."""
        return self.lost + self.history


def load_step(record: Mapping[str, Any], kind: type[LoadStep]) -> LoadStep:
    """Return a load step, or one of a more special kind, from what ``asdict`` made of it."""
    steps = {k: tuple(NewtonStep(**step) for step in record[k]) for k in ("history", "lost")}
    return kind(**{**record, **steps})
