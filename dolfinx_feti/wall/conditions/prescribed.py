# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Surfaces whose displacement is prescribed: clamped, or sliding in a plane.

The displacement is zero, or that of an axial prestretch (``boundary``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import dolfinx

from dolfinx_feti.wall.casekeys import ChoiceKey, Key
from dolfinx_feti.wall.conditions.condition import Condition, Contribution, SlidingPlane, Surface
from dolfinx_feti.wall.wall import plane

__all__ = ["Clamp", "Slide"]

#: Values of the key ``hold`` of a case. The files of users have this word, so it stays, although
#: the glossary says "support".
HOLD: Mapping[str, Key] = {"hold": ChoiceKey(("clamp", "slide"))}


@dataclass(frozen=True, slots=True)
class Slide(Condition):
    """The surface, which lies in a plane normal to x, y or z, slides in it."""

    CASE_KEYS: ClassVar[Mapping[str, Key]] = HOLD
    NEEDS_BOUNDARY: ClassVar[bool] = False

    def contribution(self, surface: Surface) -> Contribution:
        """Return a condition on the displacement along the normal of the plane.

        Raises:
            ValueError: The surface lies in no plane normal to x, y or z.
        """
        axis, coordinate = plane(surface.wall, surface.name)
        sliding = SlidingPlane(axis, coordinate, surface.constant(0.0))
        component = surface.V.sub(axis)
        dofs = dolfinx.fem.locate_dofs_topological(component, 2, surface.facets)
        bc = dolfinx.fem.dirichletbc(sliding.displacement, dofs, component)
        return Contribution(bcs=(bc,), stretched_axes=(axis,), plane=sliding)

    @classmethod
    def from_case(cls, table: Mapping[str, Any], wall_pressure: float) -> Condition | None:
        """Return the condition of ``hold = "slide"``."""
        return cls() if table.get("hold") == "slide" else None


@dataclass(frozen=True, slots=True)
class Clamp(Condition):
    """The displacement of the surface is zero, or that of the axial prestretch."""

    CASE_KEYS: ClassVar[Mapping[str, Key]] = HOLD
    NEEDS_BOUNDARY: ClassVar[bool] = False
    WHY_ALONE: ClassVar[str] = "has no effect on a clamped surface"

    def contribution(self, surface: Surface) -> Contribution:
        """Return a condition on all components of the displacement."""
        dofs = dolfinx.fem.locate_dofs_topological(surface.V, 2, surface.facets)
        bc = dolfinx.fem.dirichletbc(surface.state.clamped, dofs)
        return Contribution(bcs=(bc,), stretched_axes=(0, 1, 2))

    @classmethod
    def from_case(cls, table: Mapping[str, Any], wall_pressure: float) -> Condition | None:
        """Return the condition of ``hold = "clamp"``."""
        return cls() if table.get("hold") == "clamp" else None
