# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The coarse columns on the interface of each subdomain: averages, or scaled jumps.

.. math:: W_i = (T V)_i, \quad V = T^⊤ δ\, U, \qquad \text{or} \qquad
          W_i = (B_D^⊤ B\, U)_i = U_i - (T V)_i

Subdomain j contributes the columns :math:`U_j`, (n_{Γ,j}, k_j), on its interface. Their k_j coarse
dofs are a *block*. Coarse dofs are numbered over all processes, process by process and subdomain by
subdomain, so that the dofs of a block are consecutive, and the first one identifies a block.

On the interface of subdomain i, only its own columns and those of its neighbours are nonzero:
:math:`W_i`, (n_{Γ,i}, c_i), has a *panel* of columns for each of these blocks. In a row with a
prescribed value V vanishes, because the assembled interface does not contain the dof.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.subdomain.panels import Panels, load_panels
from dolfinx_feti.runtime.arrays import Array, Indices, Integers, Numbers, consecutive_slices
from dolfinx_feti.runtime.collective import on_all


@dataclass(frozen=True, slots=True)
class SubdomainColumns:
    """The coarse columns of one subdomain i: its own, and all that are nonzero on its interface.

    Attributes:
        rows: Rows of the subdomain in an interface vector, (n_Γ,).
        U: Columns U_i that it contributes, (n_{Γ,i}, k_i).
        block: Their coarse dofs, as a slice of a coarse vector of this process, (n_c,).
        W: :math:`W_i`, all columns on its interface, (n_{Γ,i}, c_i), with a panel for each block.
        first_dofs: First coarse dof of each panel of W_i, numbered over all processes, ascending,
            (panels,).
        dofs: Coarse dofs of W_i, owned ones and ghosts, as a slice of a torn coarse vector, (c,)
            (``dofmap``).
    """

    rows: slice
    U: Array
    block: slice
    W: Panels
    first_dofs: Numbers
    dofs: slice


def averaged_columns(copies: Copies, U: Sequence[Array]) -> list[SubdomainColumns]:
    """Compute the averages :math:`W_i = (T V)_i` on each subdomain. Collective.

    Args:
        copies: Copies of the interface dofs.
        U: Columns that each subdomain contributes, (n_{Γ,i}, k_i).
    """
    return _columns_of_subdomains(copies, U, _Averages(copies, U))


def jump_columns(copies: Copies, U: Sequence[Array]) -> list[SubdomainColumns]:
    """Compute the scaled jumps :math:`W_i = U_i - (T V)_i` on each subdomain. Collective.

    Args:
        copies: Copies of the interface dofs.
        U: Columns that each subdomain contributes, (n_{Γ,i}, k_i).
    """
    return _columns_of_subdomains(copies, U, _Jumps(copies, U))


@dataclass(frozen=True, slots=True)
class _PanelRows:
    """The rows of all panels of this process: an interface row, and a block of columns in it.

    An interface row occurs once for each block that may be nonzero in it.

    Attributes:
        row: Interface row of this process, (panel rows,).
        first_dof: First coarse dof of the block, which identifies it, (panel rows,).
        width: Number of columns of the block, k_j, (panel rows,).
    """

    row: Integers
    first_dof: Numbers
    width: Numbers

    def select(self, which: Integers | slice) -> _PanelRows:
        """Return the panel rows with these indices, in their order."""
        return _PanelRows(self.row[which], self.first_dof[which], self.width[which])


class _Columns(Protocol):
    """Columns of all blocks on the interfaces of this process.

    Attributes:
        panel_rows: Where the columns are nonzero, in any order.
    """

    panel_rows: _PanelRows

    def values(self, j: int) -> Array:
        """Return column j of the block of each panel row, (panel rows,). Collective.

        The values of blocks without a column j have no meaning.
        """


class _Averages:
    """The columns T V."""

    def __init__(self, copies: Copies, U: Sequence[Array]) -> None:
        """Find the panel rows. Collective. Arguments are those of :func:`averaged_columns`."""
        first_dof, width = _blocks_of_rows(copies, U)
        self._copies = copies
        self._U = U
        # V is nonzero in a row for the block of each copy of its dof.
        self.panel_rows = _PanelRows(copies.pair_rows, copies.fetch(first_dof), copies.fetch(width))

    def values(self, j: int) -> Array:
        """Return T V on the panel rows, for column j of each block, (panel rows,). Collective.

        A panel row stands for one copy of the dof of its row, and for the block of that copy's
        subdomain. The columns of a block are nonzero in this copy alone, so T Tᵀ δ U has one term.
        """
        u = _column_of_each_block(self._copies, self._U, j)
        return self._copies.fetch(self._copies.delta * u)  # δ U


class _Jumps:
    """The columns U − T V."""

    def __init__(self, copies: Copies, U: Sequence[Array]) -> None:
        """Find the panel rows. Collective. Arguments are those of :func:`jump_columns`."""
        first_dof, width = _blocks_of_rows(copies, U)
        first_row = copies.comm.scan(copies.size) - copies.size  # of this process, over all
        self._copies = copies
        self._U = U
        self._is_own = copies.pair_copies == first_row + copies.pair_rows  # row with itself
        self._prescribed = np.setdiff1d(np.arange(copies.size), copies.pair_rows)  # without a pair
        self.panel_rows = _PanelRows(
            row=np.append(copies.pair_rows, self._prescribed),
            first_dof=np.append(copies.fetch(first_dof), first_dof[self._prescribed]),
            width=np.append(copies.fetch(width), width[self._prescribed]),
        )

    def values(self, j: int) -> Array:
        """Return U − T V in each panel row, for column j of its block. Collective."""
        copies = self._copies
        u = _column_of_each_block(copies, self._U, j)
        jump = -copies.fetch(copies.delta * u)  # −T V
        jump[self._is_own] += u[copies.pair_rows[self._is_own]]  # U − T V
        return np.append(jump, u[self._prescribed])  # V = 0


def _blocks_of_rows(copies: Copies, U: Sequence[Array]) -> tuple[Numbers, Numbers]:
    """Return the block that the subdomain of each interface row contributes. Collective.

    Args:
        copies: Copies of the interface dofs.
        U: Columns that each subdomain contributes, (n_{Γ,i}, k_i).

    Returns:
        First coarse dof over all processes, and number of columns of the block, (n_Γ,) each.
    """
    width = np.array([U_i.shape[1] for U_i in U], dtype=np.int64)
    n_c = int(width.sum())
    first_of_process = copies.comm.scan(n_c) - n_c
    first_dof = first_of_process + np.cumsum(width) - width
    rows = [rows.stop - rows.start for rows in copies.rows]
    return np.repeat(first_dof, rows), np.repeat(width, rows)


def _column_of_each_block(copies: Copies, U: Sequence[Array], j: int) -> Array:
    """Return column j of every U_i, one after the other, (n_Γ,); zero if U_i has fewer columns."""
    u = np.zeros(copies.size)
    for U_i, rows in zip(U, copies.rows, strict=True):
        if j < U_i.shape[1]:
            u[rows] = U_i[:, j]
    return u


def _columns_of_subdomains(
    copies: Copies, U: Sequence[Array], columns: _Columns
) -> list[SubdomainColumns]:
    """Collect the values of the columns in panels. Collective.

    The panel rows are sorted by subdomain and block, and their values are stored row by row. So
    those of a subdomain are a slice of the rows and of the values, and so are those of a panel.

    Args:
        copies: Copies of the interface dofs.
        U: Columns that each subdomain contributes, (n_{Γ,i}, k_i).
        columns: The columns on all interfaces.
    """
    comm = copies.comm
    code = load_panels(comm)
    subdomain_ends = [rows.stop for rows in copies.rows]
    subdomain = np.searchsorted(subdomain_ends, columns.panel_rows.row, side="right")
    # A stable sort: the rows of a panel stay in ascending order.
    order = np.lexsort((columns.panel_rows.first_dof, subdomain))
    order = order[columns.panel_rows.width[order] > 0]
    panel_rows = columns.panel_rows.select(order)
    values, first_value = _values_of_rows(columns, order, comm)
    # Index of the first panel row of each subdomain, and the end, (subdomains + 1,). The same for
    # its values.
    row_bounds = np.searchsorted(subdomain[order], np.arange(len(copies.rows) + 1))
    value_bounds = np.append(first_value, len(values))[row_bounds]

    blocks = consecutive_slices([U_i.shape[1] for U_i in U])

    def create() -> list[SubdomainColumns]:
        by_subdomain: list[SubdomainColumns] = []
        first_torn_dof = 0
        for i, rows in enumerate(copies.rows):
            W_i, first_dofs = _panels_of_subdomain(
                code,
                rows,
                panel_rows.select(slice(row_bounds[i], row_bounds[i + 1])),
                values[value_bounds[i] : value_bounds[i + 1]],
            )
            dofs = slice(first_torn_dof, first_torn_dof + W_i.shape[1])
            first_torn_dof = dofs.stop
            by_subdomain.append(
                SubdomainColumns(
                    rows=rows, U=U[i], block=blocks[i], W=W_i, first_dofs=first_dofs, dofs=dofs
                )
            )
        return by_subdomain

    return on_all(create, comm)


def _panels_of_subdomain(
    code: Any, rows: slice, panel_rows: _PanelRows, values: Array
) -> tuple[Panels, Numbers]:
    """Create W_i of one subdomain.

    Args:
        code: Compiled code of panels.
        rows: Interface rows of the subdomain.
        panel_rows: Its panel rows, sorted by block.
        values: Values of the first panel row, of the second one, and so on.

    Returns:
        W_i, and the first coarse dof of each of its panels, (panels,).
    """
    first_of_panel = np.flatnonzero(np.diff(panel_rows.first_dof, prepend=-1))  # panel rows
    panels = Panels(
        code=code,
        n=rows.stop - rows.start,
        starts=_as_indices(np.append(first_of_panel, len(panel_rows.row))),
        rows=_as_indices(panel_rows.row - rows.start),
        widths=_as_indices(panel_rows.width[first_of_panel]),
        values=values,
    )
    return panels, panel_rows.first_dof[first_of_panel]


def _values_of_rows(columns: _Columns, order: Integers, comm: MPI.Comm) -> tuple[Array, Numbers]:
    """Fetch the values of all columns, in one exchange for each column of the widest block.

    Collective.

    Args:
        columns: The columns.
        order: Indices of panel rows in the order of the values.
        comm: Communicator of the columns.

    Returns:
        The values of the first panel row, those of the second one, and so on, (Σ width,); and the
        index of the first value of each panel row, (panel rows,).

    Raises:
        MemoryError: The values do not fit into memory; on all processes.
    """
    width = columns.panel_rows.width[order]
    first_value = np.cumsum(width) - width
    values = on_all(lambda: np.empty(width.sum()), comm)
    widest = comm.allreduce(int(width.max(initial=0)), op=MPI.MAX)
    for j in range(widest):
        has_column = width > j
        values[first_value[has_column] + j] = columns.values(j)[order][has_column]
    return values, first_value


def _as_indices(values: Integers) -> Indices:
    """Return a copy as the 32-bit integers that the C code of the panels reads."""
    return values.astype(np.int32)
