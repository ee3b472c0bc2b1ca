# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The forms of a tangent in u and condensed fields p, derived from residuals or from the user.

.. math:: \begin{pmatrix} K_{uu} & K_{up} \\ K_{pu} & K_{pp} \end{pmatrix}, \qquad
          K_{up} = ∂F_u/∂p, \quad K_{pu} = ∂F_p/∂u, \quad K_{pp} = ∂F_p/∂p

with a row and a column of blocks for each field. K_uu is not among the blocks of this file: it is
assembled on the torn space, as the tangent of a problem without condensed fields.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.fem.split_form import first_component

Function = dolfinx.fem.Function

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class BlockForm:
    """A block of the tangent, or a part of a residual, as a form.

    Attributes:
        form: The form. A zero block has a form with all arguments of the block, too, so that it can
            be assembled.
        is_zero: Whether the form is zero after UFL's simplifications. A form whose values cancel
            only numerically is not.
    """

    form: ufl.Form
    is_zero: bool

    def depends_on(self, f: Function) -> bool:
        """Return True if a function is among the coefficients."""
        return f in _expanded(self.form).coefficients()


@dataclass(frozen=True, slots=True)
class MixedTangent:
    """The blocks with condensed fields, in the order of the fields.

    Attributes:
        K_up: ∂F_u/∂p of each field, (fields,).
        K_pu: ∂F_p/∂u of each field, (fields,).
        K_pp: ∂F_p/∂p, a row for each residual and a column for each field, (fields, fields).
    """

    K_up: tuple[BlockForm, ...]
    K_pu: tuple[BlockForm, ...]
    K_pp: tuple[tuple[BlockForm, ...], ...]

    def forms(self) -> list[ufl.Form]:
        """Return the forms of all blocks: K_up, K_pu, and K_pp row by row."""
        blocks = [*self.K_up, *self.K_pu]
        for row in self.K_pp:
            blocks += row
        return [block.form for block in blocks]

    def split(self, values: Sequence[T]) -> tuple[list[T], list[T], list[list[T]]]:
        """Return values of all blocks, in the order of :meth:`forms`, by block.

        Returns:
            Those of K_up, (fields,), of K_pu, (fields,), and of K_pp, (fields, fields).
        """
        n = len(self.K_up)
        of_fields = values[2 * n :]
        rows = [list(of_fields[i * n : (i + 1) * n]) for i in range(n)]
        return list(values[:n]), list(values[n : 2 * n]), rows

    def is_constant_in_fields(self, fields: Sequence[Function]) -> bool:
        """Return True if K_pp depends on none of the fields: their equations are linear in them."""
        for row in self.K_pp:
            for block in row:
                if any(block.depends_on(p) for p in fields):
                    return False
        return True


def derive_tangent(
    F_u: ufl.Form, F_p: Sequence[ufl.Form], u: Function, fields: Sequence[Function]
) -> MixedTangent:
    """Return the derivatives of residuals.

    Args:
        F_u: Residual tested with v.
        F_p: Residual of each field.
        u: The unknown.
        fields: The condensed fields.
    """
    du = ufl.TrialFunction(u.function_space)

    def in_fields(F: ufl.Form) -> tuple[BlockForm, ...]:
        trials = [ufl.TrialFunction(p.function_space) for p in fields]
        pairs = zip(fields, trials, strict=True)
        return tuple(_derived_block(F, p, dp) for p, dp in pairs)

    K_pu = tuple(_derived_block(F, u, du) for F in F_p)
    return MixedTangent(in_fields(F_u), K_pu, tuple(in_fields(F) for F in F_p))


def tangent_of_user(
    blocks: Sequence[Sequence[ufl.Form | None]], u: Function, fields: Sequence[Function]
) -> MixedTangent:
    """Return the blocks with condensed fields of a user's tangent.

    Args:
        blocks: Rows of blocks in u and the fields, (1 + fields, 1 + fields); None for zero.
        u: The unknown.
        fields: The condensed fields.
    """
    spaces = [u.function_space, *(p.function_space for p in fields)]
    rows: list[tuple[BlockForm, ...]] = []
    for row_of_user, test_space in zip(blocks, spaces, strict=True):
        pairs = zip(row_of_user, spaces, strict=True)
        rows.append(tuple(block_of_user(form, test_space, space) for form, space in pairs))
    row_of_u = rows[0]
    rows_of_fields = rows[1:]
    return MixedTangent(
        K_up=row_of_u[1:],  # without K_uu
        K_pu=tuple(row[0] for row in rows_of_fields),
        K_pp=tuple(row[1:] for row in rows_of_fields),
    )


def block_of_user(form: ufl.Form | None, *spaces: dolfinx.fem.FunctionSpace) -> BlockForm:
    """Return a form that the user gave as a block; a zero block if it is None or empty.

    Args:
        form: The form.
        spaces: Spaces of its arguments.
    """
    if form is None or form.empty():
        return BlockForm(_zero_form(*spaces), True)
    return BlockForm(form, _is_zero(form))


def check_blocks(
    tangent: MixedTangent, residuals: Sequence[ufl.Form], fields: Sequence[Function]
) -> None:
    """Check that residuals and tangent can determine the fields.

    K_up and K_pu are tested over all fields together: a dilation θ in Ψ(θ) + p (J − θ) acts on p
    alone, so that its own blocks with u are zero.

    Args:
        tangent: The blocks.
        residuals: Residuals of u and of each field.
        fields: The condensed fields.

    Raises:
        ValueError: A field is in no residual, all blocks with u are zero, or the row of a field in
            K_pp is.
    """
    for p in fields:
        if not any(p in _expanded(F).coefficients() for F in residuals):
            raise ValueError(
                f"condense is '{p.name}', which does not occur in the energy (or in the "
                "residuals): pass the pressure of a mixed energy Π(u, p)."
            )
    names = ", ".join(f"'{p.name}'" for p in fields)
    for name, blocks in (("K_up", tangent.K_up), ("K_pu", tangent.K_pu)):
        if all(block.is_zero for block in blocks):
            raise ValueError(
                f"condense is {names}, but {name} is zero: condensation needs an energy with "
                "a term in both u and p, such as p (J − 1)."
            )
    for p, row in zip(fields, tangent.K_pp, strict=True):
        if all(block.is_zero for block in row):
            raise ValueError(
                f"condense is {names}, but K_pp of '{p.name}' is zero: condensation needs an "
                "energy with a term in p², such as −p²/(2κ) in p (J − 1) − p²/(2κ)."
            )


def _derived_block(F: ufl.Form, f: Function, df: ufl.Argument) -> BlockForm:
    """Return the derivative of a residual in the direction df of a function."""
    form = ufl.derivative(F, f, df)
    return BlockForm(form, _is_zero(form))


def _zero_form(*spaces: dolfinx.fem.FunctionSpace) -> ufl.Form:
    """Return a form that is zero, with arguments in these spaces; UFL does not simplify it."""
    integrand = dolfinx.fem.Constant(spaces[0].mesh, np.float64(0.0))
    for number, space in enumerate(spaces):
        integrand = integrand * first_component(ufl.Argument(space, number))
    return integrand * ufl.dx(metadata={"quadrature_degree": 0})


def _is_zero(form: ufl.Form) -> bool:
    """Return True if UFL finds that a form is zero."""
    return bool(_expanded(form).empty())


def _expanded(form: ufl.Form) -> ufl.Form:
    """Return a form with its derivatives evaluated."""
    return ufl.algorithms.expand_derivatives(form)
