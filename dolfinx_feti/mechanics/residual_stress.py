# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Residual stress: the deformation of a wall is elastic beyond a part that costs no energy.

.. math:: F = F_e\, G, \qquad Π = \int Ψ(F_e^⊤ F_e)\, \det G \,\mathrm d X .

G leads from the reference configuration to the pieces that would be free of stress, were the wall
cut. A layer of a tube that is cut along the axis opens by the angle α, to a sector of 2π − α; it
becomes shorter by 1/Λ when it is cut out. Let its middle surface, of radius ρ₀, keep its length
around. At the depth d from there, ρ = ρ₀ + d, and with k = 2π/(2π − α) the sector's radius R and
the stretch around are (Holzapfel, Gasser, Ogden 2000, section 3)

.. math:: R^2 = (k ρ_0)^2 + k Λ (ρ^2 - ρ_0^2), \qquad λ = k ρ / R, \qquad
    G = λ^{-1} e_0 e_0^⊤ + Λ^{-1} e_1 e_1^⊤ + λ Λ\, e_2 e_2^⊤

in the circumferential, longitudinal and transmural directions: det G = 1. λ depends on d/ρ₀, and is
one where the wall is flat.

*Directions.* An energy of :math:`F_e` is that of the pieces, and takes the directions of fibres in
the pieces. A direction a of the reference configuration, such as one that was seen in an image, is
:math:`A = G a / |G a|` there (:func:`stress_free_direction`). The directions ê of G itself are
those of the reference configuration; along them the two agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import ufl
from ufl.core.expr import Expr

from dolfinx_feti.mechanics.values import require_finite, require_positive, require_within, typed

__all__ = ["elastic_part", "opened", "residual_stretch", "stress_free_direction"]


@typed
def elastic_part(F: Expr, G: Expr) -> Expr:
    """Elastic part of a deformation, F_e = F G⁻¹, shape (d, d), of which energies are written.

    Fibres in an energy of F_e are those of the pieces, see :func:`stress_free_direction`. Different
    shapes are a ValueError.
    """
    if F.ufl_shape != G.ufl_shape:
        raise ValueError(
            f"G has the shape {G.ufl_shape} and F {F.ufl_shape}: give a tensor like F."
        )
    return F * ufl.inv(G)


@typed
def stress_free_direction(a: Expr, G: Expr) -> Expr:
    """Direction in the stress-free pieces of a line of the reference configuration, ``G a/|G a|``.

    a has any length but zero; the result is a unit vector. Other shapes are a ValueError.
    """
    if G.ufl_shape != 2 * a.ufl_shape:
        raise ValueError(
            f"G has the shape {G.ufl_shape} and a {a.ufl_shape}: give (d, d) and (d,)."
        )
    A = G * a
    return A / ufl.sqrt(ufl.inner(A, A))


def residual_stretch(
    curvature: Expr | float, depth: Expr, angle: Expr | float, stretch: Expr | float = 1.0
) -> Expr:
    """Stretch around that a wall which is closed has left of its opening angle, λ [-].

    Args:
        curvature: 1/ρ₀ of the layer's middle surface, around the vessel [1/mm], finite.
        depth: d from the middle surface, positive outwards [mm].
        angle: Opening angle α of the whole ring [degrees], below 360.
        stretch: Axial prestretch Λ [-], positive.
    """
    require_finite(curvature=curvature)
    require_within(-math.inf, 360.0, {"angle": angle}, ends=False, remedy="less than 360 degrees")
    require_positive(stretch=stretch)
    k = 360.0 / (360.0 - angle)
    ratio = 1 + curvature * depth  # ρ/ρ₀
    return k * ratio / ufl.sqrt(k**2 + k * stretch * (ratio**2 - 1))


@typed
def opened(directions: Sequence[Expr], λ: Expr, stretch: Expr | float = 1.0) -> Expr:
    """Part G of the deformation of a wall that was cut open, shape (3, 3), det G = 1.

    The directions are the circumferential, longitudinal and transmural one, orthogonal unit vectors
    (3,), λ is that of :func:`residual_stretch`, ``stretch`` the axial prestretch Λ, positive [-].
    """
    require_positive(stretch=stretch)
    e0, e1, e2 = (ufl.outer(e, e) for e in directions)
    return e0 / λ + e1 / stretch + λ * stretch * e2
