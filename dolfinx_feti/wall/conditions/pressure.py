# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pressure on a surface of a wall, a share of the wall's pressure that follows the deformation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from dolfinx_feti.runtime.values import require_finite
from dolfinx_feti.wall.casekeys import PRESSURE, Key
from dolfinx_feti.wall.conditions.condition import Condition, Contribution, Surface

__all__ = ["Pressure"]


@dataclass(frozen=True, slots=True)
class Pressure(Condition):
    """A pressure that follows the deformed surface.

    All surfaces under pressure share one value, which ``Boundary.set_pressure`` sets. The argument
    is the share of it that acts on this surface, 1 by default, not a pressure in kPa.

    Example::

        from dolfinx_feti.wall import Clamp, apply_conditions

        conditions = {"lumen": Pressure(), "opening_1": Clamp(), "opening_2": Clamp()}
        boundary = apply_conditions(wall, u, conditions)
        problem = NonlinearProblem(psi * ufl.dx, u, boundary=boundary)
        boundary.set_pressure(0.2)  # kPa
        problem.solve()
    """

    share: float = 1.0  #: Share of the wall's pressure [-]; negative where it pulls

    CASE_KEYS: ClassVar[Mapping[str, Key]] = {"pressure": PRESSURE}

    def __post_init__(self) -> None:
        """Check the value."""
        require_finite(share=self.share)
        if self.share == 0.0:
            raise ValueError(f"share = {self.share}: give a finite number other than zero.")

    def contribution(self, surface: Surface) -> Contribution:
        """Return the share; ``boundary`` creates the forms of all pressures together."""
        return Contribution(pressure_share=surface.constant(self.share))

    @classmethod
    def from_case(cls, table: Mapping[str, Any], wall_pressure: float) -> Condition | None:
        """Return the pressure of a table as a share of the wall's pressure."""
        if "pressure" not in table:
            return None
        return cls(table["pressure"] / wall_pressure)
