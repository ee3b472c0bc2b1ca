# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Blocks of forms: splitting of forms on mixed spaces, and removal of part numbers.

A form on a ``ufl.MixedFunctionSpace`` has arguments with part numbers; block (i, j) is its part
with the test function of space i and the trial function of space j.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeGuard

import numpy as np

import dolfinx
import ufl
from ufl import classes


def is_sequence(argument: object) -> TypeGuard[Sequence[Any]]:
    """Return True for a list, a tuple and other sequences, but not for text or a vector in UFL."""
    return isinstance(argument, Sequence) and not isinstance(argument, str)


def is_rows(argument: object) -> TypeGuard[Sequence[Sequence[Any]]]:
    """Return True for a sequence of sequences, such as the blocks of a bilinear form."""
    return is_sequence(argument) and all(is_sequence(row) for row in argument)


def only_entry(argument: Any) -> Any:
    """Return the entry of a list of one, or of rows of one; other arguments as they are."""
    while is_sequence(argument) and len(argument) == 1:
        argument = argument[0]
    return argument


def none_if_zero(form: Any) -> Any:
    """Return None for a ``ufl.ZeroBaseForm``, by which dolfinx's demos state zero blocks."""
    return None if isinstance(form, ufl.ZeroBaseForm) else form


def block(form: ufl.Form, *parts: int | None) -> ufl.Form | None:
    """Return a block of a form on a ``ufl.MixedFunctionSpace``; None if it is zero.

    Args:
        form: The form.
        *parts: Number of the space of the test function, and of the trial function; None for any.

    Returns:
        The block, with arguments that have no part number.
    """
    replaced = {}
    for v in form.arguments():
        part = parts[v.number()]
        if part is None or part == (v.part() or 0):
            replaced[v] = ufl.Argument(v.ufl_function_space(), v.number())
        else:
            replaced[v] = classes.Zero(v.ufl_shape)
    of_parts = ufl.algorithms.expand_derivatives(ufl.replace(form, replaced))
    return None if of_parts.empty() else of_parts


def without_part(form: ufl.Form | None) -> ufl.Form | None:
    """Return a block whose arguments have no part number; None if it is zero."""
    return None if form is None else block(form, None, None)


def without_parts(row: Sequence[ufl.Form | None]) -> list[ufl.Form | None]:
    """Return blocks whose arguments have no part number, with None for zero."""
    return [without_part(form) for form in row]


def split_linear(a: Any, L: Any, n: int) -> tuple[list[list[Any]], list[Any]]:
    """Return the blocks of a and L, which may be forms on a ``ufl.MixedFunctionSpace``.

    Args:
        a: Bilinear form, or its blocks.
        L: Linear form, or its blocks.
        n: Number of unknowns.

    Returns:
        Rows of blocks of a, and blocks of L, with None for zero; empty lists for arguments that are
        neither a form nor blocks. Their numbers and types are not checked.
    """
    if isinstance(a, ufl.Form):
        a = [[block(a, i, j) for j in range(n)] for i in range(n)]
    if isinstance(L, ufl.Form):
        L = [block(L, i) for i in range(n)]
    rows = []
    if is_rows(a):
        rows = [list(map(none_if_zero, row)) for row in a]
    loads = []
    if is_sequence(L):
        loads = list(map(none_if_zero, L))
    return rows, loads


def zero_load(V: dolfinx.fem.FunctionSpace) -> ufl.Form:
    """Return a linear form in V that is zero, which UFL does not simplify."""
    v = ufl.TestFunction(V)
    zero = dolfinx.fem.Constant(V.mesh, np.zeros(v.ufl_shape))
    return ufl.inner(zero, v) * ufl.dx(metadata={"quadrature_degree": 0})
