# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Linear problems in blocks, as in dolfinx from 0.10 on, in the order of this package.

The unknowns of ``LinearProblem([[a_uu, a_up], [a_pu, a_pp]], [L_u, L_p])`` may have any order. Here
the torn one comes first, then the condensed fields; the equations of scalars are kept apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import dolfinx
import ufl

from dolfinx_feti.problems.unknowns.block_forms import (
    is_sequence,
    only_entry,
    split_linear,
    without_parts,
    zero_load,
)
from dolfinx_feti.problems.unknowns.torn_unknown import coupling_message, torn_first
from dolfinx_feti.scalars.derivatives import with_trial
from dolfinx_feti.scalars.equations import ScalarEquation
from dolfinx_feti.scalars.real_spaces import constant_of, unit_values


@dataclass(frozen=True, slots=True)
class LinearBlocks:
    """A linear problem with one unknown to be torn, fields to be condensed, and scalars.

    Attributes:
        a: Bilinear form of u, or blocks in u and the fields.
        L: Linear form of u, or its blocks.
        u: The unknown that is torn; None if it is to be created.
        fields: Condensed fields.
        equations: Equations of the scalars.
        unknowns: All unknowns in the user's order, if :meth:`LinearProblem.solve` returns a list;
            else empty.
    """

    a: Any
    L: Any
    u: dolfinx.fem.Function | None
    fields: tuple[dolfinx.fem.Function, ...]
    equations: tuple[ScalarEquation, ...] = ()
    unknowns: tuple[dolfinx.fem.Function, ...] = ()


def arrange_linear(
    a: ufl.Form | Sequence[Sequence[ufl.Form | None]],
    L: ufl.Form | Sequence[ufl.Form | None],
    u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function] | None,
    condense: Sequence[dolfinx.fem.Function],
) -> LinearBlocks:
    """Return a :class:`LinearProblem` with unknowns and blocks in the order of this package.

    Args:
        a: A bilinear form, on a ``ufl.MixedFunctionSpace`` or not, or its blocks.
        L: A linear form or its blocks.
        u: The unknown, a sequence of unknowns, or None to create them.
        condense: Further fields to be condensed.

    Raises:
        ValueError: The blocks do not fit each other, or cannot be torn together.
    """
    # u and condense are in the order of this package already; ``forms`` checks the blocks
    if condense and (u is None or isinstance(u, dolfinx.fem.Function)):
        return LinearBlocks(a, L, u, tuple(condense))
    n = _number_of_unknowns(a, u, condense)
    if n == 1:
        has_list = is_sequence(u) or is_sequence(L)
        return _arrange_one(only_entry(a), only_entry(L), only_entry(u), has_list=has_list)
    rows, loads = _checked_blocks(a, L, n)
    if is_sequence(u):
        unknowns = [*u, *condense]
    else:
        unknowns = [dolfinx.fem.Function(_test_space(rows, loads, i)) for i in range(n)]

    order = torn_first(unknowns, "a", [rows, loads])
    torn = unknowns[order[0]]
    fields = tuple(unknowns[i] for i in order[1:])

    equations = _equations(rows, loads, unknowns, order)
    blocks = [[rows[i][j] for j in order] for i in order]
    block_loads = [loads[i] for i in order]
    if block_loads[0] is None:
        block_loads[0] = zero_load(torn.function_space)
    return LinearBlocks(
        a=blocks if fields else blocks[0][0],
        L=block_loads if fields else block_loads[0],
        u=torn,
        fields=fields,
        equations=equations,
        unknowns=tuple(unknowns),
    )


def _number_of_unknowns(a: object, u: object, condense: Sequence[dolfinx.fem.Function]) -> int:
    """Return the number of unknowns, by those that are given, or by the blocks or parts of a."""
    if is_sequence(u):
        return len(u) + len(condense)
    if is_sequence(a):
        return len(a)
    arguments = a.arguments() if isinstance(a, ufl.Form) else ()
    return 1 + max((v.part() or 0 for v in arguments), default=0)


def _arrange_one(a: Any, L: Any, u: Any, *, has_list: bool) -> LinearBlocks:
    """Return a problem of one unknown, whose solution is in a list if u or L was one."""
    is_linear_form = isinstance(L, ufl.Form) and bool(L.arguments())
    if not has_list or not is_linear_form:  # ``forms`` refuses another L
        return LinearBlocks(a, L, u, ())
    if u is None:
        u = dolfinx.fem.Function(L.arguments()[0].ufl_function_space())
    return LinearBlocks(a, L, u, (), unknowns=(u,))


def _checked_blocks(
    a: Any, L: Any, n: int
) -> tuple[list[list[ufl.Form | None]], list[ufl.Form | None]]:
    """Return n × n blocks of a and n of L, with arguments that have no part number.

    Raises:
        ValueError: There are other numbers of blocks, or one is no form.
    """
    rows, loads = split_linear(a, L, n)
    is_square = len(rows) == n and all(len(row) == n for row in rows)
    has_zero_row = any(row == [None] * n for row in rows)
    if not is_square or has_zero_row or len(loads) != n:
        raise ValueError(
            f"There are {n} unknowns: give a as {n} × {n} blocks, with None for zero, and L as {n} "
            "blocks, or both as forms on a ufl.MixedFunctionSpace."
        )
    for row in (*rows, loads):
        for form in row:
            if form is not None and not isinstance(form, ufl.Form):
                raise ValueError(f"a or L holds {form!r}: give forms of UFL, or None for zero.")
    return [without_parts(row) for row in rows], without_parts(loads)


def _test_space(
    rows: Sequence[Sequence[ufl.Form | None]], loads: Sequence[ufl.Form | None], i: int
) -> dolfinx.fem.FunctionSpace:
    """Return the space in which row i is tested.

    Raises:
        ValueError: The row is zero.
    """
    for form in (loads[i], *rows[i]):
        if form is not None:
            return form.arguments()[0].ufl_function_space()
    raise ValueError(f"Row {i} of a and L is zero: leave that unknown out.")


def _equations(
    rows: Sequence[Sequence[ufl.Form | None]],
    loads: Sequence[ufl.Form | None],
    unknowns: Sequence[dolfinx.fem.Function],
    order: Sequence[int],
) -> tuple[ScalarEquation, ...]:
    """Return the equations of the scalars, the unknowns on real spaces, of a linear problem.

    Args:
        rows: Blocks of a.
        loads: Blocks of L.
        unknowns: All unknowns.
        order: Numbers of the torn one and of the condensed fields.

    Raises:
        ValueError: A condensed field and a scalar occur in one block.
    """
    # by the numbers of the unknowns: the Constants of the scalars; all that their equations contain
    scalars = {i: constant_of(w) for i, w in enumerate(unknowns) if i not in order}
    known = {order[0]: unknowns[order[0]], **scalars}
    equations = []
    for i, constant in scalars.items():
        for p in order[1:]:
            if rows[i][p] is not None or rows[p][i] is not None:
                raise ValueError(coupling_message("a", unknowns[p], unknowns[i]))
        row = [with_trial(rows[i][j], f) for j, f in known.items() if rows[i][j] is not None]
        load = loads[i]
        if load is not None:
            row.append(-load)
        c = tuple(_tested(row, test) for test in unit_values(constant.ufl_shape))  # c_k(u, s)
        coupling = rows[order[0]][i]
        work = None if coupling is None else with_trial(coupling, constant)
        equations.append(ScalarEquation(constant, c, work, mirror=unknowns[i]))
    return tuple(equations)


def _tested(row: Sequence[ufl.Form], test: Any) -> ufl.Form:
    """Return the sum of linear forms with a value in place of their test function."""
    parts = [ufl.replace(form, {form.arguments()[0]: test}) for form in row]
    return sum(parts, ufl.Form([]))
