# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Columns of all subdomains on the interface of each: their averages, and their scaled jumps.

With the copies of its dofs averaged, a column of a subdomain reaches into its neighbours, and no
further. So each subdomain sees

.. math:: W_i = (T V)_i, \quad V = T^⊤ δ\, U, \qquad \text{or} \qquad
          (B_D^⊤ B\, U)_i = U_i - (T V)_i

as one dense block of its own columns and those of its neighbours. The first is the coarse space of
the primal form (``averaged``), the second what the preconditioner of the dual form sees of G
(``weighted``): on a dof with a prescribed value, where no copies are averaged, it is U itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.coarse.near import joined
from dolfinx_feti.feti.copies import Copies, consecutive

__all__ = ["Field", "averaged_fields", "jump_fields"]

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Field:
    """Columns on the interface of one subdomain.

    Attributes:
        values: Dense block, (n_i, c_i).
        numbers: Number of each column over all processes, ascending, (c_i,).
    """

    values: Array
    numbers: Numbers


def jump_fields(copies: Copies, U: Sequence[Array]) -> Iterator[Field]:
    """Return the scaled jumps of the columns of all subdomains, B_Dᵀ B U, subdomain by subdomain.

    Args:
        copies: Copies of the interface dofs.
        U: For each subdomain its columns, (n_i, k_i), numbered on over subdomains and processes.

    Returns:
        The blocks, one after the other: together they are large.

    Note:
        Collective.
    """
    size = sum(U_i.shape[1] for U_i in U)
    first = copies.comm.scan(size) - size
    owned = consecutive([U_i.shape[1] for U_i in U])

    def jump(field: Field, U_i: Array, own: slice) -> Field:
        mine = np.arange(first + own.start, first + own.stop)
        numbers = np.union1d(field.numbers, mine)
        values = np.zeros((len(U_i), len(numbers)), order="F")
        values[:, np.searchsorted(numbers, mine)] = U_i
        values[:, np.searchsorted(numbers, field.numbers)] -= field.values
        return Field(values, numbers)

    return map(jump, averaged_fields(copies, U), U, owned)


def averaged_fields(copies: Copies, U: Sequence[Array]) -> Iterator[Field]:
    """Average the columns of all subdomains, T V, as one dense block for each subdomain.

    Args:
        copies: Copies of the interface dofs.
        U: For each subdomain its columns, (n_i, k_i), numbered on over subdomains and processes.

    Returns:
        The blocks, one after the other: together they are large.

    Note:
        Collective.
    """
    count = np.array([U_i.shape[1] for U_i in U], dtype=np.int64)
    before = copies.comm.scan(int(count.sum())) - count.sum()
    first = before + np.cumsum(count) - count
    sizes = [rows.stop - rows.start for rows in copies.blocks]
    most = copies.comm.allreduce(int(count.max(initial=0)), op=MPI.MAX)
    values = np.empty((len(copies.row), most))
    column = np.zeros(copies.n)
    for j in range(most):
        for U_i, rows in zip(U, copies.blocks, strict=True):
            column[rows] = U_i[:, j] if j < U_i.shape[1] else 0.0
        values[:, j] = copies.values(copies.delta * column)
    owner_first = copies.values(np.repeat(first, sizes).astype(np.float64)).astype(np.int64)
    owner_count = copies.values(np.repeat(count, sizes).astype(np.float64)).astype(np.int64)

    def field(rows: slice) -> Field:
        pairs = np.arange(*np.searchsorted(copies.row, [rows.start, rows.stop]))
        pairs = pairs[owner_count[pairs] > 0]
        row = copies.row[pairs] - rows.start
        n = rows.stop - rows.start
        return _field(n, row, owner_first[pairs], owner_count[pairs], values[pairs])

    return map(field, copies.blocks)


def _field(
    n: int, row: npt.NDArray[np.int32], first: Numbers, count: Numbers, values: Array
) -> Field:
    """Collect the columns of all owners of copies in one dense block.

    Args:
        n: Rows of the block.
        row: Row of each copy, (pairs,).
        first: First column of the copy's owner, (pairs,).
        count: Its number of columns, (pairs,).
        values: The copy's values, in the first ``count`` entries, (pairs, most).
    """
    owners, at, group = np.unique(first, return_index=True, return_inverse=True)
    widths: list[int] = [int(k) for k in count[at]]
    W = np.zeros((n, sum(widths)), order="F")
    for j, block in enumerate(consecutive(widths)):
        mine = group == j
        W[row[mine], block] = values[mine, : block.stop - block.start]
    numbers = [np.arange(f, f + k) for f, k in zip(owners, widths, strict=True)]
    return Field(W, joined(numbers).astype(np.int64))
