# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Rules for the lengths of the steps of a path.

The way from t to a target T is divided into equal steps that are not longer than the present length
L, so that the target is met exactly:

.. math:: t ← t + (T - t) / \lceil |T - t| / L \rceil.

A step that fails is repeated with half its length, until that is the least. How L changes after a
step that succeeded is the rule: one class for each, and a method ``length_rule`` of its settings
that creates it (``steps``).

Load steps grow after quick ones. Time steps are adapted to their estimated error e: after a step of
length Δt the present length becomes

.. math:: L ← \min(\max(L, g\, Δt),\ Δt\, \max(½,\ 0.9\, (\mathrm{tol}/e)^{1/3})),

where g is the largest growth, and L stays between the least and the longest length. Δt is shorter
than L if a target is to be met.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Generic, TypeVar

from dolfinx_feti.loading.load_step import LoadStep
from dolfinx_feti.loading.time_step import TimeStep

__all__ = ["ErrorControl", "GrowthAfterQuickSteps", "StepLengthRule"]

#: Rounding error of a length, relative to it and to the place where it begins. A sum of 10⁴ equal
#: steps errs by up to 5e-13. With 0, a target that is 1e-16 beyond a whole number of steps takes
#: one step more; with 1e-6, steps would be longer than the user allows.
ROUNDING = 1e-12

#: Length of the next step over the length whose predicted error is the tolerance. With 0.9 an error
#: may be a third larger than predicted (0.9⁻³ = 1.37) before a step is repeated.
SAFETY = 0.9

#: Shortest length of the next step over that of an accepted one: no shorter than after a failure,
#: which halves it, too.
MIN_SHRINKAGE = 0.5

Step = TypeVar("Step", contravariant=True)


class StepLengthRule(ABC, Generic[Step]):
    """The present length of steps, and a rule for the next one.

    A rule defines :meth:`adapt`, and may override :meth:`halve`. A rule that remembers more than
    the present length extends :meth:`record` and :meth:`restore`, through which it passes a
    restart.

    Attributes:
        present: Length that the next step does not exceed, in the unit of the load or time.
        least: The least length.
    """

    def __init__(self, first: float, least: float) -> None:
        """Create the rule with the first length.

        Args:
            first: The first length.
            least: The least length, below which there is no further halving.
        """
        self.present = first
        self.least = least

    @abstractmethod
    def adapt(self, step: Step, *, n_updates: int) -> None:
        """Set ``present`` to the length after a step that succeeded, ``least`` or more.

        The caller does not check the bound.

        Args:
            step: The step, with its increment, failures, and cost. Its increment may be shorter
                than ``present``, as targets are met exactly.
            n_updates: Number of updates of multipliers in its last attempt.
        """

    def next_place(self, at: float, target: float) -> float:
        """Return where the next step from a place leads: on the way to a target, or to it."""
        count = math.ceil(abs(target - at) / self.present * (1.0 - ROUNDING))
        if count <= 1:
            return target
        return at + (target - at) / count

    def is_least(self, length: float, at: float) -> bool:
        """Return True if a step of this length from a place cannot be shortened."""
        return length <= self.least + ROUNDING * (length + abs(at))

    def halve(self, length: float) -> None:
        """Set ``present`` to half the length of a step that failed, ``least`` or more.

        An override has to shorten the step as well: the step is repeated until it succeeds, or
        until its length :meth:`is_least`.
        """
        self.present = max(length / 2.0, self.least)

    def record(self) -> dict[str, float]:
        """Return what a restart needs, as JSON can hold it."""
        return {"present": self.present}

    def restore(self, record: Mapping[str, float]) -> None:
        """Set the rule to the state that :meth:`record` has returned.

        Raises:
            KeyError: Another rule wrote the record, which lacks what this one remembers. A restart
                reports it as a ValueError with a remedy, and changes nothing.
        """
        self.present = record["present"]


class GrowthAfterQuickSteps(StepLengthRule[LoadStep]):
    """Load steps: the length grows after a step that took few Newton steps, and did not fail first.

    Attributes:
        growth: Largest factor from one step to the next.
        quick: Largest number of Newton steps with a new tangent in a quick step.
    """

    def __init__(self, first: float, least: float, *, growth: float, quick: int) -> None:
        """Create the rule; see :class:`~dolfinx_feti.loading.steps.Steps`."""
        super().__init__(first, least)
        self.growth = growth
        self.quick = quick

    def adapt(self, step: LoadStep, *, n_updates: int) -> None:
        """Increase the length after a quick step.

        Each update of multipliers takes about one Newton step; these steps are not counted.
        """
        new_tangents = sum(newton_step.tangent_lag == 0 for newton_step in step.history)
        is_quick = new_tangents - n_updates <= self.quick
        if step.failures == 0 and is_quick:
            self.present = max(self.present, self.growth * abs(step.increment))


class ErrorControl(StepLengthRule[TimeStep]):
    """Time steps whose estimated error is about the tolerance; see the head of the file.

    A step with a larger error than ``TimeSteps.tolerance`` is repeated by ``follow_time``, whatever
    the rule (``time_steps``).

    Attributes:
        longest: The longest length [s].
        growth: Largest factor from one step to the next.
        tolerance: Error of the displacement in a step [mm]; None to let steps grow to the longest
            one.
    """

    def __init__(
        self, first: float, least: float, *, longest: float, growth: float, tolerance: float | None
    ) -> None:
        """Create the rule; see :class:`~dolfinx_feti.loading.steps.TimeSteps`."""
        super().__init__(first, least)
        self.longest = longest
        self.growth = growth
        self.tolerance = tolerance

    def adapt(self, step: TimeStep, *, n_updates: int) -> None:
        """Choose the length from that of the step, Δt, and its error."""
        dt = step.increment
        length = max(self.present, self.growth * dt)
        if self.tolerance is not None and step.error > 0.0:
            factor = SAFETY * (self.tolerance / step.error) ** (1.0 / 3.0)  # the error is O(Δt³)
            length = min(length, dt * max(MIN_SHRINKAGE, factor))
        self.present = max(min(self.longest, length), self.least)
