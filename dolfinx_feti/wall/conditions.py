# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Conditions on the surfaces of a wall: pressure, springs, dashpots, sliding and clamping.

A surface takes any of these, by its name; one that is not named is free::

    conditions = {
        "lumen": Pressure(),
        "outer": [Spring(1.0), Dashpot(0.1)],
        "opening_1": Clamp(),
        "opening_2": Slide(),
    }

:mod:`~dolfinx_feti.wall.boundary` turns them into Dirichlet conditions and forms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

from dolfinx_feti.mechanics.supports import Direction
from dolfinx_feti.mechanics.values import require_within

__all__ = [
    "Clamp",
    "Condition",
    "Conditions",
    "Dashpot",
    "Pressure",
    "Slide",
    "Spring",
    "by_surface",
]

NOT_ZERO = "a finite number other than zero"


@dataclass(frozen=True, slots=True)
class Pressure:
    """A pressure that follows the deformed surface.

    Attributes:
        share: Its share of the wall's pressure [-]; negative where it pulls.
    """

    share: float = 1.0

    def __post_init__(self) -> None:
        """Check the value."""
        require_within(-math.inf, math.inf, {"share": self.share}, remedy=NOT_ZERO, sign="=")
        if self.share == 0.0:
            raise ValueError(f"share={self.share}: give {NOT_ZERO}.")


@dataclass(frozen=True, slots=True)
class Spring:
    """Springs to a place at rest, see :func:`~dolfinx_feti.mechanics.supports.spring_energy`.

    Attributes:
        stiffness: k [kPa/mm], positive.
        direction: ``"normal"`` or ``"all"``.
    """

    stiffness: float
    direction: Direction = "normal"

    def __post_init__(self) -> None:
        """Check the values."""
        _check_support(self.direction, stiffness=self.stiffness)


@dataclass(frozen=True, slots=True)
class Dashpot:
    """Dashpots, see :func:`~dolfinx_feti.mechanics.supports.dashpot_energy`.

    Attributes:
        viscosity: η [kPa s/mm], positive.
        direction: ``"normal"`` or ``"all"``.
    """

    viscosity: float
    direction: Direction = "normal"

    def __post_init__(self) -> None:
        """Check the values."""
        _check_support(self.direction, viscosity=self.viscosity)


@dataclass(frozen=True, slots=True)
class Slide:
    """The surface, which lies in a plane normal to x, y or z, slides in it."""


@dataclass(frozen=True, slots=True)
class Clamp:
    """The surface is held."""


Condition = Pressure | Spring | Dashpot | Slide | Clamp
Conditions = Mapping[str, Condition | Sequence[Condition]]


def by_surface(conditions: Conditions) -> dict[str, tuple[Condition, ...]]:
    """Return the conditions of each surface as a tuple.

    Raises:
        ValueError: One is something else or given twice, or a clamp is not alone on its surface.
    """
    by_name: dict[str, tuple[Condition, ...]] = {}
    for name, given in conditions.items():
        listed = by_name[name] = tuple(given) if isinstance(given, Sequence) else (given,)
        kinds, holds = [type(condition) for condition in listed], f"conditions[{name!r}] holds"
        for condition in listed:
            if not isinstance(condition, Condition):
                kinds_known = "Pressure, Spring, Dashpot, Slide or Clamp"
                raise ValueError(f"{holds} {condition!r}: give {kinds_known}.")
        if len(set(kinds)) < len(kinds):
            raise ValueError(f"{holds} a condition twice: give each kind once.")
        if Clamp in kinds and len(kinds) > 1:
            raise ValueError(
                f"{holds} a clamp and another condition, which has no effect on a surface that is "
                "held: leave one of them out."
            )
    return by_name


def _check_support(direction: str, **value: float) -> None:
    """Require a positive value and a direction."""
    require_within(0.0, math.inf, value, ends=False, remedy="a positive number", sign="=")
    if direction not in get_args(Direction):
        raise ValueError(f"direction={direction!r}: choose 'normal' or 'all'.")
