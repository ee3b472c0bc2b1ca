# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Rigid tools: signed distances g(x) of a current position x from the surface of a tool, in UFL.

.. math:: g(x) > 0 \text{ outside of the tool}, \qquad g(x) < 0 \text{ inside of it}, \qquad
          |∇g| = 1.

A tool is a function ``x ↦ g`` of a vector of UFL, one of these or the user's. Its numbers may be
Constants: the tool then moves or grows with them, as in ``set_load`` of ``follow_load``. Lengths
are in the unit of the mesh.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, TypeAlias

import numpy as np

import ufl
from ufl.core.expr import Expr

from dolfinx_feti.mechanics.values import require_finite, require_positive

__all__ = ["Tool", "Vector", "cylinder", "half_space", "sphere", "torus", "union"]

#: A signed distance of the current position.
Tool: TypeAlias = Callable[[Any], Any]

#: A point or a direction: numbers, or a Constant or expression of UFL.
Vector: TypeAlias = Sequence[float] | Expr


def half_space(normal: Vector, point: Vector | None = None, *, offset: float | Expr = 0.0) -> Tool:
    """Return the distance from a plate, n·(x − p) − offset; n points to the body.

    Args:
        normal: n, of any length; it points out of the plate, to the body.
        point: p, a point of the surface; the origin if not given.
        offset: Displacement of the plate along n.

    Raises:
        ValueError: The normal is zero, or a number is not finite.
    """
    require_finite(offset=offset)
    n = _direction("normal", normal)
    p = _point("point", point)

    def distance(x: Any) -> Any:
        return ufl.dot(n(x), x - p(x)) - offset

    return distance


def sphere(radius: float | Expr, centre: Vector | None = None, *, inside: bool = False) -> Tool:
    """Return the distance from a sphere, ‖x − c‖ − R; in the plane from a circle.

    Args:
        radius: R.
        centre: c; the origin if not given.
        inside: Whether the body is inside a hollow sphere, R − ‖x − c‖.

    Raises:
        ValueError: The radius is not positive, or a number is not finite.
    """
    require_positive(radius=radius)
    c = _point("centre", centre)

    def distance(x: Any) -> Any:
        return _sign(inside) * (_length(x - c(x)) - radius)

    return distance


def cylinder(
    axis: Vector, radius: float | Expr, point: Vector | None = None, *, inside: bool = False
) -> Tool:
    """Return the distance from an endless cylinder, ‖(I − a ⊗ a)(x − p)‖ − R.

    Args:
        axis: a, of any length. In the plane take :func:`sphere`, which is a circle there.
        radius: R.
        point: p, a point of the axis; the origin if not given.
        inside: Whether the body is inside a hollow cylinder, R − ‖…‖.

    Raises:
        ValueError: The axis is zero, the radius not positive, or a number is not finite.
    """
    require_positive(radius=radius)
    a = _direction("axis", axis)
    p = _point("point", point)

    def distance(x: Any) -> Any:
        d = x - p(x)
        across = d - ufl.dot(d, a(x)) * a(x)
        return _sign(inside) * (_length(across) - radius)

    return distance


def torus(
    axis: Vector,
    radius: float | Expr,
    tube: float | Expr,
    centre: Vector | None = None,
    *,
    inside: bool = False,
) -> Tool:
    """Return the distance from a torus, ((ρ − R)² + z²)^½ − r, with ρ across and z along its axis.

    Args:
        axis: Its axis, of any length.
        radius: R, from the axis to the middle of the tube.
        tube: r, the radius of the tube.
        centre: Its centre; the origin if not given.
        inside: Whether the body is inside the tube.

    Raises:
        ValueError: The axis is zero, a radius not positive, or a number is not finite.
    """
    require_positive(radius=radius, tube=tube)
    a = _direction("axis", axis)
    c = _point("centre", centre)

    def distance(x: Any) -> Any:
        d = x - c(x)
        along = ufl.dot(d, a(x))
        across = _length(d - along * a(x)) - radius
        return _sign(inside) * (ufl.sqrt(across**2 + along**2) - tube)

    return distance


def union(*tools: Tool) -> Tool:
    """Return the distance from the nearest of several tools.

    Raises:
        ValueError: There is no tool.
    """
    if not tools:
        raise ValueError("union() has no tools: give at least one.")

    def distance(x: Any) -> Any:
        return reduce(ufl.min_value, (tool(x) for tool in tools))

    return distance


def _sign(inside: bool) -> float:
    """Return −1 for a body inside a hollow tool, else 1."""
    return -1.0 if inside else 1.0


def _length(d: Any) -> Any:
    """Return ‖d‖."""
    return ufl.sqrt(ufl.dot(d, d))


def _direction(name: str, direction: Vector) -> Callable[[Any], Any]:
    """Return a function of the position x that returns a unit vector with as many components."""
    vector = _point(name, direction)
    if not isinstance(direction, Expr):
        length = math.hypot(*map(float, direction))
        if length == 0.0:
            raise ValueError(f"{name} = {tuple(direction)}: give a vector that is not zero.")
        unit = tuple(float(d) / length for d in direction)
        return _point(name, unit)

    def of(x: Any) -> Any:
        d = vector(x)
        return d / _length(d)

    return of


def _point(name: str, point: Vector | None) -> Callable[[Any], Any]:
    """Return a function of the position x that returns a point with as many components.

    Raises:
        ValueError: A number is not finite.
    """
    if point is not None and not isinstance(point, Expr):
        numbers = np.asarray(point, dtype=float)
        if numbers.ndim != 1 or not np.all(np.isfinite(numbers)):
            raise ValueError(f"{name} = {point}: give finite numbers, one for each coordinate.")

    def of(x: Any) -> Any:
        if point is None:
            return ufl.zero(len(x))
        if len(point) != len(x):
            raise ValueError(
                f"{name} = {point} has {len(point)} components, but the mesh has {len(x)} "
                "coordinates: give as many; a cylinder across the plane is a sphere there."
            )
        return point if isinstance(point, Expr) else ufl.as_vector([float(c) for c in point])

    return of
