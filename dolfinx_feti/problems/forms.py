# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The forms of a problem: residuals, tangent and energy from the user's forms.

A linear problem is one Newton step from zero:

.. math:: \begin{pmatrix} A & A_{up} \\ A_{pu} & A_{pp} \end{pmatrix}
          \begin{pmatrix} u \\ p \end{pmatrix} = \begin{pmatrix} L \\ L_p \end{pmatrix}

is :math:`r(0) + r'(0)\, (u, p) = 0` with :math:`r_u = A u + A_{up}\, p - L` and
:math:`r_p = A_{pu}\, u + A_{pp}\, p - L_p`. At zero all products vanish. The product A u is left
out, so that it need not be compiled. The others stay in the forms, because A_up, A_pu and A_pp are
derived from them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import dolfinx
import ufl
from ufl import classes
from ufl.algorithms import extract_coefficients
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_feti.contact.contact import Contact
from dolfinx_feti.fem.quadrature import (
    highest_estimate,
    limit_quadrature_degree,
    match_quadrature_degree,
    quadrature_degrees,
    set_quadrature_degrees,
)
from dolfinx_feti.fem.user_forms.checks import (
    check_condensed,
    check_forms,
    check_meshes,
    check_trial_functions,
)
from dolfinx_feti.fem.user_forms.deformation import VolumeRatio, find_volume_ratio
from dolfinx_feti.problems.arguments import require_form, require_torn_space
from dolfinx_feti.problems.unknowns.block_forms import split_linear, without_parts, zero_load
from dolfinx_feti.problems.unknowns.compression import Compression, potential_of, with_compression
from dolfinx_feti.problems.unknowns.mixed_of_one import MixedOfOne
from dolfinx_feti.runtime.collective import warn

#: Blocks of a bilinear form; None is a zero block.
Blocks = Sequence[Sequence[ufl.Form | None]]

#: An estimated quadrature degree above this multiple of twice the polynomial degree is logged. In
#: 3D three times the degree takes 3³ times as many points. It is a choice, not measured.
EXCESSIVE_DEGREE = 3

#: UFL's functions with a kink, as they are written.
KINKS = {
    classes.Abs: "abs",
    classes.MinValue: "min_value",
    classes.MaxValue: "max_value",
    classes.Conditional: "conditional",
}

_ABSENT = (
    "The unknown '{0}' does not occur in F: pass the Function that F is written in. If F holds a "
    "stress that is computed outside of UFL, pass its tangent, too, by J=, and what updates the "
    "stress by before_assembly=."
)

_CONSTANT = (
    "The unknown '{0}' does not occur in F, so that the residual stays the same from step to step: "
    "pass before_assembly=update, a function that updates what F holds from the present '{0}'."
)


class FieldEquation(NamedTuple):
    """The equation of a condensed field."""

    residual: ufl.Form  # tested with q
    field: dolfinx.fem.Function


@dataclass(frozen=True, slots=True)
class Forms:
    """The forms of a problem, on one unknown that is torn and fields that are condensed.

    :func:`derive` and :func:`linear_forms` set what follows from the user's forms. The problem
    classes add ``volume_ratio`` with its degree, ``mixed`` and ``scalar_forms`` in a copy.

    Attributes:
        u: The unknown that is torn; in a linear problem, a Function that stays zero.
        F_u: Residual tested with v.
        J: Tangent of F_u in u.
        blocks: Blocks of the tangent in u and the fields, (1 + fields, 1 + fields), of which None
            is a zero block; None if the blocks are to be derived.
        field_equations: Residual and Function of each condensed field.
        energy: Potential of all residuals; None if there is none.
        symmetric: Whether J is the second derivative of an energy; None if unknown.
        has_given_tangent: Whether J is the user's own.
        volume_ratio: det F, positive in admissible states; None if the forms contain no F.
        volume_ratio_degree: Degree of the quadrature at whose points the volume ratio is evaluated;
            without effect if there is none.
        contacts: Contacts; F_u, J and the energy contain their integrals.
        mixed: The user's unknown, if that has a mixed element of one; else None.
        compression: Terms added to the equations of incompressible fields; None without any.
        scalar_forms: Function and residual whose derivatives couple scalars to u, if these are not
            u and F_u. In a linear problem, whose u is zero, they are the solution and the terms of
            the scalars.
    """

    u: dolfinx.fem.Function
    F_u: ufl.Form
    J: ufl.Form
    blocks: Blocks | None = None
    field_equations: tuple[FieldEquation, ...] = ()
    energy: ufl.Form | None = None
    symmetric: bool | None = None
    has_given_tangent: bool = False
    volume_ratio: VolumeRatio | None = None
    volume_ratio_degree: int = 0
    contacts: tuple[Contact, ...] = ()
    mixed: MixedOfOne | None = None
    compression: Compression | None = None
    scalar_forms: tuple[dolfinx.fem.Function, ufl.Form] | None = None

    @property
    def kinks(self) -> tuple[str, ...]:
        """The functions of UFL in the residuals with a kink in u or in a condensed field.

        Those of contacts are left out: whole steps cross them (``line_search.WholeStep``).
        """
        unknowns = {self.u, *(equation.field for equation in self.field_equations)}
        multipliers = {contact.multiplier for contact in self.contacts}
        names = set()
        for form in self.residuals:
            for integral in form.integrals():
                integrand = integral.integrand()
                if not multipliers.isdisjoint(extract_coefficients(integrand)):
                    continue
                for node in unique_pre_traversal(integrand):
                    if type(node) not in KINKS:
                        continue
                    if not unknowns.isdisjoint(extract_coefficients(node)):
                        names.add(KINKS[type(node)])
        return tuple(sorted(names))

    @property
    def residuals(self) -> list[ufl.Form]:
        """The residual of u and those of the fields."""
        return [self.F_u, *(equation.residual for equation in self.field_equations)]


def condensed_fields(
    condense: dolfinx.fem.Function | Sequence[dolfinx.fem.Function] | None,
) -> tuple[dolfinx.fem.Function, ...]:
    """Return the argument ``condense`` as a tuple of fields."""
    if condense is None:
        return ()
    return tuple(condense) if isinstance(condense, Sequence) else (condense,)


def derive(
    F: ufl.Form | Sequence[ufl.Form],
    u: dolfinx.fem.Function,
    *,
    J: ufl.Form | Blocks | None,
    condense: Sequence[dolfinx.fem.Function],
    energy: ufl.Form | None,
    degree: int | None,
    work: Sequence[ufl.Form] = (),
    updates_coefficients: bool = False,
    contacts: Sequence[Contact] = (),
) -> Forms:
    """Derive and check the forms of a :class:`NonlinearProblem`, whose arguments these are.

    The order matters: degrees are stated before anything is derived; terms of scalars are added
    before the tangent is derived, which contains them; contacts are added last, as their forms
    state degrees and come with a tangent.

    Args:
        F: An energy, a residual, or residuals.
        u: The unknown that is torn.
        J: Tangent, or its blocks in u and ``condense``.
        condense: Condensed fields.
        energy: Potential of the residuals.
        degree: Highest quadrature degree of integrals whose measure states none; None for no bound.
        work: Terms that scalar unknowns add to the residual of u. The result then has no potential:
            the solution is a saddle point, and its potential does not fall from step to step.
        updates_coefficients: Whether coefficients change with the state: then F may lack u, and an
            energy that is given as F is not a potential, because its derivative ignores them.
        contacts: Contacts, whose integrals state their degree.

    Raises:
        ValueError: The forms do not fit each other, or the unknowns.
        TypeError: A field cannot be condensed.
    """
    V = u.function_space
    trial = ufl.TrialFunction(V)
    J_u, blocks = _split_tangent(J, condense)
    _check_given(F, J_u, energy, u, condense)
    is_energy = isinstance(F, ufl.Form) and not F.arguments()
    potential = energy
    if is_energy and not updates_coefficients:
        potential = F
    has_given_tangent = J_u is not None

    # quadrature: UFL estimates degrees anew for derivatives, and would integrate another function.
    # So the degrees of the residuals are stated in all forms before anything is derived.
    F_u, *F_p = [_limited(form, degree) for form in _residuals(F, u, condense)]
    F_scalars = _limited(sum(work, ufl.Form([])), degree)
    degrees = quadrature_degrees(F_u + F_scalars, *F_p)
    if degree is None:
        _warn_of_degree(highest_estimate(degrees, F_u + F_scalars, *F_p), V)

    def with_degrees(form: ufl.Form) -> ufl.Form:
        return set_quadrature_degrees(_limited(form, degree), degrees)

    F_u = with_degrees(F_u)
    F_scalars = with_degrees(F_scalars)
    F_p = [with_degrees(form) for form in F_p]
    if J_u is not None:  # as a rule UFL's derivative of F, with other degrees
        J_u = with_degrees(J_u)
    if blocks is not None:
        blocks = [_map_forms(with_degrees, row) for row in blocks]

    # terms of incompressible fields
    F_p, blocks, compression = with_compression(u, condense, F_u, F_p, blocks)
    if potential is not None and compression is not None:
        potential += potential_of(compression, condense)

    # terms of scalars
    if work:
        if J_u is not None:
            J_u = J_u + ufl.derivative(F_scalars, u, trial)
        F_u = F_u + F_scalars
        potential = None

    # tangent
    if J_u is None:
        J_u = ufl.derivative(F_u, u, trial)
    check_forms(V, F=(F_u, 1), J=(J_u, 2))
    _check_contains(F_u, u, has_tangent=has_given_tangent, updates=updates_coefficients)
    if potential is not None:
        potential = match_quadrature_degree(_limited(potential, degree), F_u)

    # contacts
    for contact in contacts:
        F_u += contact.law.virtual_work
        J_u += contact.law.tangent
        if potential is not None:
            potential += contact.law.energy

    is_second_derivative = is_energy and not has_given_tangent and not work
    return Forms(
        u=u,
        F_u=F_u,
        J=J_u,
        blocks=blocks,
        field_equations=tuple(map(FieldEquation, F_p, condense)),
        energy=potential,
        symmetric=True if is_second_derivative else None,
        has_given_tangent=has_given_tangent,
        contacts=tuple(contacts),
        compression=compression,
    )


def _map_forms(
    change: Callable[[ufl.Form], ufl.Form], row: Sequence[ufl.Form | None]
) -> list[ufl.Form | None]:
    """Return a row of blocks with a change of each form; zero blocks stay None."""
    return [None if form is None else change(form) for form in row]


def _limited(form: ufl.Form, degree: int | None) -> ufl.Form:
    """Return a form with quadrature degrees up to a bound, if there is one."""
    return form if degree is None else limit_quadrature_degree(form, degree)


def _check_given(
    F: ufl.Form | Sequence[ufl.Form],
    J: ufl.Form | None,
    energy: ufl.Form | None,
    u: dolfinx.fem.Function,
    condense: Sequence[dolfinx.fem.Function],
) -> None:
    """Check the user's forms and fields.

    Raises:
        ValueError: They are not forms on the mesh of u, or the energy is not F although F is one.
        TypeError: A field cannot be condensed.
    """
    forms = list(F) if isinstance(F, Sequence) else [F]
    for form in forms:
        require_form("F", form)
    check_trial_functions(F=F, energy=energy)
    given = {name: form for name, form in (("J", J), ("energy", energy)) if form is not None}
    for name, form in given.items():
        require_form(name, form)
    for form in forms:
        check_meshes(u.function_space, F=form, **given)
    check_condensed(condense, u)
    if not isinstance(F, ufl.Form) or F.arguments() or energy is None:
        return
    if not F.equals(energy):
        raise ValueError(
            "energy is not F, which is an energy itself and the one that is minimised: leave "
            "energy out, or give the residuals as F."
        )


def _check_contains(
    F_u: ufl.Form, u: dolfinx.fem.Function, *, has_tangent: bool, updates: bool
) -> None:
    """Check that u occurs in a residual, or else that its tangent is given.

    Args:
        F_u: The residual.
        u: The unknown.
        has_tangent: Whether the user gives the tangent.
        updates: Whether coefficients are updated with the state; if not, that is logged.

    Raises:
        ValueError: u does not occur, and there is no tangent.
    """
    if u in F_u.coefficients():
        return
    if not has_tangent:
        raise ValueError(_ABSENT.format(u.name))
    if not updates:
        warn(_CONSTANT.format(u.name), u.function_space.mesh.comm)


def _split_tangent(
    J: ufl.Form | Blocks | None, condense: Sequence[dolfinx.fem.Function]
) -> tuple[Any, Blocks | None]:
    """Return the tangent of F_u in u, and the blocks of the tangent in all unknowns.

    Returns:
        J_uu, None if the user gives no tangent, or an object that is not a form, for a later check;
        the blocks, None if J is not given in blocks.

    Raises:
        ValueError: There are blocks, but none of u.
    """
    if not condense or J is None or isinstance(J, ufl.Form) or not isinstance(J, Sequence):
        return J, None
    if J[0][0] is None:
        raise ValueError("J has no block of u, J[0][0]: a tangent that is zero cannot be torn.")
    return J[0][0], J


def _warn_of_degree(estimate: int, V: dolfinx.fem.FunctionSpace) -> None:
    """Log a quadrature degree, estimated by UFL, that costs far more than it is worth."""
    degree = 2 * V.ufl_element().embedded_superdegree
    if estimate > EXCESSIVE_DEGREE * degree:
        warn(
            f"UFL estimates a quadrature degree of {estimate} for F, which is slow to compile and "
            f"to assemble: give quadrature_degree={degree}, twice the polynomial degree, or state "
            "a degree in the measures.",
            V.mesh.comm,
        )


def _residuals(
    F: ufl.Form | Sequence[ufl.Form],
    u: dolfinx.fem.Function,
    condense: Sequence[dolfinx.fem.Function],
) -> list[ufl.Form]:
    """Return the residuals tested with v and, for each condensed field, with its q."""
    if not isinstance(F, ufl.Form):
        forms = list(F)
        spaces = [u.function_space, *(p.function_space for p in condense)]
        are_residuals = all(len(form.arguments()) == 1 for form in forms)
        if not condense or len(forms) != len(spaces) or not are_residuals:
            raise ValueError(
                f"F is a sequence of {len(forms)} forms: give a residual tested with v and one for "
                "each condensed field, tested with its q, together with condense=p."
            )
        if [form.arguments()[0].ufl_function_space() for form in forms] != spaces:
            raise ValueError("F holds residuals on other spaces: test them with v in V and q in Q.")
        return forms
    rank = len(F.arguments())
    if rank == 0 and u not in F.coefficients():
        raise ValueError(_ABSENT.format(u.name))
    if rank > 1 or (rank == 1 and condense):
        raise ValueError(
            f"F has {rank} arguments: give a residual or an energy, written in the Function u and "
            "without a TrialFunction; with condense=p an energy Π(u, p), or the pair of its "
            "residuals."
        )
    if rank == 1:
        return [F]
    return [ufl.derivative(F, f, ufl.TestFunction(f.function_space)) for f in (u, *condense)]


def volume_ratio_of(forms: Forms) -> VolumeRatio | None:
    """Return det F of the deformation gradient in the forms; None if they contain none."""
    candidates = [form for form in (forms.F_u, forms.energy) if form is not None]
    return find_volume_ratio(candidates, forms.u)


def linear_forms(
    a: ufl.Form | Blocks,
    L: ufl.Form | Sequence[ufl.Form | None],
    u: dolfinx.fem.Function | None,
    fields: Sequence[dolfinx.fem.Function],
) -> tuple[Forms, ufl.Form]:
    """Return the checked forms of a :class:`LinearProblem` as residuals at zero.

    Args:
        a: Bilinear form, or blocks in u and the fields.
        L: Linear form, or its blocks.
        u: The unknown; None if the caller creates it.
        fields: Condensed fields.

    Returns:
        The forms, in which new Functions of value zero take the place of u and the fields; and the
        linear form of u.

    Raises:
        ValueError: The forms do not fit each other, u, or the fields.
        TypeError: A field cannot be condensed.
    """
    if not fields:
        require_form("a", a)
        require_form("L", L)
    rows, loads = _blocks(a, L, len(fields) + 1)
    a_uu = rows[0][0]
    L_u = loads[0]
    require_form("a", a_uu)
    require_form("L", L_u)
    V = _space(a_uu, L_u) if u is None else u.function_space
    check_forms(V, a=(a_uu, 2), L=(L_u, 1))
    check_meshes(V, a=a_uu, L=L_u)
    require_torn_space(V)
    zero = dolfinx.fem.Function(V)
    check_condensed(fields, zero)
    zero_fields = [dolfinx.fem.Function(p.function_space) for p in fields]
    state = [zero, *zero_fields]
    _check_blocks(rows, state)
    residuals = []
    for i, (row, load) in enumerate(zip(rows, loads, strict=True)):
        residual = ufl.Form([])
        for j, (form, f) in enumerate(zip(row, state, strict=True)):
            is_product_with_u = (i, j) == (0, 0)  # left out, see the head of the file
            if form is not None and not is_product_with_u:
                residual = residual + ufl.action(form, f)
        if load is not None:
            residual = residual - load
        residuals.append(residual)
    F_p, _, compression = with_compression(zero, zero_fields, residuals[0], residuals[1:], None)
    forms = Forms(
        u=zero,
        F_u=residuals[0],
        J=a_uu,
        field_equations=tuple(map(FieldEquation, F_p, zero_fields)),
        compression=compression,
    )
    return forms, L_u


def _space(*forms: ufl.Form) -> Any:
    """Return the space of the first argument of some forms; None if they have none."""
    for form in forms:
        for v in form.arguments():
            return v.ufl_function_space()
    return None


def _check_blocks(
    rows: Sequence[Sequence[ufl.Form | None]], unknowns: Sequence[dolfinx.fem.Function]
) -> None:
    """Check that block (i, j) is a form with arguments in the spaces of unknowns i and j.

    Raises:
        ValueError: One is not.
        TypeError: One has other numbers than float64.
    """
    for i, (row, f) in enumerate(zip(rows, unknowns, strict=True)):
        for j, (form, g) in enumerate(zip(row, unknowns, strict=True)):
            if form is None:
                continue
            require_form(f"a[{i}][{j}]", form)
            spaces = [v.ufl_function_space() for v in form.arguments()]
            if spaces != [f.function_space, g.function_space]:
                raise ValueError(
                    f"a[{i}][{j}] has test and trial functions on other spaces: test row i in the "
                    "space of unknown i, which are u and the fields of condense, in their order."
                )


def _blocks(a: Any, L: Any, n: int) -> tuple[list[list[Any]], list[Any]]:
    """Return the n × n blocks of a and the n of L, with arguments that have no part number.

    Raises:
        ValueError: a or L has another number of blocks, or a has none of u.
    """
    if n == 1:
        return [[a]], [L]
    rows, loads = split_linear(a, L, n)
    is_square = len(rows) == n and all(len(row) == n for row in rows)
    if not is_square or len(loads) != n:
        raise ValueError(
            f"condense has {n - 1} field(s): give a as {n} × {n} blocks, such as "
            f"[[a_uu, a_up], [a_pu, a_pp]], and L as {n} blocks, or both as forms on a "
            "ufl.MixedFunctionSpace of V and the spaces of the fields."
        )
    rows = [without_parts(row) for row in rows]
    loads = without_parts(loads)
    if rows[0][0] is None:
        raise ValueError("a has no block of u, a[0][0]: a matrix that is zero cannot be torn.")
    if loads[0] is None:
        loads[0] = zero_load(rows[0][0].arguments()[0].ufl_function_space())
    return rows, loads
