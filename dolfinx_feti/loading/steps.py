# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Settings of load steps and of time steps: how long they are, and how accurate on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dolfinx_feti.loading.load_step import LoadStep
from dolfinx_feti.loading.step_length import ErrorControl, GrowthAfterQuickSteps, StepLengthRule
from dolfinx_feti.loading.time_step import TimeStep
from dolfinx_feti.runtime.values import require_number, require_positive, require_within

__all__ = ["LengthSettings", "Steps", "TimeSteps"]


@dataclass(frozen=True, slots=True)
class LengthSettings:
    """How long the steps of a path are, in the unit of its load or time.

    Attributes:
        first: The first increment.
        least: The increment below which there is no further halving.
        growth: Largest factor of the increment from one step to the next. The default 1.5 is a
            choice, not measured: after two halvings four quick steps reach the old length.
    """

    first: float
    least: float
    growth: float = 1.5

    def __post_init__(self) -> None:
        """Check the values."""
        require_number(first=self.first, least=self.least, growth=self.growth)
        require_positive(first=self.first, least=self.least)
        if self.least > self.first:
            raise ValueError(f"least={self.least} is above first={self.first}.")
        require_within(1.0, math.inf, {"growth": self.growth}, remedy="a number of 1 or more")


# The classes below call ``LengthSettings.__post_init__`` by its name: ``super()`` without arguments
# fails in a dataclass with slots, because the decorator replaces the class.


@dataclass(frozen=True, slots=True)
class Steps(LengthSettings):
    """How to choose the increments of the load; they grow after a quick step.

    Attributes:
        first: The first increment [unit of the load].
        least: The increment below which a failed step is not halved further.
        growth: Largest factor of the increment from one step to the next.
        quick: Largest number of Newton steps with a new tangent in a quick load step. The default
            is a choice, not measured: a step from a good prediction takes three or four.
        rtol: Newton's relative tolerance at loads that are no targets; None for the solver's own.
        linear_rtol: Relative tolerance of the linear solves there; None for the solver's own. A
            value below ``rtol`` is of no use, as Newton's method does not need it.
    """

    quick: int = 6
    rtol: float | None = None
    linear_rtol: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        LengthSettings.__post_init__(self)
        require_number(quick=self.quick)
        tolerances = {"rtol": self.rtol, "linear_rtol": self.linear_rtol}
        for name, tolerance in tolerances.items():
            if tolerance is not None:
                require_number(**{name: tolerance})
                require_within(0.0, 1.0, {name: tolerance}, includes_ends=False)

    def length_rule(self) -> StepLengthRule[LoadStep]:
        """Create the rule for the lengths; a subclass with another rule overrides this."""
        return GrowthAfterQuickSteps(self.first, self.least, growth=self.growth, quick=self.quick)


@dataclass(frozen=True, slots=True)
class TimeSteps(LengthSettings):
    """How to choose the lengths of time steps [s].

    Attributes:
        first: The first length [s].
        least: The length below which a failed step is not halved further [s].
        growth: Largest factor of the length from one step to the next.
        longest: The longest length [s]; the first one if not given.
        tolerance: Largest estimated error of the displacement in a step [mm]; if not given, steps
            grow to the longest length.
    """

    longest: float | None = None
    tolerance: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        LengthSettings.__post_init__(self)
        remedy = f"a number not below first={self.first}"
        require_number(longest=self.longest_length)
        require_within(self.first, math.inf, {"longest": self.longest_length}, remedy=remedy)
        if self.tolerance is not None:
            require_number(tolerance=self.tolerance)
            require_positive(tolerance=self.tolerance)

    @property
    def longest_length(self) -> float:
        """The longest length [s], also if it is not given."""
        return self.first if self.longest is None else self.longest

    def length_rule(self) -> StepLengthRule[TimeStep]:
        """Create the rule for the lengths; a subclass with another rule overrides this."""
        return ErrorControl(
            self.first,
            self.least,
            longest=self.longest_length,
            growth=self.growth,
            tolerance=self.tolerance,
        )
