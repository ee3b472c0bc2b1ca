# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Energies of hyperelastic materials, per unit reference volume, as plain UFL expressions.

The derivatives of Π = ∫ Ψ dX are the residual (eq. 20 and eq. 21 of the paper) and the tangent
(eq. 24). For nearly incompressible tissue (eq. 10)

    Ψ(C) = Ψ̄(C̄) + Ψ_vol(J),   or with a pressure field   Ψ(C, p) = Ψ̄(C̄) + p (J − 1) − p²/(2κ).

All functions have these arguments, and return an energy in kPa:

- C: right Cauchy–Green tensor, (d, d).
- a1, a2, fibre, sheet: directions in the reference configuration, *unit* vectors, (d,).
- J: det F. Without it, √(det C) is used: the tangent takes longer to assemble, and an inverted
  element does not give NaN.
- Parameters are floats, dolfinx constants, or any UFL expression, such as a Function of the layer.
  Stiffnesses are in kPa, exponents without unit. A float out of its range raises a ValueError.

An isochoric energy Ψ̄ needs a volumetric part, :func:`volumetric` or :func:`perturbed_lagrangian`.
A *complete* energy resists changes of volume by itself. For exponentials set the quadrature degree,
or use :func:`~dolfinx_feti.fem.quadrature.limit_quadrature_degree`.

A new material is a function here, and its name in ``__all__``: no other file lists materials. Its
docstring says whether it is isochoric or complete. A case in TOML (``wall.casefile``) has the
parameters of :func:`holzapfel_gasser_ogden` only.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TypeAlias

import ufl
from ufl.core.expr import Expr

from dolfinx_feti.mechanics.kinematics import (
    isochoric_invariant_1,
    isochoric_invariant_2,
    isochoric_invariant_4,
    isochoric_invariant_5,
    isochoric_invariant_8,
)
from dolfinx_feti.runtime.values import require_not_negative, require_positive, require_within

__all__ = [
    "ArteryParameters",
    "active_tension",
    "gasser_ogden_holzapfel",
    "guccione",
    "holzapfel_gasser_ogden",
    "holzapfel_ogden",
    "mooney_rivlin",
    "neo_hookean",
    "perturbed_lagrangian",
    "saint_venant_kirchhoff",
    "volumetric",
]

Parameter: TypeAlias = float | Expr

#: Strain E = Ī₄ − 1 of a fibre family above which it contributes. At u = 0 every E is zero up to
#: rounding. With a bound of zero, the tangent there would contain the fibres of some cells only, by
#: the sign of rounding errors. With a bound slightly below zero it contains all of them. The jump
#: of Ψ at the bound is 1e-24 k₁.
MIN_FIBRE_STRAIN = -1e-12


@dataclass(frozen=True, slots=True)
class ArteryParameters:
    """Parameters of the artery model, :func:`holzapfel_gasser_ogden` (table 1 of the paper)."""

    c: float = 3.0  #: Stiffness of the matrix material [kPa]
    k1: float = 2.3632  #: Stiffness of the fibres [kPa]
    k2: float = 0.8393  #: Exponent of the fibres [-]

    def __post_init__(self) -> None:
        """Check the values."""
        require_positive(**{f.name: getattr(self, f.name) for f in fields(self)})


def volumetric(J: Expr, kappa: Parameter) -> Expr:
    """Volumetric energy Ψ_vol = κ/2 (J − 1)² (eq. 14); the penalty κ acts as a bulk modulus."""
    require_positive(kappa=kappa)
    return kappa / 2 * (J - 1) ** 2


def perturbed_lagrangian(J: Expr, p: Expr, kappa: Parameter) -> Expr:
    """Volumetric energy with the pressure as an independent field, p (J − 1) − p²/(2κ).

    It is stationary in p at p = κ (J − 1) = ∂Ψ_vol/∂J (eq. 12, eq. 29), where it
    equals :func:`volumetric` with the projection of J onto the space of p in each cell. p is
    positive in tension.

    Args:
        J: det F.
        p: Pressure [kPa], an independent field.
        kappa: Penalty κ of the change of volume [kPa].
    """
    require_positive(kappa=kappa)
    return p * (J - 1) - p**2 / (2 * kappa)


def neo_hookean(C: Expr, *, c: Parameter, J: Expr | None = None) -> Expr:
    """Isochoric neo-Hookean energy Ψ̄ = c/2 (Ī₁ − 3) (eq. 15).

    Args:
        C: Right Cauchy–Green tensor, (d, d).
        c: Shear modulus at small strains [kPa].
        J: det F; √(det C) if not given.
    """
    require_positive(c=c)
    return c / 2 * (isochoric_invariant_1(C, J) - 3)


def mooney_rivlin(C: Expr, *, c10: Parameter, c01: Parameter, J: Expr | None = None) -> Expr:
    """Isochoric Mooney-Rivlin energy Ψ̄ = c₁₀ (Ī₁ − 3) + c₀₁ (Ī₂ − 3).

    The shear modulus at small strains is 2 (c₁₀ + c₀₁). Source: Mooney, J. Appl. Phys. 11 (1940);
    Rivlin, Phil. Trans. R. Soc. A 241 (1948).

    Args:
        C: Right Cauchy–Green tensor, (d, d).
        c10: Stiffness for the first invariant [kPa].
        c01: Stiffness for the second invariant [kPa].
        J: det F; √(det C) if not given.
    """
    require_positive(c10=c10, c01=c01)
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
    """Isochoric energy of a wall with two families of fibres (eq. 13).

    Ψ̄ = c/2 (Ī₁ − 3) + Σ_{i=4,6} k₁/(2k₂) {exp[k₂ (Ī_i − 1)²] − 1}, where a family contributes
    only in tension, Ī_i > 1 (eq. 15, eq. 16, eq. 17).

    Args:
        C: Right Cauchy–Green tensor, (d, d).
        a1: Direction of the first family, a unit vector, (d,).
        a2: Direction of the second family, a unit vector, (d,).
        c: Stiffness of the matrix material [kPa].
        k1: Stiffness of the fibres [kPa].
        k2: Exponent of the fibres [-].
        J: det F; √(det C) if not given.
    """
    require_positive(c=c, k1=k1, k2=k2)
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
    is :func:`holzapfel_gasser_ogden`, and ϰ = 1/3, the largest, is isotropic. Source: Gasser,
    Ogden, Holzapfel, J. R. Soc. Interface 3 (2006) 15-35.

    Args:
        C: Right Cauchy–Green tensor, (d, d).
        a1: Mean direction of the first family, a unit vector, (d,).
        a2: Mean direction of the second family, a unit vector, (d,).
        c: Stiffness of the matrix material [kPa].
        k1: Stiffness of the fibres [kPa].
        k2: Exponent of the fibres [-].
        dispersion: Share ϰ of a family that points anywhere, from 0 to 1/3 [-].
        J: det F; √(det C) if not given.
    """
    require_positive(c=c, k1=k1, k2=k2)
    require_within(0.0, 1 / 3, {"dispersion": dispersion}, remedy="a number between 0 and 1/3")
    I1 = isochoric_invariant_1(C, J)
    strains = (
        dispersion * (I1 - 3) + (1 - 3 * dispersion) * (isochoric_invariant_4(C, a, J) - 1)
        for a in (a1, a2)
    )
    return neo_hookean(C, c=c, J=J) + sum(_fibre_energy(E, k1, k2) for E in strains)


def guccione(
    C: Expr,
    fibre: Expr,
    *,
    c: Parameter,
    b_f: Parameter,
    b_t: Parameter,
    b_fs: Parameter,
    J: Expr | None = None,
) -> Expr:
    """Isochoric energy of the heart's muscle, transversely isotropic about its fibres.

    Ψ̄ = c/2 (exp Q − 1) with Q = b_f E_ff² + b_t (E_ss² + E_nn² + 2 E_sn²) + 2 b_fs (E_fs² + E_fn²)
    and the components E_ij of Ē = ½ (C̄ − I) along the fibre f and any two directions s, n normal
    to it.
    Source: Guccione, McCulloch, Waldman, J. Biomech. Eng. 113 (1991) 42-55, as in problem 1 of Land
    et al., Proc. R. Soc. A 471 (2015) 20150641, where c = 2 kPa and b_f, b_t, b_fs = 8, 2, 4. The
    shear modulus at small strains is c b/2, with b_t across the fibres and b_fs along them. Where
    fibres shorten much (with these numbers to 0.82), the energy is not elliptic.

    Args:
        C: Right Cauchy–Green tensor, (d, d).
        fibre: Direction of the fibres, a unit vector, (d,).
        c: Stiffness [kPa].
        b_f: Exponent along the fibres [-].
        b_t: Exponent across the fibres [-].
        b_fs: Exponent of shear along the fibres [-].
        J: det F; √(det C) if not given.
    """
    require_positive(c=c, b_f=b_f, b_t=b_t, b_fs=b_fs)
    I1 = isochoric_invariant_1(C, J)
    I2 = isochoric_invariant_2(C, J)
    I4 = isochoric_invariant_4(C, fibre, J)
    I5 = isochoric_invariant_5(C, fibre, J)
    square_ff = (I4 - 1) ** 2 / 4  # E_ff²
    square_f = (I5 - 2 * I4 + 1) / 4  # |Ē f|² = E_ff² + E_fs² + E_fn²
    square = (I1**2 - 2 * I2 - 2 * I1 + 3) / 4  # Ē : Ē
    across = square - 2 * square_f + square_ff  # E_ss² + E_nn² + 2 E_sn²
    Q = b_f * square_ff + b_t * across + 2 * b_fs * (square_f - square_ff)
    return c / 2 * (ufl.exp(Q) - 1)


def holzapfel_ogden(
    C: Expr,
    fibre: Expr,
    sheet: Expr,
    *,
    a: Parameter,
    b: Parameter,
    a_f: Parameter,
    b_f: Parameter,
    a_s: Parameter,
    b_s: Parameter,
    a_fs: Parameter,
    b_fs: Parameter,
    J: Expr | None = None,
) -> Expr:
    """Isochoric energy of the heart's muscle, orthotropic with fibres f in sheets s.

    Ψ̄ = a/(2b) {exp[b (Ī₁ − 3)] − 1} + Σ_{i=f,s} a_i/(2b_i) {exp[b_i (Ī_4i − 1)²] − 1}
    + a_fs/(2b_fs) {exp[b_fs Ī_8fs²] − 1} with Ī_4f = f·C̄ f, Ī_4s = s·C̄ s, Ī_8fs = f·C̄ s, where
    fibres and sheets contribute only in tension, Ī_4i > 1. Source: Holzapfel, Ogden, Phil. Trans.
    R. Soc. A 367 (2009) 3445-3475, where a fit to shear tests on a pig's myocardium gives a, a_f,
    a_s, a_fs = 0.059, 18.472, 2.481, 0.216 kPa and b, b_f, b_s, b_fs = 8.023, 16.026, 11.120,
    11.436. Here a and b are parameters, not directions.

    Args:
        C: Right Cauchy–Green tensor, (d, d).
        fibre: Direction of the fibres, a unit vector, (d,).
        sheet: Direction in the sheets and normal to the fibres, a unit vector, (d,).
        a: Stiffness of the matrix material [kPa].
        b: Exponent of the matrix material [-].
        a_f: Stiffness along the fibres [kPa].
        b_f: Exponent along the fibres [-].
        a_s: Stiffness along the sheets [kPa].
        b_s: Exponent along the sheets [-].
        a_fs: Stiffness of shear between fibres and sheets [kPa].
        b_fs: Exponent of shear between fibres and sheets [-].
        J: det F; √(det C) if not given.
    """
    require_positive(a=a, b=b, a_f=a_f, b_f=b_f, a_s=a_s, b_s=b_s, a_fs=a_fs, b_fs=b_fs)
    ground = a / (2 * b) * (ufl.exp(b * (isochoric_invariant_1(C, J) - 3)) - 1)
    fibres = _fibre_energy(isochoric_invariant_4(C, fibre, J) - 1, a_f, b_f)
    sheets = _fibre_energy(isochoric_invariant_4(C, sheet, J) - 1, a_s, b_s)
    shear = _exponential(isochoric_invariant_8(C, fibre, sheet, J), a_fs, b_fs)
    return ground + fibres + sheets + shear


def active_tension(C: Expr, fibre: Expr, *, tension: Parameter) -> Expr:
    """Energy T_a/2 (I₄ − 1) of muscle fibres that contract actively, with a tension T_a [kPa].

    It adds T_a f ⊗ f to the second Piola-Kirchhoff stress of a passive energy: T_a is the force per
    reference area over the stretch. I₄ = f·C f is not isochoric. Source: problem 3 of Land et al.,
    Proc. R. Soc. A 471 (2015) 20150641.

    Args:
        C: Right Cauchy–Green tensor, (d, d).
        fibre: Direction of the fibres, a unit vector, (d,).
        tension: Active tension T_a, not negative [kPa].
    """
    require_not_negative(tension=tension)
    return tension / 2 * (ufl.dot(fibre, C * fibre) - 1)


def saint_venant_kirchhoff(C: Expr, *, lmbda: Parameter, mu: Parameter) -> Expr:
    """Complete, compressible energy Ψ = λ/2 (tr E)² + μ E : E with E = ½ (C − I).

    Hooke's law, with Lamé's parameters, extended to large strains; not polyconvex, and too soft in
    strong compression.

    Args:
        C: Right Cauchy–Green tensor, (d, d).
        lmbda: First Lamé parameter λ [kPa].
        mu: Shear modulus μ [kPa].
    """
    require_positive(lmbda=lmbda, mu=mu)
    E = (C - ufl.Identity(C.ufl_shape[0])) / 2
    return lmbda / 2 * ufl.tr(E) ** 2 + mu * ufl.inner(E, E)


def _fibre_energy(E: Expr, k1: Parameter, k2: Parameter) -> Expr:
    """Energy k₁/(2k₂) {exp[k₂ E²] − 1} of one family with strain E, zero in compression."""
    return ufl.conditional(ufl.gt(E, MIN_FIBRE_STRAIN), _exponential(E, k1, k2), 0.0)


def _exponential(E: Expr, k1: Parameter, k2: Parameter) -> Expr:
    """k₁/(2k₂) {exp[k₂ E²] − 1}."""
    return k1 / (2 * k2) * (ufl.exp(k2 * E**2) - 1)
