# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Derivatives of residual and equations by u and by the scalars, in UFL.

.. math:: B\, Δs = \frac{∂r}{∂s}\, Δs, \qquad C^⊤ = \frac{∂c}{∂u}, \qquad
          D\, Δs = \frac{∂c}{∂s}\, Δs

for a direction Δs: :func:`column_in` returns B Δs, :func:`row_of` a row of :math:`C^⊤`, and
:func:`corner_row_in` a row of D Δs. Each is the user's own
(:class:`~dolfinx_feti.scalars.equations.ScalarTangent`), or derived: the constants of the unknowns
are replaced by UFL variables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.fem.quadrature import quadrature_degrees, set_quadrature_degrees
from dolfinx_feti.scalars.equations import ScalarEquation

__all__ = ["column_in", "corner_row_in", "row_of", "with_trial"]


def _derivative_by_constants(
    form: ufl.Form, parts: Sequence[tuple[dolfinx.fem.Constant, Expr]]
) -> ufl.Form:
    """Return the derivative of a form by constants, in a direction.

    Args:
        form: The form.
        parts: Pairs of a constant and the part of the direction for it, of the same shape.
    """
    if not parts:
        return ufl.Form([])
    s = {unknown: ufl.variable(unknown) for unknown, _ in parts}

    def derivative_of(integrand: Expr) -> Expr:
        """Return the derivative of an integrand."""
        return sum(ufl.inner(ufl.diff(integrand, s[unknown]), ds) for unknown, ds in parts)

    integrals = ufl.replace(form, s).integrals()
    return ufl.Form([i.reconstruct(integrand=derivative_of(i.integrand())) for i in integrals])


def with_trial(form: ufl.Form, value: Expr) -> ufl.Form:
    """Return a form with a value in place of its trial function."""
    trial = next(v for v in form.arguments() if v.number() == 1)
    return ufl.replace(form, {trial: value})


def column_in(
    residual: ufl.Form,
    equations: Sequence[ScalarEquation],
    directions: Mapping[dolfinx.fem.Constant, Expr],
) -> ufl.Form:
    """Return B Δs = ∂r/∂s · Δs, the user's columns or derived ones.

    Args:
        residual: r(u, s; v).
        equations: All equations.
        directions: Δs, by the constant of each unknown.
    """
    degrees = quadrature_degrees(residual)
    derived: list[tuple[dolfinx.fem.Constant, Expr]] = []
    B = ufl.Form([])
    for equation in equations:
        s = equation.unknown
        if equation.tangent is None:
            derived.append((s, directions[s]))
        elif equation.tangent.column is not None:
            column = set_quadrature_degrees(equation.tangent.column, degrees)
            B = B + with_trial(column, directions[s])
    return B + _derivative_by_constants(residual, derived)


def row_of(equation: ScalarEquation, k: int, c_k: ufl.Form, u: dolfinx.fem.Function) -> ufl.Form:
    """Return the k-th row of Cᵀ, ∂c_k/∂u, the user's or derived.

    Args:
        equation: The equation.
        k: Number of its component.
        c_k: The component, with its quadrature degrees.
        u: The unknown field.
    """
    if equation.tangent is None:
        return ufl.derivative(c_k, u)
    row = equation.tangent.rows[k]
    return ufl.Form([]) if row is None else set_quadrature_degrees(row, quadrature_degrees(c_k))


def corner_row_in(
    equation: ScalarEquation, k: int, c_k: ufl.Form, directions: Mapping[dolfinx.fem.Constant, Expr]
) -> ufl.Form:
    """Return the k-th row of D Δs, ∂c_k/∂s · Δs, by the user's blocks or derived.

    Args:
        equation: The equation.
        k: Number of its component.
        c_k: The component, with its quadrature degrees.
        directions: Δs, by the constant of each unknown.
    """
    blocks = {} if equation.tangent is None else equation.tangent.blocks
    degrees = quadrature_degrees(c_k)
    derived: list[tuple[dolfinx.fem.Constant, Expr]] = []
    D = ufl.Form([])
    for s, ds in directions.items():
        if s not in blocks:
            derived.append((s, ds))
            continue
        block = blocks[s][k]
        if block is not None:
            D = D + with_trial(set_quadrature_degrees(block, degrees), ds)
    return D + _derivative_by_constants(c_k, derived)
