# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Nonlinear problems in blocks, as in dolfinx from 0.10 on, in the order of this package.

The unknowns of ``NonlinearProblem([F_u, F_p, F_s], [u, p, s])`` may have any order. Here the torn
one comes first, then the condensed fields; the equations of scalars are kept apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.problems.unknowns.block_forms import (
    block,
    is_sequence,
    none_if_zero,
    only_entry,
    without_part,
)
from dolfinx_feti.problems.unknowns.torn_unknown import coupling_message, torn_first
from dolfinx_feti.scalars.derivatives import with_trial
from dolfinx_feti.scalars.equations import ScalarEquation, ScalarTangent
from dolfinx_feti.scalars.real_spaces import separate_scalars, unit_values


@dataclass(frozen=True, slots=True)
class NonlinearBlocks:
    """A nonlinear problem with one unknown to be torn, fields to be condensed, and scalars.

    Attributes:
        F: An energy or a residual of u; or residuals of u and the fields, in this order.
        u: The unknown that is torn.
        fields: Condensed fields.
        J: Tangent of F in u, or its blocks in u and the fields; None if it is to be derived.
        equations: Equations of the scalars.
    """

    F: ufl.Form | list[ufl.Form]
    u: dolfinx.fem.Function
    fields: tuple[dolfinx.fem.Function, ...]
    J: ufl.Form | list[list[ufl.Form | None]] | None
    equations: tuple[ScalarEquation, ...]


def arrange_nonlinear(
    F: ufl.Form | Sequence[ufl.Form],
    u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function],
    J: ufl.Form | Sequence[Sequence[ufl.Form | None]] | None,
    condense: Sequence[dolfinx.fem.Function],
) -> NonlinearBlocks:
    """Return a :class:`NonlinearProblem` with unknowns and forms in the order of this package.

    Args:
        F: An energy or a residual, or residuals in the order of u, followed by ``condense``.
        u: The unknown, or a sequence of unknowns.
        J: The tangent, its blocks in the order of u and ``condense``, or None.
        condense: Further fields to be condensed.

    Raises:
        ValueError: The fields cannot be torn together, or F or J do not fit them.
    """
    if not is_sequence(u) or len(u) == 1:
        return _arrange_one(F, only_entry(u), J, condense)
    unknowns = [*u, *condense]
    if any(w is other for i, w in enumerate(unknowns) for other in unknowns[:i]):
        raise ValueError("u holds a Function twice: give each unknown once.")
    energy_or_residuals = _split_residuals(F, len(unknowns))

    order = torn_first(unknowns, "u", [energy_or_residuals, J])
    fields = tuple(unknowns[i] for i in order[1:])

    tangent = None if J is None else tangent_blocks(J, unknowns)
    equations: tuple[ScalarEquation, ...] = ()
    if len(order) < len(unknowns):
        energy_or_residuals, constants, separate = separate_scalars(energy_or_residuals, unknowns)
        equations = tuple(separate)
        if tangent is not None:
            tangent = [[_with_constants(form, constants) for form in row] for row in tangent]
            equations = _with_tangents(equations, tangent, unknowns, order)

    arranged_F = energy_or_residuals
    if is_sequence(energy_or_residuals):
        by_number = _residuals_by_number(energy_or_residuals, sorted(order), unknowns)
        residuals = [by_number[i] for i in order]
        arranged_F = residuals if fields else residuals[0]
    arranged_J: Any = None
    if tangent is not None:
        blocks = [[tangent[i][j] for j in order] for i in order]
        arranged_J = blocks if fields else blocks[0][0]
    return NonlinearBlocks(arranged_F, unknowns[order[0]], fields, arranged_J, equations)


def _arrange_one(
    F: Any, u: Any, J: Any, condense: Sequence[dolfinx.fem.Function]
) -> NonlinearBlocks:
    """Return a problem of one unknown, and of the fields in ``condense`` if there are any."""
    J = only_entry(J)
    if not condense:
        return NonlinearBlocks(only_entry(F), u, (), J, ())
    if is_sequence(J):
        J = tangent_blocks(J, [u, *condense])
    return NonlinearBlocks(F, u, tuple(condense), J, ())


def _split_residuals(F: ufl.Form | Sequence[ufl.Form], n: int) -> Any:
    """Return an energy as it is, and n residuals, also of a form on a ``ufl.MixedFunctionSpace``.

    Raises:
        ValueError: One is no form with a test function.
    """
    if isinstance(F, ufl.Form) and F.arguments():
        F = [block(F, i) for i in range(n)]
    if is_sequence(F):
        return [_residual(F, i) for i in range(len(F))]
    return F


def _residuals_by_number(
    residuals: Sequence[ufl.Form], numbers: Sequence[int], unknowns: Sequence[dolfinx.fem.Function]
) -> dict[int, ufl.Form]:
    """Return the residual of each unknown that is no scalar, by its number.

    Args:
        residuals: Residuals of these unknowns, in their order.
        numbers: Their numbers.
        unknowns: All unknowns.

    Raises:
        ValueError: There are other numbers of residuals, or one is tested in another space.
    """
    if len(residuals) != len(numbers):
        raise ValueError(
            f"F has {len(residuals)} residuals for {len(numbers)} unknowns: give one for each of "
            "them, in their order."
        )
    by_number = dict(zip(numbers, residuals, strict=True))
    for i, form in by_number.items():
        w = unknowns[i]
        if form.arguments()[0].ufl_function_space() != w.function_space:
            raise ValueError(
                f"The residual of '{w.name}' is tested in another space: give the residuals in the "
                "order of the unknowns, each tested in the space of its unknown."
            )
    return by_number


def _with_tangents(
    equations: Sequence[ScalarEquation],
    J: Sequence[Sequence[ufl.Form | None]],
    unknowns: Sequence[dolfinx.fem.Function],
    order: Sequence[int],
) -> tuple[ScalarEquation, ...]:
    """Return the equations of the scalars with their blocks of J.

    Args:
        equations: Equations of the scalars, each with its Function on a real space.
        J: Blocks of the tangent in all unknowns.
        unknowns: All unknowns.
        order: Numbers of the torn one and of the condensed fields.

    Raises:
        ValueError: J couples a condensed field and a scalar.
    """
    torn = order[0]
    v = ufl.TestFunction(unknowns[torn].function_space)
    scalar_numbers = [_number_of(equation.mirror, unknowns) for equation in equations]
    complete = []
    for i, equation in zip(scalar_numbers, equations, strict=True):
        for p in order[1:]:
            if J[i][p] is not None or J[p][i] is not None:
                raise ValueError(coupling_message("J", unknowns[p], unknowns[i]))
        tests = unit_values(equation.unknown.ufl_shape)
        row = [
            None if form is None else with_trial(form, v) for form in _by_test(J[i][torn], tests)
        ]
        blocks = {
            other.unknown: _by_test(J[i][j], tests)
            for j, other in zip(scalar_numbers, equations, strict=True)
        }
        tangent = ScalarTangent(J[torn][i], tuple(row), blocks)
        complete.append(replace(equation, tangent=tangent))
    return tuple(complete)


def _number_of(w: object, unknowns: Sequence[dolfinx.fem.Function]) -> int:
    """Return the number of an unknown."""
    return next(i for i, other in enumerate(unknowns) if other is w)


def _by_test(form: ufl.Form | None, tests: Sequence[Expr]) -> tuple[ufl.Form | None, ...]:
    """Return a bilinear form with each of some values in place of its test function."""
    if form is None:
        return (None,) * len(tests)
    test = next(v for v in form.arguments() if v.number() == 0)
    return tuple(ufl.replace(form, {test: value}) for value in tests)


def _with_constants(
    form: ufl.Form | None, constants: dict[dolfinx.fem.Function, dolfinx.fem.Constant]
) -> ufl.Form | None:
    """Return a form with Constants in place of scalars on real spaces; None for None."""
    return None if form is None else ufl.replace(form, constants)


def tangent_blocks(
    J: ufl.Form | Sequence[Sequence[ufl.Form | None]], unknowns: Sequence[dolfinx.fem.Function]
) -> list[list[ufl.Form | None]]:
    """Return the blocks of a tangent, with arguments that have no part number; None for zero.

    Raises:
        ValueError: J has another number of blocks, or one has other arguments.
    """
    n = len(unknowns)
    if isinstance(J, ufl.Form):
        rows: list[Any] = [[block(J, i, j) for j in range(n)] for i in range(n)]
    else:
        rows = list(J)
    if len(rows) != n or not all(is_sequence(row) and len(row) == n for row in rows):
        names = ", ".join(f"'{w.name}'" for w in unknowns)
        raise ValueError(
            f"J is no {n} × {n} block: give a row for each residual with a form, or None for zero, "
            f"for each of the unknowns {names}, or leave J out, which is derived then."
        )
    blocks = []
    for i, row in enumerate(rows):
        blocks.append([_tangent_block(form, unknowns, i, j) for j, form in enumerate(row)])
    return blocks


def _tangent_block(
    form: Any, unknowns: Sequence[dolfinx.fem.Function], i: int, j: int
) -> ufl.Form | None:
    """Return block (i, j) of a tangent, checked, with arguments that have no part number.

    Raises:
        ValueError: It is no form, or has other arguments.
    """
    form = none_if_zero(form)
    if form is None:
        return None
    if not isinstance(form, ufl.Form):
        raise ValueError(f"J[{i}][{j}] is {form!r}: give a form of UFL, or None for zero.")
    form = without_part(form)
    if form is None:
        return None
    spaces = [v.ufl_function_space() for v in form.arguments()]
    if spaces != [unknowns[i].function_space, unknowns[j].function_space]:
        raise ValueError(
            f"J[{i}][{j}] has test and trial functions on other spaces than "
            f"'{unknowns[i].name}' and '{unknowns[j].name}': row i is tested in the "
            "space of unknown i, column j has the trial function of unknown j."
        )
    return form


def _residual(F: Sequence[Any], i: int) -> ufl.Form:
    """Return residual i with a test function that has no part number.

    Raises:
        ValueError: It is no form with a test function.
    """
    form = F[i]
    if not isinstance(form, ufl.Form) or len(form.arguments()) != 1:
        raise ValueError(f"F[{i}] is {form!r}: give a residual, a form with a test function.")
    (v,) = form.arguments()
    if v.part() is None:
        return form
    return ufl.replace(form, {v: ufl.Argument(v.ufl_function_space(), v.number())})
