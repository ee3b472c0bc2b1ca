# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Quadrature degrees: UFL's estimates, bounds on them, and one rule for energy and residual.

UFL adds up degrees through an exponential or a determinant; for the Holzapfel–Gasser–Ogden energy
on quadratic elements its estimate makes the compiled code a thousand times slower than necessary.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

import basix
import dolfinx
import ufl

from dolfinx_feti.runtime.arrays import Array


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
        elements = ufl.algorithms.extract_elements(form)
        degree = 2 * max((e.embedded_superdegree or 0 for e in elements), default=1)
    if degree < 0:
        raise ValueError(f"degree = {degree}: give a quadrature degree of zero or more.")

    def limited(integral: ufl.Integral) -> ufl.Integral:
        enough = estimated_quadrature_degree(ufl.Form([integral])) <= degree
        return integral if enough else _with_degree(integral, degree)

    return ufl.Form(list(map(limited, form.integrals())))


def estimated_quadrature_degree(form: ufl.Form) -> int:
    """Return the highest degree that UFL estimates for integrals that state none; 0 for none."""
    estimated = [integral for integral in form.integrals() if not _states_rule(integral)]
    return max(_degrees(ufl.Form(estimated)).values(), default=0)


def match_quadrature_degree(energy: ufl.Form, residual: ufl.Form) -> ufl.Form:
    """Give the integrals of an energy Π(u) that state no degree that of its residual.

    UFL estimates a higher degree for a derivative. Integrated by two rules, an energy would fall in
    a direction that is not quite that of the residual, and near the solution not at all.
    """
    kinds = {i.integral_type() for i in energy.integrals() if not _states_rule(i)}
    known = _degrees(ufl.Form([i for i in residual.integrals() if i.integral_type() in kinds]))

    def matched(integral: ufl.Integral) -> ufl.Integral:
        kind, parts = integral.integral_type(), integral.subdomain_id()
        parts = parts if isinstance(parts, tuple) else (parts,)
        found = [known[kind, part] for part in parts if (kind, part) in known]
        if _states_rule(integral) or not found:
            return integral
        return _with_degree(integral, max(found))

    return ufl.Form(list(map(matched, energy.integrals())))


def _degrees(form: ufl.Form) -> dict[tuple[str, object], int]:
    """Find the degrees of the integrals of each type and part of the domain, as FFCx does.

    Where some integrals state a degree and others do not, it is UFL's estimate for these.
    """
    if ufl.algorithms.expand_derivatives(form).empty():
        return {}
    data = ufl.algorithms.compute_form_data(
        form, do_apply_integral_scaling=True, do_append_everywhere_integrals=False
    )
    found = {}
    for group in data.integral_data:
        known = [integral.metadata() for integral in group.integrals]
        free = [int(np.max(m["estimated_polynomial_degree"])) for m in known if _stated(m) < 0]
        for part in group.subdomain_id:
            key = (group.integral_type, "everywhere" if part == "otherwise" else part)
            found[key] = max(free or map(_stated, known))
    return found


def _stated(metadata: dict[str, Any]) -> int:
    """Return the degree that an integral states; a negative one for none, as in FFCx."""
    return int(metadata.get("quadrature_degree", -1))


def _states_rule(integral: ufl.Integral) -> bool:
    """Return whether an integral states its quadrature."""
    return "quadrature_rule" in integral.metadata() or _stated(integral.metadata()) >= 0


def _with_degree(integral: ufl.Integral, degree: int) -> ufl.Integral:
    return integral.reconstruct(metadata={**integral.metadata(), "quadrature_degree": degree})


def quadrature_points(mesh: dolfinx.mesh.Mesh, degree: int) -> Array:
    """Return the points of the reference cell's quadrature rule, (points, dimension)."""
    return np.asarray(basix.make_quadrature(mesh.basix_cell(), degree)[0])


def quadrature_rule(expression: ufl.core.expr.Expr) -> tuple[Array, Array] | None:
    """Return points and weights of the quadrature elements in an expression; None without any.

    Raises:
        ValueError: There are several rules, so that the expression has a value at no point.
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
    """Tell whether two sets of points of the reference cell are the same, in the same order."""
    return np.shape(points) == np.shape(others) and np.allclose(points, others, rtol=0, atol=1e-12)
