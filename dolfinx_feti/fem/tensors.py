# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Forms cell by cell: vectors and matrices of the dofs of each cell."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.fem.assembly import create_csr, dolfinx_form, require_no_coupling
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import TornSpace
from dolfinx_feti.fem.regions import compile_cells
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array


def cell_tensors(
    forms: Sequence[ufl.Form], mesh: dolfinx.mesh.Mesh, compiler: Compiler
) -> Callable[[], list[Array]]:
    """Compile linear and bilinear forms, of which some may be zero. Collective.

    Returns:
        What integrates them at the present state in one visit of each cell, and returns for each
        form (cells, …) with the dofs of a cell for each argument, in the order of the element.

    Raises:
        ValueError: A form couples cells.
    """
    for form in forms:
        require_no_coupling(form)
    cells = mesh.topology.index_map(mesh.topology.dim).size_local
    widths = [[_width(a.ufl_function_space()) for a in form.arguments()] for form in forms]
    shapes = [(cells, *width) for width in widths]
    kernels, parts = compile_cells(forms, mesh, compiler.cache)
    rest = {
        i: _assembler(form, shapes[i], compiler) for i, form in enumerate(parts) if not form.empty()
    }

    def assemble() -> list[Array]:
        values = [np.zeros(shape) for shape in shapes]
        for numbers, kernel in kernels:
            for i, part in zip(numbers, kernel.evaluate(), strict=True):
                values[i][kernel.rows] += part
        for i, assemble_rest in rest.items():
            values[i] += assemble_rest()
        return values

    return assemble


def _assembler(form: ufl.Form, shape: tuple[int, ...], compiler: Compiler) -> Callable[[], Array]:
    """Compile a form for dolfinx, with dofs of its own for each cell, in the cell's order."""
    spaces = [_broken(a.ufl_function_space(), shape[0]) for a in form.arguments()]
    compiled = dolfinx_form(form, spaces, compiler)
    if len(spaces) < 2:
        return lambda: dolfinx.fem.assemble_vector(compiled).array.reshape(shape)
    csr = create_csr((spaces[0], spaces[1]), compiler)  # rows have the columns of their cell

    def matrix() -> Array:
        csr.data[:] = 0.0
        dolfinx.fem.assemble_matrix(csr, compiled)  # type: ignore[arg-type]
        return np.asarray(csr.data).reshape(shape)

    return matrix


def _width(V: dolfinx.fem.FunctionSpace) -> int:
    """Return the number of dofs of a cell."""
    return int(V.dofmap.list.shape[1]) * V.dofmap.bs


def _broken(V: dolfinx.fem.FunctionSpace, cells: int) -> TornSpace:
    """Give each owned cell dofs of its own; one by one, as dolfinx's rectangular matrices need."""
    width = _width(V)
    table = np.zeros((len(V.dofmap.list), width), dtype=np.int32)
    table[:cells] = np.arange(cells * width, dtype=np.int32).reshape(cells, width)
    torn = compat.create_function_space(V, table, cells * width, block_size=1)
    return TornSpace(V, torn, table[:0].ravel(), table[:0].ravel().astype(np.int64))
