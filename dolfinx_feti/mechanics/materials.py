# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Energies of hyperelastic materials, per unit reference volume, as plain UFL expressions.

A material is defined by its energy alone: with Π = ∫ Ψ dX, the residual ``ufl.derivative(Π, u, v)``
is the internal virtual work ∫ S : Σ(u, v) dX (eq. 20, Augustin_eq:WeakReference, eq. 21), and its
derivative is the tangent (eq. 24, Augustin_eq:Tangent). Users' own energies work exactly like those
below. For nearly incompressible tissue (eq. 10, Augustin_eq:decompositionStrain)

    Ψ(C) = Ψ̄(C̄) + Ψ_vol(J),   or with a pressure field   Ψ(C, p) = Ψ̄(C̄) + p (J − 1) − p²/(2κ).

Isochoric energies Ψ̄ are :func:`neo_hookean`, :func:`mooney_rivlin`, :func:`holzapfel_gasser_ogden`
and :func:`gasser_ogden_holzapfel`; the volumetric part is :func:`volumetric` or
:func:`perturbed_lagrangian`; :func:`saint_venant_kirchhoff` is complete in itself.

Parameters are floats, dolfinx constants (a new value needs no recompilation), or any UFL
expression, such as a piecewise constant Function for layers. Floats are checked.

A distant trial state may overflow the exponential, and J ≤ 0 gives NaN. Nothing is clamped here:
the nonlinear solver has to reject such a state.

Note: quadrature
    The polynomial degree that UFL estimates for exponentials and powers leads to thousands of
    points per cell, and to code a thousand times slower than necessary. Set the degree in the
    measure (``metadata={"quadrature_degree": 4}``), or use
    :func:`~dolfinx_feti.fem.quadrature.limit_quadrature_degree`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from numbers import Real
from typing import TypeAlias

import ufl
from ufl.core.expr import Expr

from dolfinx_feti.mechanics.kinematics import (
    isochoric_invariant_1,
    isochoric_invariant_2,
    isochoric_invariant_4,
)

__all__ = [
    "ArteryParameters",
    "gasser_ogden_holzapfel",
    "holzapfel_gasser_ogden",
    "mooney_rivlin",
    "neo_hookean",
    "perturbed_lagrangian",
    "saint_venant_kirchhoff",
    "volumetric",
]

Parameter: TypeAlias = float | Expr

# At u = 0 every E = Ī₄ − 1 is zero up to rounding. A switch slightly below zero keeps all fibres in
# the tangent there, not those of a random half of the cells; the jump of Ψ at the switch is
# 1e-24 k₁.
_FIBRE_SWITCH = -1e-12


@dataclass(frozen=True, slots=True)
class ArteryParameters:
    """Parameters of the artery model (table 1, Augustin_tab:param, from Holzapfel et al. 2000).

    Attributes:
        c: Stiffness of the matrix material [kPa].
        k1: Stiffness of the fibres [kPa].
        k2: Exponent of the fibres [-].

    Raises:
        ValueError: If a parameter is not a positive number.
    """

    c: float = 3.0
    k1: float = 2.3632
    k2: float = 0.8393

    def __post_init__(self) -> None:
        """Check the values."""
        _require_positive(**{f.name: getattr(self, f.name) for f in fields(self)})


def volumetric(J: Expr, kappa: Parameter) -> Expr:
    """Volumetric energy Ψ_vol = κ/2 (J − 1)² (eq. 14).

    Args:
        J: Volume ratio det F.
        kappa: Penalty, like a bulk modulus [kPa].

    Raises:
        ValueError: If ``kappa`` is a number that is not positive.
    """
    _require_positive(kappa=kappa)
    return kappa / 2 * (J - 1) ** 2


def perturbed_lagrangian(J: Expr, p: Expr, kappa: Parameter) -> Expr:
    """Volumetric energy with the pressure as an independent field, p (J − 1) − p²/(2κ).

    It is stationary in p at p = κ (J − 1) = ∂Ψ_vol/∂J (eq. 12, Augustin_eq:hydrostaticPressure,
    eq. 29, Augustin_eq:volumetricVariationDis), where it equals :func:`volumetric`. If p is
    piecewise constant, this holds for the mean of J over each cell.

    Args:
        J: Volume ratio det F.
        p: Hydrostatic pressure [kPa], positive in tension; a piecewise constant Function.
        kappa: Penalty [kPa].

    Raises:
        ValueError: If ``kappa`` is a number that is not positive.
    """
    _require_positive(kappa=kappa)
    return p * (J - 1) - p**2 / (2 * kappa)


def neo_hookean(C: Expr, *, c: Parameter, J: Expr | None = None) -> Expr:
    """Isochoric neo-Hookean energy Ψ̄ = c/2 (Ī₁ − 3) (eq. 15, Augustin_eq:iso).

    Args:
        C: Right Cauchy-Green tensor, shape (d, d).
        c: Stress-like parameter, the shear modulus at small strains [kPa].
        J: Volume ratio det F. If given, the tangent is cheaper and inverted elements give NaN; if
            not, √(det C) is used.

    Raises:
        ValueError: If ``c`` is a number that is not positive.
    """
    _require_positive(c=c)
    return c / 2 * (isochoric_invariant_1(C, J) - 3)


def mooney_rivlin(C: Expr, *, c10: Parameter, c01: Parameter, J: Expr | None = None) -> Expr:
    """Isochoric Mooney-Rivlin energy Ψ̄ = c₁₀ (Ī₁ − 3) + c₀₁ (Ī₂ − 3).

    The shear modulus at small strains is 2 (c₁₀ + c₀₁). Source: Mooney, J. Appl. Phys. 11 (1940);
    Rivlin, Phil. Trans. R. Soc. A 241 (1948).

    Args:
        C: Right Cauchy-Green tensor, shape (d, d).
        c10: Stress-like parameter of Ī₁ [kPa].
        c01: Stress-like parameter of Ī₂ [kPa].
        J: Volume ratio det F, as in :func:`neo_hookean`.

    Raises:
        ValueError: If a parameter is a number that is not positive.
    """
    _require_positive(c10=c10, c01=c01)
    return c10 * (isochoric_invariant_1(C, J) - 3) + c01 * (isochoric_invariant_2(C, J) - 3)


def holzapfel_gasser_ogden(
    C: Expr,
    a1: Expr,
    a2: Expr,
    *,
    c: Parameter,
    k1: Parameter,
    k2: Parameter,
    J: Expr | None = None,
) -> Expr:
    """Isochoric energy of a wall with two families of fibres (eq. 13, Augustin_eq:isoaniso).

    Ψ̄ = c/2 (Ī₁ − 3) + Σ_{i=4,6} k₁/(2k₂) {exp[k₂ (Ī_i − 1)²] − 1}, where a family contributes
    only in tension, Ī_i > 1 (eq. 15, Augustin_eq:iso, eq. 16, Augustin_eq:aniso_1, eq. 17,
    Augustin_eq:aniso_2).

    Args:
        C: Right Cauchy-Green tensor, shape (d, d).
        a1: Direction of the first family in the reference configuration, a unit vector, shape (d,).
        a2: Direction of the second family.
        c: Stiffness of the matrix material [kPa].
        k1: Stiffness of the fibres [kPa].
        k2: Exponent of the fibres [-].
        J: Volume ratio det F. If given, the tangent is cheaper and inverted elements give NaN; if
            not, √(det C) is used.

    Raises:
        ValueError: If a parameter is a number that is not positive.
    """
    _require_positive(c=c, k1=k1, k2=k2)
    families = (_fibre_energy(isochoric_invariant_4(C, a, J) - 1, k1, k2) for a in (a1, a2))
    return neo_hookean(C, c=c, J=J) + sum(families)


def gasser_ogden_holzapfel(
    C: Expr,
    a1: Expr,
    a2: Expr,
    *,
    c: Parameter,
    k1: Parameter,
    k2: Parameter,
    dispersion: Parameter,
    J: Expr | None = None,
) -> Expr:
    """Isochoric energy of a wall with two families of fibres whose directions are dispersed.

    Ψ̄ = c/2 (Ī₁ − 3) + Σ_{i=4,6} k₁/(2k₂) {exp[k₂ E_i²] − 1} with the mean strain of a family
    E_i = ϰ (Ī₁ − 3) + (1 − 3ϰ)(Ī_i − 1), which contributes only where E_i > 0. A dispersion ϰ = 0
    is :func:`holzapfel_gasser_ogden`, and ϰ = 1/3 is isotropic. Source: Gasser, Ogden, Holzapfel,
    J. R. Soc. Interface 3 (2006) 15-35.

    Args:
        C: Right Cauchy-Green tensor, shape (d, d).
        a1: Mean direction of the first family in the reference configuration, a unit vector, (d,).
        a2: Mean direction of the second family.
        c: Stiffness of the matrix material [kPa].
        k1: Stiffness of the fibres [kPa].
        k2: Exponent of the fibres [-].
        dispersion: ϰ, between 0 and 1/3 [-].
        J: Volume ratio det F, as in :func:`neo_hookean`.

    Raises:
        ValueError: If a parameter is a number that is not positive, or ``dispersion`` one that is
            not between 0 and 1/3.
    """
    _require_positive(c=c, k1=k1, k2=k2)
    if not isinstance(dispersion, Expr) and not 0.0 <= dispersion <= 1 / 3:
        raise ValueError(f"dispersion = {dispersion}: give a number between 0 and 1/3.")
    I1 = isochoric_invariant_1(C, J)
    strains = (
        dispersion * (I1 - 3) + (1 - 3 * dispersion) * (isochoric_invariant_4(C, a, J) - 1)
        for a in (a1, a2)
    )
    return neo_hookean(C, c=c, J=J) + sum(_fibre_energy(E, k1, k2) for E in strains)


def saint_venant_kirchhoff(C: Expr, *, lmbda: Parameter, mu: Parameter) -> Expr:
    """Complete, compressible energy Ψ = λ/2 (tr E)² + μ E : E with E = ½ (C − I).

    Hooke's law extended to large strains; not polyconvex, and too soft in strong compression.

    Args:
        C: Right Cauchy-Green tensor, shape (d, d).
        lmbda: First Lamé parameter λ [kPa].
        mu: Second Lamé parameter μ [kPa].

    Raises:
        ValueError: If a parameter is a number that is not positive.
    """
    _require_positive(lmbda=lmbda, mu=mu)
    E = (C - ufl.Identity(C.ufl_shape[0])) / 2
    return lmbda / 2 * ufl.tr(E) ** 2 + mu * ufl.inner(E, E)


def _fibre_energy(E: Expr, k1: Parameter, k2: Parameter) -> Expr:
    """Energy k₁/(2k₂) {exp[k₂ E²] − 1} of one family with strain E, zero in compression."""
    stretched = k1 / (2 * k2) * (ufl.exp(k2 * E**2) - 1)
    return ufl.conditional(ufl.gt(E, _FIBRE_SWITCH), stretched, 0.0)


def _require_positive(**parameters: Parameter) -> None:
    """Refuse numbers that are not finite and positive; UFL expressions are not checked."""
    for name, value in parameters.items():
        if isinstance(value, Expr):
            continue
        if not isinstance(value, Real):
            raise TypeError(f"{name} = {value!r}: expected a number or a UFL expression.")
        if not 0.0 < float(value) < math.inf:
            raise ValueError(f"{name} = {value}: give a positive, finite material parameter.")
