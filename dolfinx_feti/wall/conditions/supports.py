# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Springs and dashpots on a surface of a wall, for the tissue around it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, get_args

from dolfinx_feti.mechanics.supports import (
    Direction,
    check_direction,
    dashpot_energy,
    spring_energy,
)
from dolfinx_feti.runtime.values import require_positive
from dolfinx_feti.wall.casekeys import ChoiceKey, Key, NumberKey
from dolfinx_feti.wall.conditions.condition import Condition, Contribution, Surface

__all__ = ["Dashpot", "Spring"]

#: Units of a stiffness per area; in the first one, kPa/mm, a Pa/m is 1e-3 kPa / 1e3 mm.
SPRING_UNITS = {"kPa/mm": 1.0, "kPa/cm": 0.1, "kPa/m": 1e-3, "Pa/mm": 1e-3, "Pa/m": 1e-6}

#: Units of a viscosity per area: those of a stiffness times a second.
DASHPOT_UNITS = {unit.replace("/", " s/"): factor for unit, factor in SPRING_UNITS.items()}

#: Part of the displacement that springs and dashpots resist.
DIRECTION = ChoiceKey(get_args(Direction))


@dataclass(frozen=True, slots=True)
class Spring(Condition):
    """Springs to points at rest, see :func:`~dolfinx_feti.mechanics.supports.spring_energy`."""

    stiffness: float  #: k [kPa/mm], positive
    direction: Direction = "normal"  #: ``"normal"`` or ``"all"``

    CASE_KEYS: ClassVar[Mapping[str, Key]] = {
        "spring": NumberKey(SPRING_UNITS),
        "direction": DIRECTION,
    }

    def __post_init__(self) -> None:
        """Check the values."""
        require_positive(stiffness=self.stiffness)
        check_direction(self.direction)

    def contribution(self, surface: Surface) -> Contribution:
        """Return the energy of the springs."""
        k = surface.constant(self.stiffness)
        energy = spring_energy(k, surface.state.u, surface.ds, self.direction)
        return Contribution(energy=energy)

    @classmethod
    def from_case(cls, table: Mapping[str, Any], wall_pressure: float) -> Condition | None:
        """Return the springs of a table."""
        if "spring" not in table:
            return None
        return cls(table["spring"], table.get("direction", "normal"))


@dataclass(frozen=True, slots=True)
class Dashpot(Condition):
    """Dashpots, see :func:`~dolfinx_feti.mechanics.supports.dashpot_energy`."""

    viscosity: float  #: η [kPa s/mm], positive
    direction: Direction = "normal"  #: ``"normal"`` or ``"all"``

    CASE_KEYS: ClassVar[Mapping[str, Key]] = {
        "dashpot": NumberKey(DASHPOT_UNITS),
        "direction": DIRECTION,
    }

    def __post_init__(self) -> None:
        """Check the values."""
        require_positive(viscosity=self.viscosity)
        check_direction(self.direction)

    def contribution(self, surface: Surface) -> Contribution:
        """Return the energy of the dashpots in a time step."""
        η = surface.constant(self.viscosity)
        state = surface.state
        energy = dashpot_energy(η, state.u, state.last, state.time_step, surface.ds, self.direction)
        return Contribution(energy=energy)

    @classmethod
    def from_case(cls, table: Mapping[str, Any], wall_pressure: float) -> Condition | None:
        """Return the dashpots of a table."""
        if "dashpot" not in table:
            return None
        return cls(table["dashpot"], table.get("direction", "normal"))
