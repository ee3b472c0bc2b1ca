# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Kinematics of large deformations as UFL expressions.

A body moves by x = X + u(X), F = J^{1/3} F̄ and C = J^{2/3} C̄ (eq. 1, eq. 3 and eq. 4 of the
paper). Gradients, and directions a, b of fibres, belong to the reference configuration; directions
are unit vectors, (d,). Two dimensions are plane strain: the third stretch is 1. The invariants take
C, (d, d), and J = det F. Without J they use √(det C): forms then take a quarter more time to
assemble, and an inverted element is not noticed. Units: mm, kPa.
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal
from ufl.variable import Variable

__all__ = [
    "cauchy_stress",
    "deformation_gradient",
    "isochoric_invariant_1",
    "isochoric_invariant_2",
    "isochoric_invariant_4",
    "isochoric_invariant_5",
    "isochoric_invariant_8",
    "jacobian",
    "right_cauchy_green",
    "stress_magnitude",
]


def deformation_gradient(u: Expr) -> Variable:
    """Deformation gradient F = I + Grad u (eq. 2), shape (d, d), of a displacement u, (d,).

    It is a ``ufl.variable``, so that stresses follow from an energy by ``ufl.diff``. Every call
    creates a new variable: call it once, and write both the energy and the stress in that F.
    """
    return ufl.variable(ufl.Identity(len(u)) + ufl.grad(u))


def right_cauchy_green(F: Expr) -> Expr:
    """Right Cauchy-Green tensor C = Fᵀ F, shape (d, d)."""
    return F.T * F


def jacobian(F: Expr) -> Expr:
    """Volume ratio J = det F, deformed over reference; a state with J ≤ 0 is inadmissible."""
    return ufl.det(F)


def isochoric_invariant_1(C: Expr, J: Expr | None = None) -> Expr:
    """First isochoric invariant Ī₁ = tr C̄ = J^{-2/3} tr C."""
    return _volume_factor(C, J) * (ufl.tr(C) + _missing_dimensions(C))


def isochoric_invariant_2(C: Expr, J: Expr | None = None) -> Expr:
    """Second isochoric invariant Ī₂ = ½ (Ī₁² − tr C̄²) = J^{-4/3} ½ ((tr C)² − tr C²)."""
    trace = ufl.tr(C) + _missing_dimensions(C)
    trace_of_square = ufl.inner(C, C) + _missing_dimensions(C)
    return _volume_factor(C, J) ** 2 * (trace**2 - trace_of_square) / 2


def isochoric_invariant_4(C: Expr, a: Expr, J: Expr | None = None) -> Expr:
    """Squared isochoric stretch of a fibre family, Ī₄ = a·(C̄ a) = J^{-2/3} a·(C a)."""
    return _volume_factor(C, J) * ufl.dot(a, C * a)


def isochoric_invariant_5(C: Expr, a: Expr, J: Expr | None = None) -> Expr:
    """Squared length of the strained fibre vector, Ī₅ = a·(C̄² a) = J^{-4/3} (C a)·(C a)."""
    return _volume_factor(C, J) ** 2 * ufl.dot(C * a, C * a)


def isochoric_invariant_8(C: Expr, a: Expr, b: Expr, J: Expr | None = None) -> Expr:
    """Shear of two directions that are normal to each other, Ī₈ = a·(C̄ b) = J^{-2/3} a·(C b)."""
    return _volume_factor(C, J) * ufl.dot(a, C * b)


def cauchy_stress(psi: Expr, F: Variable) -> Expr:
    """Cauchy stress of an energy, σ = J⁻¹ (∂Ψ/∂F) Fᵀ = 2 J⁻¹ F (∂Ψ/∂C) Fᵀ (eq. 9).

    With a separate pressure field, Ψ = Ψ̄ + p (J − 1) − …, the result is
    σ = p I + 2 J⁻¹ F (∂Ψ̄/∂C) Fᵀ (eq. 11).

    Raises:
        ValueError: ``psi``, per unit reference volume, is not written in the variable F.
    """
    are_expressions = isinstance(psi, Expr) and isinstance(F, Variable)
    if not are_expressions or not _contains(psi, F):
        raise ValueError(
            "psi does not depend on the variable F, so its stress would be zero. Call "
            "deformation_gradient (or ufl.variable) once and write psi in the F that it returns."
        )
    return ufl.diff(psi, F) * F.T / jacobian(F)


def stress_magnitude(sigma: Expr) -> Expr:
    """Frobenius norm of a symmetric stress, σ_mag = √(σ : σ) (eq. 56)."""
    return ufl.sqrt(ufl.inner(sigma, sigma))


def _contains(psi: Expr, F: Variable) -> bool:
    """Return True if an expression contains a variable. ``==`` of UFL compares structures."""
    return any(bool(part == F) for part in unique_pre_traversal(psi))


def _missing_dimensions(C: Expr) -> int:
    """Return 3 − d, the part of tr C and tr C² from stretches 1 out of the plane."""
    return 3 - int(C.ufl_shape[0])


def _volume_factor(C: Expr, J: Expr | None) -> Expr:
    """J^{-2/3}, which removes the change of volume from C."""
    if J is None:
        J = ufl.sqrt(ufl.det(C))
    return J ** (-2.0 / 3.0)
