# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The record of an accepted step of a path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from dolfinx_feti.problems.history import NewtonStep

__all__ = ["LoadStep", "read_step"]

Step = TypeVar("Step", bound="LoadStep")


@dataclass(frozen=True, slots=True)
class LoadStep:
    """An accepted load step.

    Attributes:
        load: The load that was reached; in a :class:`TimeStep` the time [s].
        increment: Load minus the load before; negative if the load has turned back.
        history: Cost of each Newton step.
        failures: Number of failed attempts with longer increments.
        lost: Cost of each Newton step of the failed attempts.
        seconds: Time that the step took, failures included [s].
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


def read_step(record: Mapping[str, Any], step_type: type[Step]) -> Step:
    """Read a step of a checkpoint, of :class:`LoadStep` or a class derived from it.

    Args:
        record: The attributes of the step, as ``dataclasses.asdict`` returns them.
        step_type: Class of the step.

    Raises:
        KeyError: An attribute is missing.
        TypeError: There is an attribute that the class does not have.
    """
    attributes = dict(record)
    for name in ("history", "lost"):
        attributes[name] = tuple(NewtonStep(**newton_step) for newton_step in record[name])
    return step_type(**attributes)
