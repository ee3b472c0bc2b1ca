# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Forms cell by cell: vectors and matrices of the dofs of each cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.fem.assembly import create_csr, dolfinx_form, require_no_coupling
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import TornSpace
from dolfinx_feti.fem.kernels.kernel import Kernel, create_kernel
from dolfinx_feti.fem.regions import Region, separate
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array

__all__ = ["CellTensors"]


class CellTensors:
    """Linear and bilinear forms whose cells are integrated in one visit."""

    def __init__(
        self, forms: Sequence[ufl.Form], mesh: dolfinx.mesh.Mesh, compiler: Compiler
    ) -> None:
        """Compile the forms.

        Args:
            forms: The forms, of which some may be zero.
            mesh: Their mesh.
            compiler: How they are compiled.

        Raises:
            ValueError: A form couples cells.

        Note:
            Collective.
        """
        for form in forms:
            require_no_coupling(form)
        cells = mesh.topology.index_map(mesh.topology.dim).size_local
        self._shapes = [
            (cells, *(_width(a.ufl_function_space()) for a in form.arguments())) for form in forms
        ]
        parts = [separate(ufl.algorithms.expand_derivatives(form), mesh) for form in forms]
        rest = {i: others for i, (_, others) in enumerate(parts)}
        groups: dict[tuple[int, int] | None, dict[int, Region]] = {}
        for i, (regions, _) in enumerate(parts):
            for region in regions:
                groups.setdefault(region.name, {})[i] = region
        self._kernels: list[tuple[list[int], Kernel]] = []
        for group in groups.values():
            inside = [region.inside for region in group.values()]
            cells = next(iter(group.values())).cells
            kernel = create_kernel(inside, mesh, compiler, cells)
            if kernel is None:
                rest |= {i: rest[i] + region.form for i, region in group.items()}
            else:
                self._kernels.append((list(group), kernel))
        self._rest = {
            i: _Rest.create(form, self._shapes[i], compiler)
            for i, form in rest.items()
            if not form.empty()
        }

    def assemble(self) -> list[Array]:
        """Integrate at the present state.

        Returns:
            For each form (cells, …) with the dofs of a cell for each argument, in the order of the
            element.
        """
        values = [np.zeros(shape) for shape in self._shapes]
        for numbers, kernel in self._kernels:
            for i, part in zip(numbers, kernel.evaluate(), strict=True):
                values[i][kernel.rows] += part
        for i, rest in self._rest.items():
            values[i] += rest.assemble()
        return values


@dataclass(frozen=True, slots=True)
class _Rest:
    """A form that dolfinx assembles, with dofs of its own for each cell, in the cell's order.

    Attributes:
        form: The form.
        shape: (cells, …) with the dofs of a cell for each argument.
        csr: The matrix of a bilinear form, whose rows have the columns of their cell.
    """

    form: dolfinx.fem.Form
    shape: tuple[int, ...]
    csr: dolfinx.la.MatrixCSR | None

    @classmethod
    def create(cls, form: ufl.Form, shape: tuple[int, ...], compiler: Compiler) -> _Rest:
        """Compile a form."""
        spaces = [_broken(a.ufl_function_space(), shape[0]) for a in form.arguments()]
        matrix = create_csr((spaces[0], spaces[1]), compiler) if len(spaces) == 2 else None
        return cls(dolfinx_form(form, spaces, compiler), shape, matrix)

    def assemble(self) -> Array:
        """Assemble, (cells, …)."""
        if self.csr is None:
            vector = np.zeros(self.shape)
            dolfinx.fem.assemble_vector(vector.reshape(-1), self.form)
            return vector
        self.csr.data[:] = 0.0
        dolfinx.fem.assemble_matrix(self.csr, self.form)  # type: ignore[arg-type]
        return np.asarray(self.csr.data).reshape(self.shape)


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
