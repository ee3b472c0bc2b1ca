# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Forms cell by cell: vectors and matrices of the dofs of each cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti.fem.assembly import create_csr, dolfinx_form, require_no_coupling
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import TornSpace, into_cells, tear
from dolfinx_feti.fem.kernels.kernel import Kernel, create_kernel
from dolfinx_feti.fem.regions import Region, separate
from dolfinx_feti.runtime import compat

__all__ = ["CellTensors"]

Array = npt.NDArray[np.float64]


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
            i: _Rest.create(form, compiler) for i, form in rest.items() if not form.empty()
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
    """A form that dolfinx assembles on spaces that are torn into cells.

    Attributes:
        form: The form.
        place: For each argument, where the dofs of a cell are among its torn ones, (cells, dofs).
        csr: The matrix of a bilinear form, whose rows have the columns of their cell.
    """

    form: dolfinx.fem.Form
    place: tuple[npt.NDArray[np.int32], ...]
    csr: dolfinx.la.MatrixCSR | None

    @classmethod
    def create(cls, form: ufl.Form, compiler: Compiler) -> _Rest:
        """Compile a form."""
        spaces = [_by_dof(a.ufl_function_space()) for a in form.arguments()]
        matrix = create_csr((spaces[0], spaces[1]), compiler) if len(spaces) == 2 else None
        cells = [
            space.V_torn.dofmap.list[: space.V_torn.dofmap.index_map.size_local // _width(space.V)]
            for space in spaces
        ]
        place = tuple(
            dofs - dofs.min(axis=1, initial=np.iinfo(np.int32).max, keepdims=True) for dofs in cells
        )
        return cls(dolfinx_form(form, spaces, compiler), place, matrix)

    def assemble(self) -> Array:
        """Assemble, (cells, …)."""
        shape = (len(self.place[0]), *(place.shape[1] for place in self.place))
        if self.csr is None:
            vector = np.zeros(shape)
            dolfinx.fem.assemble_vector(vector.reshape(-1), self.form)
            return np.take_along_axis(vector, self.place[0], axis=1)
        self.csr.data[:] = 0.0
        dolfinx.fem.assemble_matrix(self.csr, self.form)  # type: ignore[arg-type]
        rows, columns = self.place
        cell = np.arange(len(rows))[:, None, None]
        matrix = np.asarray(self.csr.data).reshape(shape)
        return np.asarray(matrix[cell, rows[:, :, None], columns[:, None, :]])


def _width(V: dolfinx.fem.FunctionSpace) -> int:
    """Return the number of dofs of a cell."""
    return int(V.dofmap.list.shape[1]) * V.dofmap.bs


def _by_dof(V: dolfinx.fem.FunctionSpace) -> TornSpace:
    """Tear a space into cells and number its dofs, as dolfinx's rectangular matrices need."""
    space = tear(V, into_cells(V.mesh))
    bs = V.dofmap.index_map_bs
    dofs = space.V_torn.dofmap.list[:, :, None] * bs + np.arange(bs, dtype=np.int32)
    table = dofs.reshape(len(dofs), dofs.shape[1] * bs)
    torn = compat.create_function_space(space.V_torn, table, len(space.dof) * bs, block_size=1)
    return replace(space, V_torn=torn)
