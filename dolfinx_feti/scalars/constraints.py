# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Scalars that constrain u: its mean value, and the rigid motions of a body without support."""

from __future__ import annotations

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.runtime.values import require_finite
from dolfinx_feti.scalars.equations import ScalarEquation

__all__ = ["mean_value", "rigid_motions"]


def mean_value(
    u: dolfinx.fem.Function, value: float | Expr = 0.0, dx: ufl.Measure | None = None
) -> ScalarEquation:
    r"""Return equations that prescribe the mean ū of u, of each component: ∫ (u − ū) dX = 0.

    The unknowns are multipliers λ, one for each component.

    Args:
        u: The unknown.
        value: Its mean, a number or an expression of the shape of u.
        dx: Measure of the part over which the mean is taken; the whole body if not given.

    Raises:
        ValueError: The value is not finite, or has another shape.
    """
    mesh = u.function_space.mesh
    shape = u.ufl_shape
    dx = ufl.Measure("dx", mesh) if dx is None else dx
    require_finite(value=value)
    mean = ufl.as_ufl(value)
    if shape and not mean.ufl_shape:
        mean = mean * ufl.as_vector([1.0] * shape[0])
    if mean.ufl_shape != shape:
        raise ValueError(
            f"value has the shape {mean.ufl_shape}: give a number or the shape {shape}."
        )
    λ = dolfinx.fem.Constant(mesh, np.zeros(shape))
    difference = u - mean
    components = [difference[i] for i in range(shape[0])] if shape else [difference]
    equations = tuple(component * dx for component in components)
    return ScalarEquation(λ, equations, ufl.inner(λ, ufl.TestFunction(u.function_space)) * dx)


def rigid_motions(u: dolfinx.fem.Function, dx: ufl.Measure | None = None) -> ScalarEquation:
    """Return equations that constrain the rigid motions of a displacement.

    The unknowns are a force and a moment, which are spread over the body.

    The equations are ∫ u dX = 0 and ∫ X × u dX = 0, with three scalars in the plane and six in
    space. The scalars vanish if the loads balance each other. Then u is the solution orthogonal to
    the null space.

    Args:
        u: The displacement.
        dx: Measure of one body among several; the whole mesh if not given.

    Raises:
        ValueError: u is no displacement of a body in the plane or in space.
    """
    mesh = u.function_space.mesh
    d = mesh.geometry.dim
    if u.ufl_shape != (d,) or d not in (2, 3):
        raise ValueError(f"u has the shape {u.ufl_shape}: give a displacement in {d} components.")
    x = ufl.SpatialCoordinate(mesh)
    pairs = [(0, 1)] if d == 2 else [(1, 2), (2, 0), (0, 1)]
    dx = ufl.Measure("dx", mesh) if dx is None else dx

    def motions(w: Expr) -> list[Expr]:
        """Return the components of w and of X × w."""
        return [*(w[i] for i in range(d)), *(x[i] * w[j] - x[j] * w[i] for i, j in pairs)]

    λ = dolfinx.fem.Constant(mesh, np.zeros(d + len(pairs)))
    work = ufl.inner(λ, ufl.as_vector(motions(ufl.TestFunction(u.function_space)))) * dx
    return ScalarEquation(λ, tuple(w * dx for w in motions(u)), work)
