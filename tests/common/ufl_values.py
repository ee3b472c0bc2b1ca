# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Numbers from UFL: values of expressions and forms, and tensors of cells that are summed up."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from collective import dense, equal

import dolfinx
import dolfinx.fem.petsc
import ufl
from ufl.core.expr import Expr


def value(expression: Expr) -> npt.NDArray[np.float64]:
    """Return the value of an expression without coefficients, of any shape, without a compiler."""
    shape = expression.ufl_shape
    entries = [expression[i](()) if i else expression(()) for i in np.ndindex(*shape)]
    return np.array(entries, dtype=np.float64).reshape(shape)


def variable(matrix: npt.ArrayLike) -> ufl.variable.Variable:
    """Return a matrix of numbers as a variable, by which expressions can be differentiated."""
    return ufl.variable(ufl.as_matrix(np.asarray(matrix, dtype=np.float64).tolist()))


def scalar(form: ufl.Form, *functions: dolfinx.fem.Function) -> float:
    """Return the value of a form, with functions in place of its arguments, the last one first."""
    comm: MPI.Comm = form.ufl_domain().ufl_cargo().comm
    for function in functions:
        form = ufl.action(form, function)
    return comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(form)))


def displacement(mesh: dolfinx.mesh.Mesh, degree: int) -> dolfinx.fem.Function:
    """Return a small displacement that interpolates a function which is no polynomial."""
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (mesh.geometry.dim,)))
    u = dolfinx.fem.Function(V)
    u.interpolate(lambda x: 0.1 * np.stack([np.sin(x[1]), x[0] * x[1], x[0] ** 2])[: len(u)])
    return u


def require_equal(form: ufl.Form, values: np.ndarray, tolerance: float) -> None:
    """Assert that the tensors of cells add up to dolfinx's tensor, on one process.

    On several processes dolfinx's tensor also has contributions of cells on other processes, and
    nothing is compared.

    Args:
        form: Form of any rank.
        values: Tensor of each owned cell, (cells, dofs, …).
        tolerance: Relative to the largest entry.
    """
    if MPI.COMM_WORLD.size == 1:
        equal(summed(form, values), assembled(form), tolerance)


def assembled(form: ufl.Form) -> np.ndarray:
    """Return dolfinx's scalar, vector or dense matrix of a form."""
    compiled = dolfinx.fem.form(form)
    if len(form.arguments()) == 2:
        matrix = dolfinx.fem.petsc.assemble_matrix(compiled)
        matrix.assemble()
        values = dense(matrix)
        matrix.destroy()
        return values
    if form.arguments():
        return np.asarray(dolfinx.fem.assemble_vector(compiled).array)
    return np.array([dolfinx.fem.assemble_scalar(compiled)])


def summed(form: ufl.Form, values: np.ndarray) -> np.ndarray:
    """Add the tensors of cells, (cells, dofs, …), into a dense array like that of ``assembled``."""
    if not form.arguments():
        return values.sum(keepdims=True)
    sizes = []
    dofs = []
    for argument in form.arguments():
        V = argument.ufl_function_space()
        bs = V.dofmap.index_map_bs
        blocks = V.dofmap.list[: len(values), :, None] * bs + np.arange(bs)
        dofs.append(blocks.reshape(len(values), -1))
        sizes.append((V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts) * bs)
    tensor = np.zeros(sizes)
    entries = dofs[0] if len(dofs) == 1 else (dofs[0][:, :, None], dofs[1][:, None, :])
    np.add.at(tensor, entries, values)
    return tensor
