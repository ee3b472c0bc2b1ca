# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Quadrature degrees: UFL's estimates, bounds on them, and one rule for energy and residual.

UFL adds up degrees through an exponential or a determinant. For the Holzapfel–Gasser–Ogden energy
on quadratic elements, its estimate makes the compiled code a thousand times slower than necessary.

A degree is *explicit* if it is in the metadata of an integral; otherwise UFL estimates it, which
takes long for large forms:

==================================  ==================================================
``limit_quadrature_degree``         makes estimates above a bound explicit, at the bound
``match_quadrature_degree``         gives an energy the degrees of its residual
``quadrature_degrees``              the degrees of several forms, which UFL analyses
``set_quadrature_degrees``          makes these degrees explicit
``highest_estimate``                the highest of these degrees that is not explicit in a form
``estimated_quadrature_degree``     the highest estimate in one form, which UFL analyses
==================================  ==================================================

``quadrature_points``, ``quadrature_rule`` and ``same_points`` are about the points of rules.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

import basix
import dolfinx
import ufl

from dolfinx_feti.runtime.arrays import Array

#: Degree of the integrals over each domain: UFL's type of integral and the number of the
#: subdomain, such as ("cell", 3) for dx(3) and ("cell", "everywhere") for dx.
Degrees = Mapping[tuple[str, object], int]

#: Data at quadrature points are compared with basix's default rules up to this degree. Rules of a
#: higher degree have more than a thousand points in a tetrahedron.
MAX_RULE_DEGREE = 20

#: Points of the reference cell, of size 1, are the same up to this distance: a rounding margin.
POINT_ATOL = 1e-12


def limit_quadrature_degree(form: ufl.Form, degree: int | None = None) -> ufl.Form:
    """Lower the quadrature degree of integrals whose estimated degree is too high.

    Integrals with an explicit degree, and those that need no more than ``degree``, do not change.
    Derivatives of the result inherit its degrees. Therefore limit an energy or a residual before
    differentiating it: the tangent is then the derivative of the residual as it is integrated.

    Args:
        form: Form of any rank.
        degree: Highest degree. By default twice the highest degree among the form's arguments and
            coefficients, 2 for P1 and 4 for P2 displacements: the product of two functions of this
            degree, as in a mass matrix, is integrated exactly.

    Returns:
        The form, in which the integrals with a lower degree than UFL's estimate have an explicit
        one.

    Raises:
        ValueError: The degree is negative.
    """
    if degree is None:
        elements = ufl.algorithms.extract_elements(form)
        degree = 2 * max((e.embedded_superdegree or 0 for e in elements), default=1)
    if degree < 0:
        raise ValueError(f"degree = {degree}: give a quadrature degree of zero or more.")

    def limited(integral: ufl.Integral) -> ufl.Integral:
        if estimated_quadrature_degree(ufl.Form([integral])) <= degree:
            return integral
        return _with_degree(integral, degree)

    return ufl.Form(list(map(limited, form.integrals())))


def estimated_quadrature_degree(form: ufl.Form) -> int:
    """Return the highest degree that UFL estimates for integrals without an explicit one, or 0.

    UFL analyses the form, which takes long for large ones; :func:`highest_estimate` does not.
    """
    estimated = [integral for integral in form.integrals() if not _has_rule(integral)]
    return max(_degrees(ufl.Form(estimated)).values(), default=0)


def match_quadrature_degree(energy: ufl.Form, residual: ufl.Form) -> ufl.Form:
    """Return an energy Π(u) that is integrated by the rules of its residual.

    UFL estimates a higher degree for a derivative. With two rules, the residual would not be the
    derivative of the energy as it is integrated, and near the solution a line search would fail.

    Args:
        energy: Energy; its explicit degrees stay.
        residual: Its residual, the derivative of the energy.
    """
    types = {i.integral_type() for i in energy.integrals() if not _has_rule(i)}
    of_these_types = [i for i in residual.integrals() if i.integral_type() in types]
    degree_of_part = _degrees(ufl.Form(of_these_types))

    def matched(integral: ufl.Integral) -> ufl.Integral:
        degrees = [degree_of_part[key] for key in _domains(integral) if key in degree_of_part]
        if _has_rule(integral) or not degrees:
            return integral
        return _with_degree(integral, max(degrees))

    return ufl.Form(list(map(matched, energy.integrals())))


def quadrature_degrees(*forms: ufl.Form) -> Degrees:
    """Return the highest degree of the integrals over each domain in several forms."""
    degrees: dict[tuple[str, object], int] = {}
    for form in forms:
        for key, degree in _degrees(form).items():
            degrees[key] = max(degree, degrees.get(key, degree))
    return degrees


def highest_estimate(degrees: Degrees, *forms: ufl.Form) -> int:
    """Return the highest degree that UFL estimated for integrals of forms, 0 without any.

    Integrals with an explicit degree do not count. UFL does not analyse the forms again: the
    estimates are looked up.

    Args:
        degrees: Degrees by domain, from :func:`quadrature_degrees` of these forms.
        forms: The forms.
    """
    highest = 0
    for form in forms:
        for integral in form.integrals():
            if not _has_rule(integral):
                of_parts = [degrees.get(key, 0) for key in _domains(integral)]
                highest = max(highest, *of_parts)
    return highest


def set_quadrature_degrees(form: ufl.Form, degrees: Degrees) -> ufl.Form:
    """Return a form whose integrals have explicit degrees, which its derivatives inherit.

    For a derivative, UFL would estimate another degree, and the derivative would not belong to the
    form as it is integrated. The derivative of a positive part, for example, has an estimate that
    is lower by two.

    Args:
        form: Form of any rank. Explicit degrees stay.
        degrees: Degrees by domain, see :func:`quadrature_degrees`. An integral over several numbers
            of subdomains becomes one for each degree. Domains without a degree do not change.
    """
    integrals = []
    for integral in form.integrals():
        domains_of_degree: dict[int | None, list[tuple[str, object]]] = {}
        for domain in _domains(integral):
            domains_of_degree.setdefault(degrees.get(domain), []).append(domain)
        if _has_rule(integral) or set(domains_of_degree) == {None}:
            integrals.append(integral)
            continue
        if len(domains_of_degree) == 1:  # the usual case: the integral stays one
            (degree,) = domains_of_degree
            assert degree is not None
            integrals.append(_with_degree(integral, degree))
            continue
        for degree in sorted(domains_of_degree, key=_none_first):
            numbers = tuple(number for _, number in domains_of_degree[degree])
            part = integral.reconstruct(subdomain_id=numbers)
            integrals.append(part if degree is None else _with_degree(part, degree))
    return ufl.Form(integrals)


def quadrature_points(mesh: dolfinx.mesh.Mesh, degree: int) -> Array:
    """Return the points of the reference cell's quadrature rule, (points, dimension)."""
    return np.asarray(basix.make_quadrature(mesh.basix_cell(), degree)[0])


def quadrature_rule(expression: ufl.core.expr.Expr) -> tuple[Array, Array] | None:
    """Return points and weights of the quadrature elements in an expression; None without any.

    Raises:
        ValueError: There are several rules: the expression has no value at any point.
    """
    elements = ufl.algorithms.extract_elements(expression)
    parts = ufl.algorithms.analysis.extract_sub_elements(elements)
    rules = [e.custom_quadrature() for e in parts if e.has_custom_quadrature]
    for points, _ in rules[1:]:
        if not same_points(points, rules[0][0]):
            raise ValueError(
                f"The expression combines data at {len(rules[0][0])} and at {len(points)} other "
                "quadrature points: give all of them the same quadrature element."
            )
    return rules[0] if rules else None


def same_points(points: npt.ArrayLike, others: npt.ArrayLike) -> bool:
    """Return True if two sets of points of the reference cell agree, in the same order.

    Args:
        points: (points, dimension).
        others: (points, dimension), or of another shape.
    """
    if np.shape(points) != np.shape(others):
        return False
    return bool(np.allclose(points, others, rtol=0, atol=POINT_ATOL))


def _none_first(degree: int | None) -> int:
    """Return a key that sorts degrees, None before all others."""
    return -1 if degree is None else degree


def _degrees(form: ufl.Form) -> dict[tuple[str, object], int]:
    """Return the degree of the integrals over each domain, as FFCx chooses it.

    If some integrals over a domain have an explicit degree and others do not, the result is UFL's
    estimate for the others. UFL analyses only these. An integral with a quadrature rule of another
    name and without a degree counts as degree 0.
    """
    degrees: dict[tuple[str, object], int] = {}
    without_degree = []
    for integral in form.integrals():
        if not _has_rule(integral):
            without_degree.append(integral)
            continue
        for domain in _domains(integral):
            explicit = _explicit_degree(integral.metadata())
            degrees[domain] = max(degrees.get(domain, 0), explicit)
    estimated = ufl.Form(without_degree)
    if ufl.algorithms.expand_derivatives(estimated).empty():
        return degrees
    data = ufl.algorithms.compute_form_data(
        estimated, do_apply_integral_scaling=True, do_append_everywhere_integrals=False
    )
    for group in data.integral_data:
        degree = max(map(_estimated_degree, group.integrals))
        for number in group.subdomain_id:
            # UFL calls a measure without a number "otherwise" in its form data
            key = (group.integral_type, "everywhere" if number == "otherwise" else number)
            degrees[key] = degree
    return degrees


def _domains(integral: ufl.Integral) -> list[tuple[str, object]]:
    """Return the type of an integral with each of its numbers of subdomains."""
    numbers = integral.subdomain_id()
    if not isinstance(numbers, tuple):
        numbers = (numbers,)
    return [(integral.integral_type(), number) for number in numbers]


def _estimated_degree(integral: ufl.Integral) -> int:
    """Return the degree of an analysed integral without an explicit one.

    It is UFL's estimate, or the degree of data at quadrature points: FFCx uses their points.
    """
    if integral.integral_type() == "cell":
        elements = ufl.algorithms.extract_elements(integral)
        parts = ufl.algorithms.analysis.extract_sub_elements(elements)
        for element in parts:
            if element.has_custom_quadrature:
                points, _ = element.custom_quadrature()
                degree = _degree_of_rule(element.cell_type, points)
                if degree is not None:
                    return degree
    return int(np.max(integral.metadata()["estimated_polynomial_degree"]))


def _degree_of_rule(cell: basix.CellType, points: Array) -> int | None:
    """Return the smallest degree of basix's default rule with these points; None without any."""
    for degree in range(MAX_RULE_DEGREE + 1):
        rule = basix.make_quadrature(cell, degree)[0]
        if same_points(rule, points):
            return degree
    return None


def _explicit_degree(metadata: dict[str, Any]) -> int:
    """Return the explicit degree of an integral, from its metadata; negative without any."""
    return int(metadata.get("quadrature_degree", -1))


def _has_rule(integral: ufl.Integral) -> bool:
    """Return True if an integral has an explicit degree or quadrature rule."""
    return "quadrature_rule" in integral.metadata() or _explicit_degree(integral.metadata()) >= 0


def _with_degree(integral: ufl.Integral, degree: int) -> ufl.Integral:
    """Return an integral with an explicit degree."""
    return integral.reconstruct(metadata={**integral.metadata(), "quadrature_degree": degree})
