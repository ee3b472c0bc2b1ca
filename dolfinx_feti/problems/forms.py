# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The forms of a problem: residuals, tangent and energy from what the user gives.

A linear problem is one Newton step from zero:

.. math:: \begin{pmatrix} A & A_{up} \\ A_{pu} & A_{pp} \end{pmatrix}
          \begin{pmatrix} u \\ p \end{pmatrix} = \begin{pmatrix} L \\ L_p \end{pmatrix}

is :math:`r(0) + r'(0)\, (u, p) = 0` with :math:`r_u = A_{up}\, p - L` (A u is zero there) and
:math:`r_p = A_{pu}\, u + A_{pp}\, p - L_p`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import dolfinx
import ufl
from ufl import classes
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_feti.fem.checks import check_condensed, check_forms
from dolfinx_feti.fem.quadrature import (
    estimated_quadrature_degree,
    limit_quadrature_degree,
    match_quadrature_degree,
)
from dolfinx_feti.problems.arguments import checked_conditions, require_forms
from dolfinx_feti.runtime.collective import warn

#: How often twice the polynomial degree an estimated quadrature degree may be without a warning.
EXPLOSIVE = 3

_ABSENT = "The unknown '{0}' does not occur in F: pass the Function that F is written in."


@dataclass(frozen=True, slots=True)
class Forms:
    """The forms of a problem."""

    u: dolfinx.fem.Function  # the unknown; a zero one of a linear problem
    F_u: ufl.Form  # residual tested with v
    J: ufl.Form  # tangent of F_u in u
    condense: tuple[tuple[ufl.Form, dolfinx.fem.Function], ...] = ()  # residual, field
    energy: ufl.Form | None = None  # their potential, if there is one
    symmetric: bool | None = None  # is J the second derivative of an energy? None if nobody knows
    volume_ratio: Expr | None = None  # what is positive at the points of a quadrature of a degree
    degree: int = 0

    @property
    def residuals(self) -> list[ufl.Form]:
        """All of them: that of u and those of the fields."""
        return [self.F_u, *(F_p for F_p, _ in self.condense)]


def condensed_fields(
    condense: dolfinx.fem.Function | Sequence[dolfinx.fem.Function] | None,
) -> tuple[dolfinx.fem.Function, ...]:
    """Return the fields to be condensed: none, one, or several."""
    if condense is None:
        return ()
    return tuple(condense) if isinstance(condense, Sequence) else (condense,)


def derive(
    F: ufl.Form | Sequence[ufl.Form],
    u: dolfinx.fem.Function,
    *,
    J: ufl.Form | None,
    condense: Sequence[dolfinx.fem.Function],
    energy: ufl.Form | None,
    degree: int | None,
    work: Sequence[ufl.Form] = (),
) -> Forms:
    """Derive and check the forms of a :class:`NonlinearProblem`, whose arguments these are.

    ``degree`` is the highest of integrals that state none; None for no bound. ``work`` is what
    scalar unknowns add to the residual of u; an energy is no potential then.

    Raises:
        ValueError: The forms do not fit each other, or the unknowns.
        TypeError: A field cannot be condensed.
    """

    def limited(form: ufl.Form) -> ufl.Form:
        return form if degree is None else limit_quadrature_degree(form, degree)

    for form in F if isinstance(F, Sequence) else [F]:
        require_forms(F=form)
    given = {"J": J, "energy": energy}
    require_forms(**{name: form for name, form in given.items() if form is not None})
    check_condensed(condense, u)
    symmetric = None
    if isinstance(F, ufl.Form) and not F.arguments():
        if energy is not None and not F.equals(energy):
            raise ValueError(
                "energy is not F, which is an energy itself and the one that is minimised: leave "
                "energy out, or give the residuals as F."
            )
        energy, symmetric = F, True if J is None else None
    F_u, *F_p = _residuals(F, u, condense)
    if work:
        added = sum(work, ufl.Form([]))
        J = J if J is None else J + ufl.derivative(added, u, ufl.TrialFunction(u.function_space))
        F_u, energy, symmetric = F_u + added, None, None
    F_u = limited(F_u)
    J = ufl.derivative(F_u, u, ufl.TrialFunction(u.function_space)) if J is None else J
    check_forms(u.function_space, F=(F_u, 1), J=(J, 2))
    if u not in F_u.coefficients():
        raise ValueError(_ABSENT.format(u.name))
    if energy is not None:
        energy = match_quadrature_degree(limited(energy), F_u)
    fields = tuple(zip(map(limited, F_p), condense, strict=True))
    twice = 2 * u.function_space.ufl_element().embedded_superdegree
    estimate = 0 if degree is not None else max(map(estimated_quadrature_degree, (F_u, *F_p)))
    if estimate > EXPLOSIVE * twice:
        warn(
            f"UFL estimates a quadrature degree of {estimate} for F, which is slow to compile and "
            f"to assemble: give quadrature_degree={twice}, twice the polynomial degree, or state a "
            "degree in the measures.",
            u.function_space.mesh.comm,
        )
    return Forms(u, F_u, limited(J), fields, energy, symmetric)


def _residuals(
    F: ufl.Form | Sequence[ufl.Form],
    u: dolfinx.fem.Function,
    condense: Sequence[dolfinx.fem.Function],
) -> list[ufl.Form]:
    """Return the residuals tested with v and, for each condensed field, with its q."""
    if not isinstance(F, ufl.Form):
        forms = list(F)
        wanted = [u.function_space, *(p.function_space for p in condense)]
        if not condense or len(forms) != len(wanted) or any(len(f.arguments()) != 1 for f in forms):
            raise ValueError(
                f"F is a sequence of {len(forms)} forms: give a residual tested with v and one for "
                "each condensed field, tested with its q, together with condense=p."
            )
        if [form.arguments()[0].ufl_function_space() for form in forms] != wanted:
            raise ValueError("F holds residuals on other spaces: test them with v in V and q in Q.")
        return forms
    rank = len(F.arguments())
    if rank == 0 and u not in F.coefficients():
        raise ValueError(_ABSENT.format(u.name))
    if rank > 1 or (rank == 1 and condense):
        raise ValueError(
            f"F has {rank} arguments: give a residual or an energy; with condense=p an energy "
            "Π(u, p) or the pair of its residuals."
        )
    if rank == 1:
        return [F]
    return [ufl.derivative(F, f, ufl.TestFunction(f.function_space)) for f in (u, *condense)]


def default_volume_ratio(forms: Forms) -> Expr | None:
    """Return det(I + Grad u) of a displacement, None for another unknown."""
    u = forms.u
    gdim = u.function_space.mesh.geometry.dim
    if u.ufl_shape != (gdim,):
        return None
    given = [form for form in (forms.F_u, forms.energy) if form is not None]
    integrands = [integral.integrand() for form in given for integral in form.integrals()]
    if not any(_is_kinematic(o, u) for i in integrands for o in unique_pre_traversal(i)):
        return None
    return ufl.det(ufl.Identity(gdim) + ufl.grad(u))


def _is_kinematic(o: Expr, u: dolfinx.fem.Function) -> bool:
    """Tell whether an expression is one of a displacement alone; a diffusion has none of them.

    These are I + Grad u, its determinant and inverse, and Grad uᵀ Grad u, of Green's strain.
    """
    match o:
        case classes.Determinant() | classes.Inverse() | classes.Cofactor():
            kinematic = True
        case classes.Sum():
            kinematic = any(isinstance(term, classes.Identity) for term in _terms(o))
        case classes.Dot() | classes.Product():
            A, B = (
                f.ufl_operands[0] if isinstance(f, classes.Indexed) else f for f in o.ufl_operands
            )
            kinematic = any(
                isinstance(C, classes.Transposed) and C.ufl_operands[0] == D
                for C, D in ((A, B), (B, A))
            )
        case _:
            return False
    gradients = (part for part in unique_pre_traversal(o) if isinstance(part, classes.Grad))
    return kinematic and any(u in extract_coefficients(gradient) for gradient in gradients)


def _terms(o: Expr) -> Iterator[Expr]:
    """Yield the terms of a sum of sums."""
    for term in o.ufl_operands:
        if isinstance(term, classes.Sum):
            yield from _terms(term)
        else:
            yield term


def linear_forms(
    a: ufl.Form | Sequence[Sequence[ufl.Form | None]],
    L: ufl.Form | Sequence[ufl.Form | None],
    u: dolfinx.fem.Function | None,
    fields: Sequence[dolfinx.fem.Function],
) -> tuple[Forms, ufl.Form]:
    """Return the checked forms of a :class:`LinearProblem` as residuals at zero, and that of L.

    Raises:
        ValueError: The forms do not fit each other, u, or the fields.
        TypeError: A field cannot be condensed.
    """
    if not fields:
        require_forms(a=a, L=L)
    rows, right = _blocks(a, L, len(fields) + 1)
    a_uu, L_u = rows[0][0], right[0]
    require_forms(a=a_uu, L=L_u)
    of_arguments = (v.ufl_function_space() for form in (a_uu, L_u) for v in form.arguments())
    V: Any = next(of_arguments, None) if u is None else u.function_space
    check_forms(V, a=(a_uu, 2), L=(L_u, 1))
    checked_conditions(V, None)
    zero = dolfinx.fem.Function(V)
    check_condensed(fields, zero)
    state = [zero, *(dolfinx.fem.Function(p.function_space) for p in fields)]
    for i, (row, f) in enumerate(zip(rows, state, strict=True)):
        for j, (form, g) in enumerate(zip(row, state, strict=True)):
            if form is None:
                continue
            require_forms(**{f"a[{i}][{j}]": form})
            spaces = [v.ufl_function_space() for v in form.arguments()]
            if spaces != [f.function_space, g.function_space]:
                raise ValueError(
                    f"a[{i}][{j}] has test and trial functions on other spaces: test row i in the "
                    "space of unknown i, which are u and the fields of condense, in their order."
                )
    residuals = []
    for i, row in enumerate(rows):
        known = [(form, f) for form, f in zip(row, state, strict=True) if i or f is not zero]
        r = sum((ufl.action(form, f) for form, f in known if form), ufl.Form([]))
        residuals.append(r - right[i] if right[i] else r)
    fields_at_zero = tuple(zip(residuals[1:], state[1:], strict=True))
    return Forms(zero, residuals[0], rows[0][0], fields_at_zero), right[0]


def _blocks(a: Any, L: Any, n: int) -> tuple[list[list[Any]], list[Any]]:
    """Return the n × n blocks of a and the n of L, with arguments that know no other block."""
    if n == 1:
        return [[a]], [L]
    if isinstance(a, ufl.Form):
        a = [[_block(a, i, j) for j in range(n)] for i in range(n)]
    if isinstance(L, ufl.Form):
        L = [_block(L, i) for i in range(n)]
    rows = list(a) if isinstance(a, Sequence) else []
    fits = len(rows) == n and all(isinstance(row, Sequence) and len(row) == n for row in rows)
    if not fits or not isinstance(L, Sequence) or len(L) != n or not rows[0][0] or not L[0]:
        raise ValueError(
            f"condense has {n - 1} field(s): give a as {n} × {n} blocks, such as "
            f"[[a_uu, a_up], [a_pu, a_pp]], and L as {n} blocks, or both as forms on a "
            "ufl.MixedFunctionSpace of V and the spaces of the fields."
        )
    whole = [[form and _block(form, None, None) for form in row] for row in [*rows, L]]
    return whole[:n], whole[n]


def _block(form: ufl.Form, *parts: int | None) -> ufl.Form | None:
    """Return the block of parts of the test and the trial function; None if it is zero.

    Its arguments are of their own spaces; a part None is any.
    """
    replaced = {}
    for v in form.arguments():
        same = parts[v.number()] in (v.part() or 0, None)
        V, zero = v.ufl_function_space(), classes.Zero(v.ufl_shape)
        replaced[v] = ufl.Argument(V, v.number()) if same else zero
    block = ufl.algorithms.expand_derivatives(ufl.replace(form, replaced))
    return None if block.empty() else block
