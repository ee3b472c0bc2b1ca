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

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.subdomain.panels import Panels, load_panels
from dolfinx_feti.runtime.arrays import Array, Indices, Integers, Numbers
from dolfinx_feti.runtime.collective import on_all


@dataclass(frozen=True, slots=True)
class LocalCoarseBasis:
    """The coarse columns on the interface of each subdomain of this process.

    Attributes:
        W: :math:`W_i` of each subdomain, (n_{Γ,i}, c_i); its panels are in the order of the blocks.
        first_dofs: For each subdomain, the first coarse dof of each panel of W_i, numbered over all
            processes, ascending, (panels of W_i,).
    """

    W: list[Panels]
    first_dofs: list[Numbers]


def averaged_columns(copies: Copies, U: Sequence[Array]) -> LocalCoarseBasis:
    """Compute the averages :math:`W_i = (T V)_i` on each subdomain. Collective.

    Args:
        copies: Copies of the interface dofs.
        U: Columns that each subdomain contributes, (n_{Γ,i}, k_i).
    """
    first_dof, width = _blocks_of_rows(copies, U)
    # V is nonzero in a row for the block of each copy of its dof.
    panel_rows = _PanelRows(copies.pair_rows, copies.fetch(first_dof), copies.fetch(width))

    def averages(j: int) -> Array:
        """Return T V in each panel row, for column j of its block, (panel rows,). Collective.

        The column is nonzero in one of the copies alone, so that the sum over them has one term.
        """
        return copies.fetch(copies.delta * _column_of_each_block(copies, U, j))  # δ U

    return _local_basis(copies, panel_rows, averages)


def jump_columns(copies: Copies, U: Sequence[Array]) -> LocalCoarseBasis:
    """Compute the scaled jumps :math:`W_i = U_i - (T V)_i` on each subdomain. Collective.

    Args:
        copies: Copies of the interface dofs.
        U: Columns that each subdomain contributes, (n_{Γ,i}, k_i).
    """
    first_dof, width = _blocks_of_rows(copies, U)
    first_row = copies.comm.scan(copies.size) - copies.size  # of this process, over all processes
    with_itself = copies.pair_copies == first_row + copies.pair_rows  # pairs of a row with itself
    prescribed = np.setdiff1d(np.arange(copies.size), copies.pair_rows)  # rows without a pair
    panel_rows = _PanelRows(
        row=np.append(copies.pair_rows, prescribed),
        first_dof=np.append(copies.fetch(first_dof), first_dof[prescribed]),
        width=np.append(copies.fetch(width), width[prescribed]),
    )

    def jumps(j: int) -> Array:
        """Return U − T V in each panel row, for column j of its block. Collective."""
        u = _column_of_each_block(copies, U, j)
        jump = -copies.fetch(copies.delta * u)  # −T V
        jump[with_itself] += u[copies.pair_rows[with_itself]]  # U − T V
        return np.append(jump, u[prescribed])  # V = 0

    return _local_basis(copies, panel_rows, jumps)


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

    def in_order(self, order: Integers) -> _PanelRows:
        """Return the panel rows with these indices, in their order."""
        return _PanelRows(self.row[order], self.first_dof[order], self.width[order])


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


def _local_basis(
    copies: Copies, panel_rows: _PanelRows, column_values: Callable[[int], Array]
) -> LocalCoarseBasis:
    """Collect the values of the columns in panels. Collective.

    Sorting the panel rows by subdomain and block makes those of each panel consecutive. Their
    values are fetched from the neighbours column by column, and stored row by row. Each panel is
    then a slice of the sorted rows and of their values.

    Args:
        copies: Copies of the interface dofs.
        panel_rows: Where the columns are nonzero, in any order.
        column_values: Returns the values of column j of the block of each panel row, (panel rows,);
            those of blocks without a column j are ignored. Collective.
    """
    comm = copies.comm
    code = load_panels(comm)
    subdomain_ends = [rows.stop for rows in copies.rows]
    subdomain = np.searchsorted(subdomain_ends, panel_rows.row, side="right")
    order = np.lexsort((panel_rows.first_dof, subdomain))  # stable: rows stay in ascending order
    order = order[panel_rows.width[order] > 0]
    panel_rows = panel_rows.in_order(order)
    subdomain = subdomain[order]
    values, first_value = _values_of_rows(panel_rows, lambda j: column_values(j)[order], comm)

    is_new_subdomain = np.diff(subdomain, prepend=-1) != 0
    is_new_block = np.diff(panel_rows.first_dof, prepend=-1) != 0
    first_of_panel = np.flatnonzero(is_new_subdomain | is_new_block)  # panel rows, (panels,)
    # Where each panel begins among the panel rows and values, and the ends, (panels + 1,) each.
    row_bounds = np.append(first_of_panel, len(order))
    value_bounds = np.append(first_value[first_of_panel], len(values))
    # Where each subdomain begins among the panels, and the end, (subdomains + 1,).
    panel_bounds = np.searchsorted(subdomain[first_of_panel], np.arange(len(copies.rows) + 1))
    row_in_subdomain = (
        panel_rows.row - np.array([rows.start for rows in copies.rows], int)[subdomain]
    )

    def create_panels(i: int) -> Panels:
        """Create W_i from the panels a, …, b − 1."""
        a, b = panel_bounds[i : i + 2]
        rows = copies.rows[i]
        return Panels(
            code=code,
            n=rows.stop - rows.start,
            starts=_as_indices(row_bounds[a : b + 1] - row_bounds[a]),
            rows=_as_indices(row_in_subdomain[row_bounds[a] : row_bounds[b]]),
            widths=_as_indices(panel_rows.width[first_of_panel[a:b]]),
            values=values[value_bounds[a] : value_bounds[b]],
        )

    first_dofs = panel_rows.first_dof[first_of_panel]
    return LocalCoarseBasis(
        W=on_all(lambda: [create_panels(i) for i in range(len(copies.rows))], comm),
        first_dofs=[first_dofs[a:b] for a, b in itertools.pairwise(panel_bounds)],
    )


def _values_of_rows(
    panel_rows: _PanelRows, column_values: Callable[[int], Array], comm: MPI.Comm
) -> tuple[Array, Numbers]:
    """Fetch the values of all columns, in one exchange for each column of the widest block.

    Collective.

    Args:
        panel_rows: Panel rows in the order of the values.
        column_values: Returns the values of column j of the block of each panel row, (panel rows,);
            collective.
        comm: Communicator of the columns.

    Returns:
        The values of the first panel row, those of the second one, and so on, (Σ width,); and the
        index of the first value of each panel row, (panel rows,).

    Raises:
        MemoryError: The values do not fit into memory; on all processes.
    """
    width = panel_rows.width
    first_value = np.cumsum(width) - width
    values = on_all(lambda: np.empty(width.sum()), comm)
    widest = comm.allreduce(int(width.max(initial=0)), op=MPI.MAX)
    for j in range(widest):
        has_column = width > j
        values[first_value[has_column] + j] = column_values(j)[has_column]
    return values, first_value


def _as_indices(values: Integers) -> Indices:
    """Return a copy as the 32-bit integers that the C code of the panels reads."""
    return values.astype(np.int32)
