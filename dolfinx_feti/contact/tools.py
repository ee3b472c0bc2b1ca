# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Rigid tools: signed distances g(x) of a current position x from the surface of a tool, in UFL.

.. math:: g(x) > 0 \text{ outside of the tool}, \qquad g(x) < 0 \text{ inside of it}, \qquad
          |∇g| = 1.

A tool is a function ``x ↦ g`` of a vector of UFL, one of these or the user's. Its numbers may be
Constants: the tool then moves or grows with them, as in ``set_load`` of ``follow_load``. Lengths
are in the unit of the mesh.

The length of ∇g is not checked. At a kink of g, as between the tools of a union, UFL evaluates the
derivative of one side. At the centre of a sphere and on the axis of a cylinder the derivative is
0/0: no point of the surface may touch a tool there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, TypeAlias, TypeGuard

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.runtime.values import require_finite, require_positive

__all__ = ["Tool", "Vector", "cylinder", "gap_from", "half_space", "sphere", "torus", "union"]

#: A signed distance of the current position: a function of an expression of UFL, a vector, that
#: returns an expression, a scalar. ``Any``, because UFL's operators have no types.
Tool: TypeAlias = Callable[[Any], Any]

#: A point or a direction: numbers, some of which may be Constants or expressions of UFL; or one
#: Constant or expression of UFL for all components.
Vector: TypeAlias = Sequence[float | Expr] | Expr


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
    _check_direction("normal", normal)
    _check_point("point", point)

    def distance(x: Any) -> Any:
        n = _unit_vector("normal", normal, x)
        return ufl.dot(n, x - _vector("point", point, x)) - offset

    return distance


def sphere(radius: float | Expr, centre: Vector | None = None, *, inside: bool = False) -> Tool:
    """Return the distance from a sphere, ‖x − c‖ − R; in the plane from a circle.

    Args:
        radius: Its radius R.
        centre: c; the origin if not given.
        inside: Whether the body is inside a hollow sphere, R − ‖x − c‖.

    Raises:
        ValueError: The radius is not positive, or a number is not finite.
    """
    require_positive(radius=radius)
    _check_point("centre", centre)

    def distance(x: Any) -> Any:
        outside = _length(x - _vector("centre", centre, x)) - radius
        return -outside if inside else outside

    return distance


def cylinder(
    axis: Vector, radius: float | Expr, point: Vector | None = None, *, inside: bool = False
) -> Tool:
    """Return the distance from an endless cylinder, ‖(I − a ⊗ a)(x − p)‖ − R.

    Args:
        axis: Its direction a, of any length. In the plane take :func:`sphere`, which is a circle
            there.
        radius: Its radius R.
        point: p, a point of the axis; the origin if not given.
        inside: Whether the body is inside a hollow cylinder, R − ‖…‖.

    Raises:
        ValueError: The axis is zero, the radius not positive, or a number is not finite.
    """
    require_positive(radius=radius)
    _check_direction("axis", axis)
    _check_point("point", point)

    def distance(x: Any) -> Any:
        a = _unit_vector("axis", axis, x)
        d = x - _vector("point", point, x)
        outside = _length(d - ufl.dot(d, a) * a) - radius
        return -outside if inside else outside

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
    _check_direction("axis", axis)
    _check_point("centre", centre)

    def distance(x: Any) -> Any:
        a = _unit_vector("axis", axis, x)
        d = x - _vector("centre", centre, x)
        along = ufl.dot(d, a)
        across = _length(d - along * a) - radius
        outside = ufl.sqrt(across**2 + along**2) - tube
        return -outside if inside else outside

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


def gap_from(tool: Tool, u: dolfinx.fem.Function) -> Expr:
    """Return g(X + u), the signed distance of a displaced body from a tool.

    Args:
        tool: The tool.
        u: The displacement.

    Raises:
        ValueError: The distance is no scalar, or does not depend on the position.
        TypeError: The tool is no function.
    """
    if not callable(tool):
        raise TypeError(
            f"tool is {tool!r}: give a function of the position, such as sphere(radius=1.0)."
        )
    g = ufl.as_ufl(tool(ufl.SpatialCoordinate(u.function_space.mesh) + u))
    if g.ufl_shape != () or g.ufl_free_indices:
        raise ValueError(f"The tool's distance has the shape {g.ufl_shape}: give a scalar.")
    if u not in ufl.algorithms.extract_coefficients(g):
        raise ValueError(
            "The tool's distance does not depend on the position x that it is called with: "
            "write it in x, as lambda x: x[2] - height."
        )
    return g


def _length(d: Any) -> Any:
    """Return ‖d‖."""
    return ufl.sqrt(ufl.dot(d, d))


def _check_point(name: str, point: Vector | None) -> None:
    """Raise a ValueError if a number is not finite. Expressions of UFL are not checked."""
    if point is None or isinstance(point, Expr):
        return
    message = f"{name} = {point}: give finite numbers, one for each coordinate."
    if not isinstance(point, Sequence | np.ndarray):
        raise ValueError(message)
    numbers = np.asarray([c for c in point if not isinstance(c, Expr)], dtype=float)
    if numbers.ndim != 1 or not np.all(np.isfinite(numbers)):
        raise ValueError(message)


def _check_direction(name: str, direction: Vector) -> None:
    """Raise a ValueError if a direction of numbers is zero, or not finite."""
    _check_point(name, direction)
    if _has_numbers_alone(direction) and _norm(direction) == 0.0:
        raise ValueError(f"{name} = {tuple(direction)}: give a vector that is not zero.")


def _has_numbers_alone(vector: Vector) -> TypeGuard[Sequence[float]]:
    """Return True if no component of a vector is a Constant or an expression of UFL."""
    return not isinstance(vector, Expr) and not any(isinstance(c, Expr) for c in vector)


def _norm(direction: Sequence[float]) -> float:
    """Return the length of a vector of numbers."""
    return math.hypot(*map(float, direction))


def _vector(name: str, vector: Vector | None, x: Any) -> Any:
    """Return a vector of UFL with as many components as the position x; zero for None.

    Components that are Constants or expressions stay what they are, so that the tool follows them.

    Raises:
        ValueError: The vector has a different number of components.
    """
    if vector is None:
        return ufl.zero(len(x))
    if len(vector) != len(x):
        raise ValueError(
            f"{name} = {vector} has {len(vector)} components, but the mesh has {len(x)} "
            f"coordinates: give {len(x)}. In the plane a cylinder is sphere(radius, centre)."
        )
    if isinstance(vector, Expr):
        return vector
    return ufl.as_vector([c if isinstance(c, Expr) else float(c) for c in vector])


def _unit_vector(name: str, direction: Vector, x: Any) -> Any:
    """Return a unit vector of UFL with as many components as the position x.

    Raises:
        ValueError: The direction has a different number of components.
    """
    d = _vector(name, direction, x)
    if not _has_numbers_alone(direction):
        return d / _length(d)
    length = _norm(direction)
    return ufl.as_vector([float(component) / length for component in direction])
