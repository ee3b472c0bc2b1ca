# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Conditions on the surfaces of a wall, and the Dirichlet conditions and forms that they make.

A surface takes any of these, by its name; one that is not named is free (docs/conditions.md)::

    {"lumen": Pressure(), "outer": [Spring(1.0), Dashpot(0.1)], "opening_1": Clamp()}

An axial prestretch λ moves what is clamped or slides by (λ − 1) (X·e − X₀) e along an axis e, where
X₀ is the least X·e of the wall. Units: mm, kPa, s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.mechanics.loads import (
    SAME,
    follower_pressure,
    follower_pressure_tangent,
    free_norm,
    pressure_potential,
    wave,
)
from dolfinx_feti.mechanics.supports import Direction, dashpot_energy, spring_energy
from dolfinx_feti.mechanics.values import require_finite, require_positive
from dolfinx_feti.wall.wall import AXES, Wall, extent, facets, plane, surface_measure

__all__ = ["Boundary", "Clamp", "Dashpot", "Pressure", "Slide", "Spring", "apply_conditions"]

#: Pressures: share and measure of each surface.
Loaded = Sequence[tuple[dolfinx.fem.Constant, ufl.Measure]]

Axis = Sequence[float] | None


@dataclass(frozen=True, slots=True)
class Pressure:
    """A pressure that follows the deformed surface."""

    share: float = 1.0  #: Share of the wall's pressure [-]; negative where it pulls

    def __post_init__(self) -> None:
        """Check the value."""
        require_finite(share=self.share)
        if self.share == 0.0:
            raise ValueError(f"share = {self.share}: give a finite number other than zero.")


@dataclass(frozen=True, slots=True)
class Spring:
    """Springs to a place at rest, see :func:`~dolfinx_feti.mechanics.supports.spring_energy`."""

    stiffness: float  #: k [kPa/mm], positive
    direction: Direction = "normal"  #: ``"normal"`` or ``"all"``

    def __post_init__(self) -> None:
        """Check the values."""
        require_positive(stiffness=self.stiffness)
        _check_direction(self.direction)


@dataclass(frozen=True, slots=True)
class Dashpot:
    """Dashpots, see :func:`~dolfinx_feti.mechanics.supports.dashpot_energy`."""

    viscosity: float  #: η [kPa s/mm], positive
    direction: Direction = "normal"  #: ``"normal"`` or ``"all"``

    def __post_init__(self) -> None:
        """Check the values."""
        require_positive(viscosity=self.viscosity)
        _check_direction(self.direction)


@dataclass(frozen=True, slots=True)
class Slide:
    """The surface, which lies in a plane normal to x, y or z, slides in it."""


@dataclass(frozen=True, slots=True)
class Clamp:
    """The surface is held."""


Condition = Pressure | Spring | Dashpot | Slide | Clamp
Conditions = Mapping[str, Condition | Sequence[Condition]]


def by_surface(conditions: Conditions) -> dict[str, tuple[Condition, ...]]:
    """Return the conditions of each surface, each kind once, and a clamp alone on its surface."""
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


def _check_direction(direction: str) -> None:
    if direction not in get_args(Direction):
        raise ValueError(f"direction = {direction!r}: choose 'normal' or 'all'.")


@dataclass(frozen=True, slots=True)
class Boundary:
    """What conditions make of a wall's boundary."""

    bcs: list[dolfinx.fem.DirichletBC]  #: Dirichlet conditions of what is clamped or slides
    residual: ufl.Form  #: Virtual work of pressure, springs and dashpots
    tangent: ufl.Form  #: Derivative; of a pressure's, the symmetric part if that is all of it
    energy: ufl.Form | None  #: Potential; None if the pressure has none
    pressure: dolfinx.fem.Constant  #: The wall's pressure [kPa], zero at first
    time_step: dolfinx.fem.Constant  #: Δt of the dashpots [s], infinite at first
    last: dolfinx.fem.Function  #: Displacement of the last time step [mm], zero at first
    axis: int | None  #: Number of the axis of the prestretch; None for none
    moved: dolfinx.fem.Function  #: The displacement of what is clamped [mm]
    #: Displacement normal to each plane that is pulled [mm], and its place on the axis [mm]
    planes: tuple[tuple[dolfinx.fem.Constant, float], ...]

    def set_stretch(self, stretch: float) -> None:
        """Set the axial prestretch λ [-], 1 at rest, of what is clamped or slides.

        Raises:
            ValueError: λ is not positive, or the conditions were applied without an axis.
        """
        if self.axis is None:
            raise ValueError("There is no axis to stretch along: give apply_conditions(axis=…).")
        require_positive(stretch=stretch)
        V = self.moved.function_space
        least = float(extent(V.mesh)[0][self.axis])
        X = V.tabulate_dof_coordinates()[:, self.axis]
        self.moved.x.array.reshape(-1, 3)[:, self.axis] = (stretch - 1.0) * (X - least)
        for value, place in self.planes:
            value.value = (stretch - 1.0) * (place - least)

    def advance(self, u: dolfinx.fem.Function) -> None:
        """End a time step of the dashpots, set by ``time_step.value``: u becomes ``last``."""
        self.last.x.array[:] = u.x.array


def apply_conditions(
    wall: Wall, u: dolfinx.fem.Function, conditions: Conditions, *, axis: str | None = None
) -> Boundary:
    """Turn conditions on named surfaces into Dirichlet conditions and forms. Collective.

    Whether a pressure has a potential −p V is tried: its derivative has to be the residual. Where
    rims are free or on springs it has none, and the tangent is not symmetric (docs/conditions.md).

    Args:
        wall: The wall.
        u: Displacement [mm], a Function in a Lagrange space on its mesh.
        conditions: One or several for each surface by name; those that are not named are free.
        axis: ``"x"``, ``"y"`` or ``"z"`` for a prestretch along it by :meth:`Boundary.set_stretch`.

    Raises:
        ValueError: u is no displacement of the wall, the wall has no such surface, one that is
            loaded or supported lies inside the wall, a clamp is not alone on its surface, a surface
            that slides lies in no plane normal to x, y or z, or the wall cannot be stretched along
            the axis. On all processes.
    """
    if u.ufl_shape != (3,) or u.function_space.mesh._cpp_object != wall.mesh._cpp_object:
        raise ValueError(
            f"u has the shape {u.ufl_shape}, or lives on another mesh: take a Function of "
            'functionspace(wall.mesh, ("Lagrange", 2, (3,))).'
        )
    given, mesh, V = by_surface(conditions), wall.mesh, u.function_space
    v, du = ufl.TestFunction(V), ufl.TrialFunction(V)
    moved, last = dolfinx.fem.Function(V), dolfinx.fem.Function(V, name="last_displacement")
    p, dt = _constant(mesh, 0.0), _constant(mesh, np.inf)
    supports, loaded, clamps = ufl.Form([]), [], 0
    bcs: list[dolfinx.fem.DirichletBC] = []
    planes: list[tuple[int, dolfinx.fem.Constant, float]] = []
    for name, found in given.items():
        on, ds = facets(wall, name), surface_measure(wall)(wall.surfaces[name])
        for condition in found:
            match condition:
                case Clamp():
                    dofs = dolfinx.fem.locate_dofs_topological(V, 2, on)
                    bcs.append(dolfinx.fem.dirichletbc(moved, dofs))
                    clamps += 1
                case Slide():
                    k, at = plane(wall, name)
                    planes.append((k, _constant(mesh, 0.0), at))
                    dofs = dolfinx.fem.locate_dofs_topological(V.sub(k), 2, on)
                    bcs.append(dolfinx.fem.dirichletbc(planes[-1][1], dofs, V.sub(k)))
                case Spring(stiffness, direction):
                    supports += spring_energy(_constant(mesh, stiffness), u, ds, direction)
                case Dashpot(viscosity, direction):
                    factor = _constant(mesh, viscosity)
                    supports += dashpot_energy(factor, u, last, dt, ds, direction)
                case Pressure(share):
                    loaded.append((_constant(mesh, share), ds))
        if any(isinstance(condition, Pressure | Spring | Dashpot) for condition in found):
            _check_outside(wall, name)
    normals = [k for k, *_ in planes]
    along = None if axis is None else _axis(axis, clamps, normals)
    residual, tangent = ufl.Form([]), ufl.Form([])
    if not supports.empty():
        residual = ufl.derivative(supports, u, v)
        tangent = ufl.derivative(residual, u, du)
    for share, part in loaded:
        residual += follower_pressure(share * p, u, v, part)
    pulled = tuple((shift, at) for k, shift, at in planes if k == along)
    boundary = Boundary(bcs, residual, tangent, None, p, dt, last, along, moved, pulled)
    axes = (None, *np.eye(3)[sorted(set(normals))])
    fitting = [e for e in axes if _is_potential(boundary, V, loaded, e)]
    kind: Literal["symmetric", "auto"] = "symmetric" if fitting else "auto"
    for share, part in loaded:
        tangent += follower_pressure_tangent(share * p, u, v, du, part, kind, bcs=bcs)
    energy = supports + _potential(p, u, loaded, fitting[0]) if fitting else None
    return replace(boundary, tangent=tangent, energy=energy)


def _check_outside(wall: Wall, name: str) -> None:
    """Require a surface of the boundary, where forms of ``ds`` are integrated. Collective."""
    topology = wall.mesh.topology
    topology.create_connectivity(2, 3)
    mine = facets(wall, name)
    mine = mine[mine < topology.index_map(2).size_local]
    outside = np.isin(mine, dolfinx.mesh.exterior_facet_indices(topology))
    inside = wall.mesh.comm.allreduce(int((~outside).sum()))
    if inside:
        raise ValueError(
            f"The surface {name!r} has {inside} facets inside the wall, where no pressure, spring "
            "or dashpot acts: name a surface of its boundary."
        )


def _constant(mesh: dolfinx.mesh.Mesh, value: float) -> dolfinx.fem.Constant:
    return dolfinx.fem.Constant(mesh, dolfinx.default_scalar_type(value))


def _axis(axis: str, clamps: int, normals: Sequence[int]) -> int:
    """Return the number of an axis along which the wall can be stretched."""
    if axis not in tuple(AXES):
        raise ValueError(f"axis={axis!r}: choose 'x', 'y' or 'z'.")
    number = AXES.index(axis)
    if clamps + normals.count(number) < 2:
        raise ValueError(
            f"axis={axis!r}: a prestretch pulls at two ends, but fewer surfaces are clamped or "
            f"slide in a plane normal to {axis}: give both ends Clamp() or Slide()."
        )
    return number


def _potential(
    p: dolfinx.fem.Constant, u: dolfinx.fem.Function, loaded: Loaded, axis: Axis
) -> ufl.Form:
    """Return −Σ p V(u) of all surfaces under pressure."""
    parts = (pressure_potential(share * p, u, ds, axis) for share, ds in loaded)
    return sum(parts, ufl.Form([]))


def _is_potential(
    boundary: Boundary, V: dolfinx.fem.FunctionSpace, loaded: Loaded, axis: Axis
) -> bool:
    """Say whether the derivative of −p V is the pressure's residual in free dofs. Collective."""
    if not loaded:
        return True
    w, v, one = wave(V), ufl.TestFunction(V), _constant(V.mesh, 1.0)
    if boundary.axis is not None:
        boundary.set_stretch(1.1)
    for bc in boundary.bcs:
        bc.set(w.x.array)
    if boundary.axis is not None:
        boundary.set_stretch(1.0)
    follower = sum((follower_pressure(share * one, w, v, ds) for share, ds in loaded), ufl.Form([]))
    slope = ufl.derivative(_potential(one, w, loaded, axis), w, v)
    return free_norm(slope - follower, boundary.bcs) <= SAME * free_norm(follower, boundary.bcs)
