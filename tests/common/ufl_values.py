# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Numbers from UFL: expressions of constants without a mesh, forms with one."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl
from ufl.core.expr import Expr


def value(expression: Expr) -> npt.NDArray[np.float64]:
    """Value of an expression without coefficients, of any shape; no compiler is involved."""
    shape = expression.ufl_shape
    entries = [expression[i](()) if i else expression(()) for i in np.ndindex(*shape)]
    return np.array(entries, dtype=np.float64).reshape(shape)


def variable(matrix: npt.ArrayLike) -> ufl.variable.Variable:
    """A matrix of numbers as a variable that can be differentiated by."""
    return ufl.variable(ufl.as_matrix(np.asarray(matrix, dtype=np.float64).tolist()))


def scalar(form: ufl.Form, *functions: dolfinx.fem.Function) -> float:
    """Value of a form on all processes, its arguments replaced by functions, the last one first."""
    comm: MPI.Comm = form.ufl_domain().ufl_cargo().comm
    for function in functions:
        form = ufl.action(form, function)
    return comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(form)))
