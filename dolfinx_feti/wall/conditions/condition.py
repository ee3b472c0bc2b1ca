# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A condition on a surface of a wall, and what it contributes to the equations of the wall.

A condition has no state. ``contribution`` receives the surface, with everything that the wall
changes between two solves, and returns Dirichlet conditions and forms; ``boundary`` adds them up. A
kind with a value that the user changes takes it as an argument, a dolfinx Constant or Function.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import dolfinx
import ufl

from dolfinx_feti.runtime.arrays import Indices
from dolfinx_feti.wall.casekeys import Key
from dolfinx_feti.wall.wall import Wall, facets, surface_measure

__all__ = ["Condition", "Contribution", "SlidingPlane", "Surface", "WallState", "create_constant"]


@dataclass(frozen=True, slots=True)
class WallState:
    """Displacement of a wall, and all that changes between two solves; shared by its conditions.

    Attributes:
        u: Displacement [mm], the unknown.
        last: Displacement of the last time step [mm], zero at first.
        clamped: Prescribed displacement of clamped surfaces [mm], zero at first.
        pressure: The wall's pressure [kPa], zero at first.
        time_step: Time step Δt of the dashpots [s], infinite at first.
    """

    u: dolfinx.fem.Function
    last: dolfinx.fem.Function
    clamped: dolfinx.fem.Function
    pressure: dolfinx.fem.Constant
    time_step: dolfinx.fem.Constant


@dataclass(frozen=True, slots=True)
class Surface:
    """A surface that a condition is applied to.

    Attributes:
        wall: The wall.
        name: Name of the surface.
        state: Displacement, pressure and time step of the wall.
    """

    wall: Wall
    name: str
    state: WallState

    @property
    def V(self) -> dolfinx.fem.FunctionSpace:
        """Space of the displacement."""
        return self.state.u.function_space

    @property
    def facets(self) -> Indices:
        """Facets of the surface on this process, ghosts included, (n,)."""
        return facets(self.wall, self.name)

    @property
    def ds(self) -> ufl.Measure:
        """Measure of the surface, which contains facets of the boundary only."""
        return surface_measure(self.wall)(self.wall.surfaces[self.name])

    def constant(self, value: float) -> dolfinx.fem.Constant:
        """Return a constant for a form on the wall."""
        return create_constant(self.wall.mesh, value)


@dataclass(frozen=True, slots=True)
class SlidingPlane:
    """A plane normal to a coordinate axis, in which a surface slides.

    Attributes:
        axis: Number of the axis, 0 to 2.
        coordinate: Coordinate of the plane on this axis [mm].
        displacement: Prescribed displacement along this axis [mm], zero at first.
    """

    axis: int
    coordinate: float
    displacement: dolfinx.fem.Constant


def _no_form() -> ufl.Form:
    """Return the default of a part: an empty form."""
    return ufl.Form([])


@dataclass(frozen=True, slots=True)
class Contribution:
    """Contribution of a condition to the equations of a wall; parts that are not given add nothing.

    Attributes:
        bcs: Dirichlet conditions. Whether a pressure has a potential is tested once, with these
            dofs at zero, or where a trial prestretch moves them (``potential``). A condition that
            prescribes other values of single components on the rim of a surface under pressure may
            therefore get a wrong potential: the residual stays right, but the line search compares
            with a wrong energy. Give such a condition all three components, which may have any
            values.
        energy: Potential in u [mN mm], negative work of a load for instance; its derivatives are
            added to residual and tangent.
        residual: Internal minus external virtual work of a force without a potential, with a test
            function of the space of u. Its derivative is added to the tangent, and the wall has no
            energy.
        pressure_share: Share of the wall's pressure that acts on the deformed surface [-]; None for
            no pressure.
        stretched_axes: Numbers of the axes along which an axial prestretch moves the surface: its
            ``bcs`` prescribe these components of u by ``WallState.clamped``, or by the displacement
            of ``plane``. Empty for a surface that no prestretch moves.
        plane: Plane in which the surface slides; None if it slides in none.
    """

    bcs: tuple[dolfinx.fem.DirichletBC, ...] = ()
    energy: ufl.Form = field(default_factory=_no_form)
    residual: ufl.Form = field(default_factory=_no_form)
    pressure_share: dolfinx.fem.Constant | None = None
    stretched_axes: tuple[int, ...] = ()
    plane: SlidingPlane | None = None


class Condition(ABC):
    """Base class of the conditions on a surface.

    A surface has at most one condition of each class.

    Attributes:
        CASE_KEYS: Keys of a table ``[surfaces.NAME]`` of a case that concern this kind; empty for a
            kind that cases do not have. Messages call the kind by the first key. Kinds that share a
            key, such as ``direction``, have to give it the same value.
        NEEDS_BOUNDARY: Whether the condition integrates by ``ds``, which is empty inside the wall.
        WHY_ALONE: Empty if other conditions are allowed on the same surface. Any other text forbids
            them: the end of the message "… and another condition, which WHY_ALONE".
    """

    __slots__ = ()

    CASE_KEYS: ClassVar[Mapping[str, Key]] = {}
    NEEDS_BOUNDARY: ClassVar[bool] = True
    WHY_ALONE: ClassVar[str] = ""

    @abstractmethod
    def contribution(self, surface: Surface) -> Contribution:
        """Return what the condition adds to the equations of the wall. Collective."""

    @classmethod
    def from_case(cls, table: Mapping[str, Any], wall_pressure: float) -> Condition | None:
        """Return the condition in a table ``[surfaces.NAME]`` of a case; None if there is none.

        Args:
            table: Values of ``CASE_KEYS`` and of other kinds' keys, in the first unit of each.
            wall_pressure: The wall's pressure [mmHg], the largest one of all surfaces.
        """
        return None


def create_constant(mesh: dolfinx.mesh.Mesh, value: float) -> dolfinx.fem.Constant:
    """Return a constant of dolfinx's scalar type."""
    return dolfinx.fem.Constant(mesh, dolfinx.default_scalar_type(value))
