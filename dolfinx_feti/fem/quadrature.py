# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Quadrature degrees: UFL's estimates, bounds on them, and one rule for energy and residual.

UFL adds up degrees through an exponential or a determinant; for the Holzapfel–Gasser–Ogden energy
on quadratic elements its estimate makes the compiled code a thousand times slower than necessary.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

import basix
import dolfinx
import ufl

from dolfinx_feti.runtime.arrays import Array

__all__ = [
    "estimated_quadrature_degree",
    "limit_quadrature_degree",
    "match_quadrature_degree",
    "quadrature_points",
    "quadrature_rule",
    "same_points",
]

#: Under type and part of the domain of integrals, their degree.
Degrees = dict[tuple[str, object], int]


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
        elements = [f.ufl_element() for f in (*form.arguments(), *form.coefficients())]
        degree = 2 * max((e.embedded_superdegree or 0 for e in elements), default=1)
    if degree < 0:
        raise ValueError(f"degree = {degree}: give a quadrature degree of zero or more.")
    return ufl.Form([_limit(integral, degree) for integral in form.integrals()])


def estimated_quadrature_degree(form: ufl.Form) -> int:
    """Return the highest degree that UFL estimates for integrals that state none; 0 for none."""
    estimated = [i for i in form.integrals() if _stated(i.metadata()) < 0]
    return max(_degrees(ufl.Form(estimated)).values(), default=0)


def match_quadrature_degree(energy: ufl.Form, residual: ufl.Form) -> ufl.Form:
    """Give the integrals of an energy that state no degree that of its residual.

    UFL estimates a higher degree for a derivative. Integrated by two rules, an energy would fall in
    a direction that is not quite that of the residual, and near the solution not at all.

    Args:
        energy: Π(u).
        residual: Its derivative, and perhaps other terms.
    """
    kinds = {i.integral_type() for i in energy.integrals() if not _states(i.metadata())}
    known = _degrees(ufl.Form([i for i in residual.integrals() if i.integral_type() in kinds]))
    return ufl.Form([_match(integral, known) for integral in energy.integrals()])


def _match(integral: ufl.Integral, known: Degrees) -> ufl.Integral:
    """The integral with the degree that is known for its type and part of the domain."""
    parts = integral.subdomain_id()
    kind, parts = integral.integral_type(), parts if isinstance(parts, tuple) else (parts,)
    found = [known[kind, part] for part in parts if (kind, part) in known]
    if _states(integral.metadata()) or not found:
        return integral
    return _with_degree(integral, max(found))


def _degrees(form: ufl.Form) -> Degrees:
    """Find the degrees of the integrals of a form, as the form compiler does.

    Where some integrals state a degree and others do not, it is UFL's estimate for these.
    """
    if ufl.algorithms.expand_derivatives(form).empty():
        return {}
    data = ufl.algorithms.compute_form_data(
        form, do_apply_integral_scaling=True, do_append_everywhere_integrals=False
    )
    found: Degrees = {}
    for group in data.integral_data:
        known = [integral.metadata() for integral in group.integrals]
        free = [int(np.max(m["estimated_polynomial_degree"])) for m in known if _stated(m) < 0]
        for part in group.subdomain_id:
            key = (group.integral_type, "everywhere" if part == "otherwise" else part)
            found[key] = max(free or map(_stated, known))
    return found


def _stated(metadata: Mapping[str, Any]) -> int:
    """Return the degree that an integral states; a negative one for none, as in FFCx."""
    return int(metadata.get("quadrature_degree", -1))


def _states(metadata: Mapping[str, Any]) -> bool:
    """Return whether an integral states its quadrature."""
    return "quadrature_rule" in metadata or _stated(metadata) >= 0


def _with_degree(integral: ufl.Integral, degree: int) -> ufl.Integral:
    return integral.reconstruct(metadata={**integral.metadata(), "quadrature_degree": degree})


def _limit(integral: ufl.Integral, degree: int) -> ufl.Integral:
    """Return the integral with at most this quadrature degree, unless it states its own."""
    if _states(integral.metadata()):
        return integral
    enough = estimated_quadrature_degree(ufl.Form([integral])) <= degree
    return integral if enough else _with_degree(integral, degree)


def quadrature_points(mesh: dolfinx.mesh.Mesh, degree: int) -> Array:
    """Return the points of the reference cell's quadrature rule, (points, dimension)."""
    cell = getattr(basix.CellType, mesh.topology.cell_name())
    return np.asarray(basix.make_quadrature(cell, degree)[0])


def quadrature_rule(expression: ufl.core.expr.Expr) -> tuple[Array, Array] | None:
    """Return points and weights of the quadrature elements in an expression; None without any.

    Raises:
        ValueError: There are several rules, so that the expression has a value at no point.
    """
    coefficients = ufl.algorithms.extract_coefficients(expression)
    rules = [rule for f in coefficients for rule in _rules(f.ufl_element())]
    for points, _ in rules[1:]:
        if not same_points(points, rules[0][0]):
            raise ValueError(
                f"The expression combines data at {len(rules[0][0])} and at {len(points)} other "
                "quadrature points: give all of them the same quadrature element."
            )
    return rules[0] if rules else None


def same_points(points: npt.ArrayLike, others: npt.ArrayLike) -> bool:
    """Tell whether two sets of points of the reference cell are the same, in the same order."""
    return np.shape(points) == np.shape(others) and np.allclose(points, others, rtol=0, atol=1e-12)


def _rules(element: Any) -> Iterator[tuple[Array, Array]]:
    """Return the rules of an element and of the elements that it is made of."""
    if element.has_custom_quadrature:
        points, weights = element.custom_quadrature()
        yield np.asarray(points), np.asarray(weights)
    else:
        for part in element.sub_elements:
            yield from _rules(part)
