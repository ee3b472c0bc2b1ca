# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Bounded quadrature degrees.

UFL adds up degrees through an exponential or a determinant; for the Holzapfel–Gasser–Ogden energy
on quadratic elements its estimate makes the compiled code a thousand times slower than necessary.
"""

from __future__ import annotations

import ufl

__all__ = ["limit_quadrature_degree"]


def limit_quadrature_degree(form: ufl.Form, degree: int | None = None) -> ufl.Form:
    """Lower the quadrature degree of integrals whose estimated degree is too high.

    Integrals with an explicit degree, and those that need no more than ``degree``, stay as they
    are. The derivatives of the result inherit its degrees: limit an energy or a residual before
    differentiating it, and the tangent is that of the residual as it is integrated.

    Args:
        form: Form of any rank.
        degree: Highest degree; by default twice the highest degree among the form's arguments and
            coefficients: 2 for P1 and 4 for P2 displacements.

    Raises:
        ValueError: If ``degree`` is negative.
    """
    if degree is None:
        functions = (*form.arguments(), *form.coefficients())
        degree = 2 * max((_polynomial_degree(f) for f in functions), default=1)
    if degree < 0:
        raise ValueError(f"degree = {degree}: give a quadrature degree of zero or more.")
    return ufl.Form([_limit(integral, degree) for integral in form.integrals()])


def _limit(integral: ufl.Integral, degree: int) -> ufl.Integral:
    """Return the integral with at most this quadrature degree, unless it states its own."""
    metadata = integral.metadata()
    if {"quadrature_degree", "quadrature_rule"} & metadata.keys():
        return integral
    expanded = ufl.algorithms.expand_derivatives(ufl.Form([integral]))
    if expanded.empty() or _estimated_degree(expanded) <= degree:
        return integral
    return integral.reconstruct(metadata={**metadata, "quadrature_degree": degree})


def _estimated_degree(form: ufl.Form) -> int:
    """Return the degree that UFL estimates; tensor-product cells have one per direction."""
    estimate = ufl.algorithms.estimate_total_polynomial_degree(form)
    return max(estimate) if isinstance(estimate, tuple) else estimate


def _polynomial_degree(function: ufl.Argument | ufl.Coefficient) -> int:
    """Return the degree of a function's element; zero for quadrature elements."""
    return function.ufl_element().embedded_superdegree or 0
