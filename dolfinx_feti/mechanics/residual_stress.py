# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Residual stress: a part G of the deformation has no energy, and the rest is elastic.

.. math:: F = F_e\, G, \qquad Π = \int Ψ(F_e^⊤ F_e)\, \det G \,\mathrm d X .

G maps the reference configuration to the stress-free pieces into which the wall could be cut. The
data of a layer of a tube are

- ρ₀, the radius of its middle surface, which is assumed to keep its length around the axis,
- d, the depth of a point from the middle surface, positive outwards: its radius is ρ = ρ₀ + d,
- α, the opening angle: a ring of the layer that is cut along the axis becomes a sector of 2π − α,
- Λ, the axial prestretch: a piece of length l that is cut out has the length l/Λ.

With k = 2π/(2π − α) the radius R of the point in the sector, and the circumferential stretch λ from
the sector to the ring, are (Holzapfel, Gasser, Ogden 2000, section 3)

.. math:: R^2 = (k ρ_0)^2 + k Λ (ρ^2 - ρ_0^2), \qquad λ = k ρ / R, \qquad
    G = λ^{-1} e_0 e_0^⊤ + Λ^{-1} e_1 e_1^⊤ + λ Λ\, e_2 e_2^⊤

in the circumferential, longitudinal and transmural directions: det G = 1. λ depends on d/ρ₀, and is
one in a flat wall.

*Directions.* An energy of :math:`F_e` is written with the directions of fibres in the pieces. A
direction a of the reference configuration, such as one from an image, becomes
:math:`A = G a / |G a|` in the pieces (:func:`stress_free_direction`). The directions ê in G are
those of the reference configuration, which G does not turn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import ufl
from ufl.core.expr import Expr

from dolfinx_feti.runtime.values import require_finite, require_positive, require_within

__all__ = [
    "check_opening",
    "elastic_part",
    "opening_deformation",
    "residual_stretch",
    "stress_free_direction",
]


def elastic_part(F: Expr, G: Expr) -> Expr:
    """Elastic part of a deformation, F_e = F G⁻¹, shape (d, d), for energies in F_e.

    Fibres in such an energy are those of the pieces, see :func:`stress_free_direction`.

    Args:
        F: Deformation gradient, (d, d).
        G: Part without energy, (d, d).

    Raises:
        ValueError: The shapes differ.
    """
    if F.ufl_shape != G.ufl_shape:
        raise ValueError(
            f"G has the shape {G.ufl_shape} and F {F.ufl_shape}: give a tensor like F."
        )
    return F * ufl.inv(G)


def stress_free_direction(a: Expr, G: Expr) -> Expr:
    """Direction in the stress-free pieces of a line of the reference configuration, ``G a/|G a|``.

    Args:
        a: Direction in the reference configuration, (d,), of any length but zero.
        G: Part of the deformation without energy, (d, d).

    Returns:
        A unit vector, (d,).

    Raises:
        ValueError: The shapes do not match.
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
    """Circumferential stretch λ that closing a wall with an opening angle takes [-].

    Args:
        curvature: 1/ρ₀ of the layer's middle surface, around the vessel [1/mm], finite.
        depth: d from the middle surface, positive outwards [mm]. R² has to be positive, that is,
            Λ (1 − ρ²/ρ₀²) < k; any wall of a ring meets this for α ≥ 0 and Λ ≤ 1. Otherwise the
            stretch is NaN.
        angle: Opening angle α of the whole ring [degrees], below 360.
        stretch: Axial prestretch Λ [-], positive.

    Returns:
        The stretch from the stress-free sector to the ring, a scalar in UFL.

    Raises:
        ValueError: A number is out of its range.
    """
    require_finite(curvature=curvature)
    check_opening(angle, stretch)
    k = 360.0 / (360.0 - angle)
    ratio = 1 + curvature * depth  # ρ/ρ₀
    return k * ratio / ufl.sqrt(k**2 + k * stretch * (ratio**2 - 1))


def check_opening(angle: Expr | float, stretch: Expr | float) -> None:
    """Check an opening angle [degrees] and an axial prestretch [-].

    Raises:
        ValueError: The angle is not below 360, or the stretch is not positive.
    """
    require_within(
        -math.inf, 360.0, {"angle": angle}, includes_ends=False, remedy="less than 360 degrees"
    )
    require_positive(stretch=stretch)


def opening_deformation(directions: Sequence[Expr], λ: Expr, stretch: Expr | float = 1.0) -> Expr:
    """Part G of the deformation, which opens the wall to its stress-free pieces, (3, 3), det G = 1.

    Args:
        directions: The circumferential, longitudinal and transmural directions: orthogonal unit
            vectors, (3,).
        λ: Circumferential stretch, see :func:`residual_stretch` [-].
        stretch: Axial prestretch Λ, positive [-].

    Raises:
        ValueError: ``stretch`` is not positive.
    """
    require_positive(stretch=stretch)
    circumferential, longitudinal, transmural = (ufl.outer(e, e) for e in directions)
    return circumferential / λ + longitudinal / stretch + λ * stretch * transmural
