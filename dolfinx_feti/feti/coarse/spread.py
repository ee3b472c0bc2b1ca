# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The inverse of a coarse matrix N, spread over all processes in square blocks.

The processes form g groups, and P = g (g + 1)/2 of them stand for the pairs of groups (I, J) with
I ≤ J. Each has the block of the rows of group I and the columns of J, (K/g, K/g), and both are at
hand to it:

.. math:: x_I ← x_I + (N^{-1})_{IJ}\, b_J, \qquad x_J ← x_J + (N^{-1})_{JI}\, b_I.

A symmetric N⁻¹ is stored and read once for both, K²/(2 P) numbers of a process where its rows would
be K²/P. A solve gathers b and sums x within two groups of some √(2 P) processes, each of which is
at home in one of them, with its rows. Processes beyond the pairs have rows and no block.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.coarse.near import expanded

__all__ = ["SpreadInverse", "number_of_groups", "pairs_of_groups"]

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

#: Where the communicators of the groups are kept.
_KEY = MPI.Comm.Create_keyval()


class SpreadInverse:
    """N⁻¹, by the blocks of this process."""

    def __init__(
        self, rows: Array, starts: Counts, *, symmetric: bool, comm: MPI.Intracomm
    ) -> None:
        """Hand own rows of N⁻¹ to those who multiply with them. Collective.

        Args:
            rows: Own rows of N⁻¹, (own rows, K).
            starts: First row of each process, and K, (P + 1,).
            symmetric: Whether N is symmetric.
            comm: Communicator of N.
        """
        pairs, home = pairs_of_groups(comm.size)
        size = np.diff(starts)
        order = np.argsort(home, kind="stable")
        grouped = expanded(starts[order], size[order])  # rows of all groups, one after the other
        ends = np.cumsum(np.bincount(home, weights=size).astype(np.int64))
        rows_of = np.split(grouped, ends)  # and none
        self._groups, blocks = [], []
        for number, own in _communicators(comm, pairs).items():
            members = _members(pairs, number)
            counts = np.where(home[members] == number, size[members], 0)
            group = _Group(own, [int(count) for count in counts])
            self._groups.append(group)
            other = np.where(pairs[members, 1] < 0, -1, pairs[members].sum(axis=1) - number)
            blocks.append(group.collect(rows, [rows_of[int(o)] for o in other]))
        self._blocks = blocks if pairs[comm.rank, 1] >= 0 else []
        if symmetric and len(self._blocks) == 2:
            self._blocks[1] = self._blocks[0].T

    @property
    def nbytes(self) -> int:
        """Memory of the blocks of this process in bytes."""
        return sum(block.nbytes for block in self._blocks if block.base is None)

    def solve(self, b: Array) -> Array:
        """Return own rows of x = N⁻¹ b for own rows of b, (own rows,). Collective."""
        gathering = [group.gather(b) for group in self._groups]
        MPI.Request.Waitall([request for request, _ in gathering])
        of_other = [whole for _, whole in reversed(gathering)]
        if self._blocks:
            sums = [B @ b_J for B, b_J in zip(self._blocks, of_other, strict=True)]  # N⁻¹_IJ b_J
        else:
            sums = [np.zeros(len(whole)) for whole in of_other]
        summing = [group.sum(part) for group, part in zip(self._groups, sums, strict=True)]
        MPI.Request.Waitall([request for request, _ in summing])
        return np.concatenate([own for _, own in summing])  # there are rows in one group alone


@dataclass(frozen=True, slots=True)
class _Group:
    """The processes that multiply with the rows or columns of a group, and have these rows.

    Attributes:
        comm: Their communicator.
        counts: Rows of each, 0 for those that are at home in another group.
    """

    comm: MPI.Intracomm
    counts: list[int]

    @property
    def own(self) -> int:
        """Number of own rows."""
        return self.counts[self.comm.rank]

    def collect(self, rows: Array, columns: list[Counts]) -> Array:
        """Return the block of this group's rows and this process's columns. Collective.

        Args:
            rows: Own rows of N⁻¹, (own rows, K).
            columns: Columns of the block of each process.
        """
        mine = len(columns[self.comm.rank])
        own = rows[: self.own]
        sent = np.concatenate([own[:, those].ravel() for those in columns])
        block = np.empty((sum(self.counts), mine))
        to, by = [self.own * len(those) for those in columns], [n * mine for n in self.counts]
        self.comm.Alltoallv((sent, to), (block, by))
        return block

    def gather(self, b: Array) -> tuple[MPI.Request, Array]:
        """Begin to gather b of this group from own rows, (own rows,)."""
        whole = np.empty(sum(self.counts))
        return self.comm.Iallgatherv(b[: self.own], (whole, self.counts)), whole

    def sum(self, part: Array) -> tuple[MPI.Request, Array]:
        """Begin to sum x of this group, and to hand out its rows."""
        own = np.empty(self.own)
        return self.comm.Ireduce_scatter(part, own, self.counts, MPI.SUM), own


def number_of_groups(processes: int) -> int:
    """Return the most groups for whose pairs there are processes, g (g + 1)/2 ≤ P."""
    return (math.isqrt(8 * processes + 1) - 1) // 2


def pairs_of_groups(processes: int) -> tuple[Counts, Counts]:
    """Return the groups I ≤ J of each process, (P, 2), and where it is at home, (P,).

    A process without a block has a group and −1.
    """
    g = number_of_groups(processes)
    second, first = np.tril_indices(g)
    home = np.where((second - first) % 2, first, second)  # half of the pairs of each group
    further = np.arange(len(first), processes) % g
    alone = np.stack([further, np.full_like(further, -1)], axis=1)
    return np.vstack([np.stack([first, second], axis=1), alone]), np.append(home, further)


def _members(pairs: Counts, number: int) -> Counts:
    """Return the processes of a group."""
    return np.flatnonzero((pairs == number).any(axis=1))


def _communicators(comm: MPI.Intracomm, pairs: Counts) -> dict[int, MPI.Intracomm]:
    """Return those of the groups of this process, ascending. Collective.

    They are kept with the communicator, as all matrices on it have the same ones.
    """
    if (kept := comm.Get_attr(_KEY)) is not None:
        return cast("dict[int, MPI.Intracomm]", kept)
    found, world = {}, comm.Get_group()
    for number in sorted({int(i) for i in pairs[comm.rank] if i >= 0}):  # each after those before
        group = world.Incl([int(member) for member in _members(pairs, number)])
        found[number] = comm.Create_group(group, number)
        group.Free()
    world.Free()
    comm.Set_attr(_KEY, found)
    return found
