# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The dofs of condensed fields: one vector of all fields, and the entries of each cell in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import dolfinx

from dolfinx_feti.runtime.arrays import Array, Indices, consecutive_slices


class CondensedFields:
    """Fields whose dofs no two cells share.

    Attributes:
        functions: The fields.
        entries: Entries of each owned cell in the vector of all dofs, (cells, n), field by field.
        widths: Number of dofs of each field in a cell, (fields,); their sum is n.
        size: Number of dofs of all fields on this process, ghosts included.
    """

    def __init__(self, functions: Sequence[dolfinx.fem.Function]) -> None:
        """Number the dofs.

        Args:
            functions: At least one field; all are on one mesh.
        """
        topology = functions[0].function_space.mesh.topology
        n_cells = topology.index_map(topology.dim).size_local
        sizes = [len(p.x.array) for p in functions]
        cell_dofs = [_dofs_of_cells(p.function_space, n_cells) for p in functions]
        self.functions = tuple(functions)
        self.widths = [dofs.shape[1] for dofs in cell_dofs]
        self.size = sum(sizes)
        self._parts = consecutive_slices(sizes)  # of the vector, by field
        self._columns = consecutive_slices(self.widths)  # of an array (cells, n), by field
        shifted = [part.start + dofs for part, dofs in zip(self._parts, cell_dofs, strict=True)]
        self.entries: Indices = np.concatenate(shifted, axis=1)

    def values(self) -> Array:
        """Return a copy of the dofs of all fields with their ghosts, field by field, (size,)."""
        return np.concatenate([p.x.array for p in self.functions])

    def set_values(self, values: Array) -> None:
        """Set the dofs of all fields, (size,), as in :meth:`values`."""
        for p, part in zip(self.functions, self._parts, strict=True):
            p.x.array[:] = values[part]

    def columns(self, index: int) -> slice:
        """Return the columns of the field with an index in an array of shape (cells, n)."""
        return self._columns[index]

    def split(self, cell_values: Array) -> list[Array]:
        """Return the columns of each field in an array of shape (cells, n)."""
        return [cell_values[:, columns] for columns in self._columns]

    def field_of_column(self, column: int) -> dolfinx.fem.Function:
        """Return the field that a column of an array of shape (cells, n) belongs to."""
        index = np.searchsorted(np.cumsum(self.widths), column, side="right")
        return self.functions[int(index)]


def _dofs_of_cells(Q: dolfinx.fem.FunctionSpace, n_cells: int) -> Indices:
    """Return the dofs of the first cells, in the order of the element, (cells, dofs of a cell)."""
    nodes = Q.dofmap.list[:n_cells]
    bs = Q.dofmap.bs
    dofs = nodes[:, :, None] * bs + np.arange(bs, dtype=np.int32)
    return dofs.reshape(n_cells, nodes.shape[1] * bs)
