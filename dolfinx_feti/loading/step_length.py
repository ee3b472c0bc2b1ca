# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Rules for the lengths of the steps of a path.

The way from t to a target T is divided into equal steps that are not longer than the present length
L, so that the target is met exactly:

.. math:: t ← t + (T - t) / \lceil |T - t| / L \rceil.

A step that fails is repeated with half its length, until that is the least. How L changes after a
step that succeeded is the rule. Each rule is a class: :class:`GrowthAfterQuickSteps` for load
steps, ``time_steps.ErrorControl`` for time steps. The method ``length_rule`` of the settings
(``steps.Steps``, ``time_steps.TimeSteps``) creates it. For a further rule, override that method in
a subclass of the settings; parameters of the rule are fields of that subclass.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Generic, TypeVar

from dolfinx_feti.loading.load_step import LoadStep

__all__ = ["GrowthAfterQuickSteps", "StepLengthRule"]

#: Rounding error of a length, relative to it and to the place where it begins. A sum of 10⁴ equal
#: steps errs by up to 5e-13. With 0, a target that is 1e-16 beyond a whole number of steps takes
#: one step more; with 1e-6, steps would be longer than the user allows.
ROUNDING = 1e-12

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
