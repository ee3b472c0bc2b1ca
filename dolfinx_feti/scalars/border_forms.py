# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The compiled derivatives of residual and equations, from which a border is assembled."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.fem.assembly import assemble_owned
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.scalars.border import Border
from dolfinx_feti.scalars.derivatives import column_in, corner_row_in, row_of
from dolfinx_feti.scalars.equations import ScalarEquation

__all__ = ["BorderForms"]


class BorderForms:
    """The forms of B, C and D for m scalars, at least one.

    B and D are derivatives in a direction Δs, a Constant of the forms. With Δs the j-th unit
    vector, they are the j-th columns.
    """

    def __init__(
        self,
        equations: Sequence[ScalarEquation],
        components: Sequence[Sequence[ufl.Form]],
        u: dolfinx.fem.Function,
        residual: ufl.Form,
        compiler: Compiler,
    ) -> None:
        """Derive and compile the forms. Collective.

        Args:
            equations: The equations of all scalars.
            components: c_k of each equation, with their quadrature degrees.
            u: The unknown field.
            residual: r(u, s; v), with the work of the scalars.
            compiler: Compiler of forms.
        """
        self._comm: MPI.Comm = compiler.comm
        m = sum(len(forms) for forms in components)
        self._direction = dolfinx.fem.Constant(u.function_space.mesh, np.zeros(m))
        directions = _split_direction(self._direction, equations)
        B = column_in(residual, equations, directions)
        rows: list[ufl.Form] = []
        corner_rows: list[ufl.Form] = []
        for equation, forms in zip(equations, components, strict=True):
            for k, c_k in enumerate(forms):
                rows.append(row_of(equation, k, c_k, u))
                corner_rows.append(corner_row_in(equation, k, c_k, directions))
        self._B = _compile_unless_zero(B, compiler)
        self._C = [_compile_unless_zero(row, compiler) for row in rows]
        self._D = [_compile_unless_zero(row, compiler) for row in corner_rows]

    def assemble(self, owned: int) -> Border:
        """Assemble B, C and D at the present state. Collective.

        Args:
            owned: Number N of dofs that this process owns.
        """
        m = len(self._C)
        border = Border.zero(owned, m)
        D = np.zeros((m, m))  # the part of this process
        for j, unit in enumerate(np.eye(m)):
            self._direction.value = unit
            if self._B is not None:
                border.B[:, j] = assemble_owned(self._B)
            for i, corner_row in enumerate(self._D):
                if corner_row is not None:
                    D[i, j] = dolfinx.fem.assemble_scalar(corner_row)
        border.D[:] = total_of(D, self._comm)
        for k, row in enumerate(self._C):
            if row is not None:
                border.C[:, k] = assemble_owned(row)
        return border


def _split_direction(
    direction: dolfinx.fem.Constant, equations: Sequence[ScalarEquation]
) -> dict[dolfinx.fem.Constant, Expr]:
    """Return, by the constant of each unknown, its part of a direction Δs, in its shape.

    If two equations share an unknown, its direction is the sum of both parts. Both columns of B are
    then equal, and the check of independence raises an error.

    Args:
        direction: Δs, (m,).
        equations: The equations of all scalars.
    """
    ds = iter(direction)
    directions: dict[dolfinx.fem.Constant, Expr] = {}
    for equation in equations:
        part = [next(ds) for _ in equation.equations]
        s = equation.unknown
        shaped = ufl.as_vector(part) if s.ufl_shape else part[0]
        directions[s] = directions[s] + shaped if s in directions else shaped
    return directions


def _compile_unless_zero(form: ufl.Form, compiler: Compiler) -> dolfinx.fem.Form | None:
    """Return a compiled form; None if it vanishes. Collective."""
    is_zero = ufl.algorithms.expand_derivatives(form).empty()
    return None if is_zero else compiler.form(form)
