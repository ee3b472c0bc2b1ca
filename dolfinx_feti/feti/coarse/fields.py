# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Columns of all subdomains on the interface of each: their averages, and their scaled jumps.

.. math:: W_i = (T V)_i, \quad V = T^⊤ δ\, U, \qquad \text{or} \qquad
          (B_D^⊤ B\, U)_i = U_i - (T V)_i

with columns U_i of each subdomain, (n_i, k_i). A column reaches into the neighbours, and no
further: :math:`W_i` has one block of columns for each of them (``panels``). The averages are the
coarse space of the primal form, the jumps what the preconditioner of the dual form sees of G. On a
dof with a prescribed value the jump is U itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.coarse.near import joined
from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.subdomain.panels import Panels

__all__ = ["Fields", "averaged_fields", "jump_fields"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]


@dataclass(frozen=True, slots=True)
class Fields:
    """The columns near each subdomain, by pairs of a row and a subdomain with columns on it.

    Each :math:`W_i` is formed when it is asked for: together they are large.

    Attributes:
        blocks: Rows of each subdomain.
        row: Row of each pair, ascending, (pairs,).
        first: Number of the subdomain's first column over all processes, (pairs,).
        count: Number of its columns, (pairs,).
        values: Values of these columns in the row, in the first ``count`` entries, (pairs, most).
    """

    blocks: Sequence[slice]
    row: Integers
    first: Integers
    count: Integers
    values: Array

    def __len__(self) -> int:
        """Return the number of subdomains."""
        return len(self.blocks)

    def __getitem__(self, i: int) -> Panels:
        """Return the columns near subdomain i, by their owners, (n_i, c_i)."""
        rows, owners = self.blocks[i], self._owners(i)
        return Panels(
            rows.stop - rows.start,
            [self.row[pairs] - rows.start for pairs in owners],
            [self.values[pairs, : self.count[pairs[0]]].T.copy() for pairs in owners],
        )

    @property
    def numbers(self) -> list[npt.NDArray[np.int64]]:
        """Numbers of the columns near each subdomain over all processes, ascending, (c_i,)."""
        pairs = [[pairs[0] for pairs in self._owners(i)] for i in range(len(self))]
        return [
            joined([self.first[p] + np.arange(self.count[p]) for p in each], np.int64)
            for each in pairs
        ]

    def _owners(self, i: int) -> list[Integers]:
        """Return the pairs of subdomain i, by the owner of their columns, ascending."""
        rows = self.blocks[i]
        start, stop = np.searchsorted(self.row, [rows.start, rows.stop])
        if start == stop:
            return []
        _, owner = np.unique(self.first[start:stop], return_inverse=True)
        pairs = start + np.argsort(owner, kind="stable")
        return np.split(pairs, np.cumsum(np.bincount(owner))[:-1])


def averaged_fields(copies: Copies, U: Sequence[Array]) -> Fields:
    """Return the averaged columns of all subdomains, T V. Collective.

    Args:
        copies: Copies of the interface dofs.
        U: For each subdomain its columns, (n_i, k_i), numbered on over subdomains and processes.
    """
    own = _own_fields(copies, U)
    first, count = (
        copies.values(numbers.astype(np.float64)).astype(np.int64)
        for numbers in (own.first, own.count)
    )
    some = count > 0
    values = np.empty((np.count_nonzero(some), own.values.shape[1]))
    for j in range(values.shape[1]):
        values[:, j] = copies.values(copies.delta * own.values[:, j])[some]
    return Fields(copies.blocks, copies.row[some], first[some], count[some], values)


def jump_fields(copies: Copies, U: Sequence[Array]) -> Fields:
    """Return the scaled jumps of the columns of all subdomains, B_Dᵀ B U = U − T V. Collective.

    The arguments are those of :func:`averaged_fields`.
    """
    own, mean = _own_fields(copies, U), averaged_fields(copies, U)
    values, diagonal = -mean.values, mean.first == own.first[mean.row]
    values[diagonal] += own.values[mean.row[diagonal]]
    alone = own.count > 0
    alone[mean.row[diagonal]] = False  # rows with a prescribed value are left
    row = np.concatenate([mean.row, own.row[alone]])
    order = np.argsort(row, kind="stable")
    return Fields(
        copies.blocks,
        row[order],
        np.concatenate([mean.first, own.first[alone]])[order],
        np.concatenate([mean.count, own.count[alone]])[order],
        np.concatenate([values, own.values[alone]])[order],
    )


def _own_fields(copies: Copies, U: Sequence[Array]) -> Fields:
    """Return the columns of each subdomain on its own rows."""
    count = np.array([U_i.shape[1] for U_i in U], dtype=np.int64)
    first = copies.comm.scan(int(count.sum())) - count.sum() + np.cumsum(count) - count
    sizes = [rows.stop - rows.start for rows in copies.blocks]
    most = copies.comm.allreduce(int(count.max(initial=0)), op=MPI.MAX)
    values = np.zeros((copies.n, most))
    for U_i, rows in zip(U, copies.blocks, strict=True):
        values[rows, : U_i.shape[1]] = U_i
    row = np.arange(copies.n)
    return Fields(copies.blocks, row, np.repeat(first, sizes), np.repeat(count, sizes), values)
