# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Forms assembled cell by cell, each into one array with a matrix or a vector for each cell.

These arrays are the blocks of the mixed tangent and the residuals of the condensed fields. Kernels
of the package return the entries of each cell. For the part of a form that FFCx compiles, each cell
gets separate dofs, so that dolfinx's assemblers do not add up different cells.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.fem.assembly import create_csr
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import TornSpace
from dolfinx_feti.fem.split_form import check_integral_types, dolfinx_form
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array


class CellwiseForms:
    """Compiled forms, which are assembled together: they share basis functions and state."""

    def __init__(
        self, forms: Sequence[ufl.Form], mesh: dolfinx.mesh.Mesh, compiler: Compiler
    ) -> None:
        """Compile the forms. Collective.

        Args:
            forms: Linear and bilinear forms. A form that is zero has to contain its arguments, as
                a zero block of ``mixed_tangent`` does: they determine the shape of the result.
            mesh: Their mesh.
            compiler: Compiler of the problem.

        Raises:
            ValueError: A form has integrals that couple cells.
        """
        for form in forms:
            check_integral_types(form)
        n_cells = mesh.topology.index_map(mesh.topology.dim).size_local
        self._shapes = []
        for form in forms:
            sizes = [_dofs_per_cell(a.ufl_function_space()) for a in form.arguments()]
            self._shapes.append((n_cells, *sizes))
        generated = compiler.kernels.generate(forms, mesh)
        self._kernels = generated.kernels
        self._by_dolfinx = {
            i: _CellwiseDolfinxForm(form, self._shapes[i], compiler)
            for i, form in enumerate(generated.remaining)
            if not form.empty()
        }  # by the index of the form

    def assemble(self) -> list[Array]:
        """Assemble all forms at the present state.

        Returns:
            Entries of each form in the owned cells, (cells, dofs of the test function) or (cells,
            dofs of the test function, dofs of the trial function), in the order of the element.
        """
        arrays = [np.zeros(shape) for shape in self._shapes]
        for kernel in self._kernels:
            for i, entries in zip(kernel.forms, kernel.evaluate(), strict=True):
                arrays[i][kernel.rows] += entries
        for i, by_dolfinx in self._by_dolfinx.items():
            arrays[i] += by_dolfinx.assemble()
        return arrays


class _CellwiseDolfinxForm:
    """A form that dolfinx assembles cell by cell, on spaces whose cells share no dofs."""

    def __init__(self, form: ufl.Form, shape: tuple[int, ...], compiler: Compiler) -> None:
        """Compile the form. Collective.

        Args:
            form: A linear or bilinear form.
            shape: Shape of the result, see :meth:`CellwiseForms.assemble`.
            compiler: Compiler of the problem.
        """
        spaces = [_broken_space(a.ufl_function_space(), shape[0]) for a in form.arguments()]
        self._shape = shape
        self._form = dolfinx_form(form, spaces, compiler)
        self._csr: dolfinx.la.MatrixCSR | None = None
        if len(spaces) == 2:
            self._csr = create_csr((spaces[0], spaces[1]), compiler)

    def assemble(self) -> Array:
        """Return the entries of the owned cells, see :meth:`CellwiseForms.assemble`.

        A row of the matrix has the columns of its cell and no others, sorted: the entries of a cell
        are consecutive, row by row.
        """
        if self._csr is None:
            return dolfinx.fem.assemble_vector(self._form).array.reshape(self._shape)
        self._csr.data[:] = 0.0
        dolfinx.fem.assemble_matrix(self._csr, self._form)  # type: ignore[arg-type]
        return np.asarray(self._csr.data).reshape(self._shape)


def _dofs_per_cell(V: dolfinx.fem.FunctionSpace) -> int:
    """Return the number of dofs of a cell, all components counted."""
    return int(V.dofmap.list.shape[1]) * V.dofmap.bs


def _broken_space(V: dolfinx.fem.FunctionSpace, n_cells: int) -> TornSpace:
    """Return V with separate dofs for each owned cell, in the order of cells and of their dofs.

    The block size is 1, as dolfinx's matrices need equal block sizes of rows and columns. Ghost
    cells get dof 0; no form is assembled on them.
    """
    width = _dofs_per_cell(V)
    table = np.zeros((len(V.dofmap.list), width), dtype=np.int32)
    table[:n_cells] = np.arange(n_cells * width, dtype=np.int32).reshape(n_cells, width)
    broken = compat.create_function_space(V, table, n_cells * width, block_size=1)
    no_dofs = np.zeros(0, dtype=np.int32)  # only V_torn is used: nothing on this space is torn
    return TornSpace(V, broken, no_dofs, no_dofs.astype(np.int64))
