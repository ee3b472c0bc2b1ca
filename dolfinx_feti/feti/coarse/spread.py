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

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

__all__ = ["SpreadInverse", "number_of_groups"]

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]


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
        pairs, home = _pairs(comm.size)
        self._groups = [
            _Group(number, starts, pairs, home, comm) for number in sorted(set(pairs[comm.rank]))
        ]
        blocks = [group.collect(rows) for group in self._groups]
        self._blocks = blocks if len(pairs[comm.rank]) == 2 else []
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
        pairs = zip(self._groups, sums, strict=True)
        summing = [group.sum(part) for group, part in pairs]
        MPI.Request.Waitall([request for request, _ in summing])
        return np.concatenate([own for _, own in summing])  # there are rows in one group alone

    def destroy(self) -> None:
        """Free the communicators."""
        for group in self._groups:
            group.comm.Free()


class _Group:
    """The processes that multiply with the rows or columns of a group, and have these rows.

    Attributes:
        comm: Their communicator.
    """

    def __init__(
        self,
        number: int,
        starts: Counts,
        pairs: list[tuple[int, ...]],
        home: list[int],
        world: MPI.Intracomm,
    ) -> None:
        """Find its members and their rows. Collective on them, in the order of the groups."""
        members = [rank for rank, pair in enumerate(pairs) if number in pair]
        group = world.Get_group()
        those = group.Incl(members)
        self.comm = world.Create_group(those, number)
        those.Free()
        group.Free()
        size = np.diff(starts)
        self._counts = [int(size[rank]) * (home[rank] == number) for rank in members]
        self._own = self._counts[self.comm.rank]

        def columns(pair: tuple[int, ...]) -> Counts:
            if len(pair) == 1:
                return starts[:0]
            other = sum(pair) - number
            own = [np.arange(*starts[r : r + 2]) for r, at in enumerate(home) if at == other]
            return np.concatenate(own)

        self._columns = [columns(pairs[rank]) for rank in members]  # of the block of each

    def collect(self, rows: Array) -> Array:
        """Return the block of this group's rows and the other's columns. Collective.

        Args:
            rows: Own rows of N⁻¹, (own rows, K).
        """
        width = [len(columns) for columns in self._columns]
        mine = width[self.comm.rank]
        own = rows[: self._own]
        sent = np.concatenate([own[:, columns].ravel() for columns in self._columns])
        counts = [self._own * columns for columns in width], [rows * mine for rows in self._counts]
        block = np.empty((sum(self._counts), mine))
        self.comm.Alltoallv((sent, counts[0]), (block, counts[1]))
        return block

    def gather(self, b: Array) -> tuple[MPI.Request, Array]:
        """Begin to gather b of this group from own rows, (own rows,)."""
        whole = np.empty(sum(self._counts))
        return self.comm.Iallgatherv(b[: self._own], (whole, self._counts)), whole

    def sum(self, part: Array) -> tuple[MPI.Request, Array]:
        """Begin to sum x of this group, and to hand out its rows."""
        own = np.empty(self._own)
        return self.comm.Ireduce_scatter(part, own, self._counts, MPI.SUM), own


def number_of_groups(processes: int) -> int:
    """Return the most groups for whose pairs there are processes, g (g + 1)/2 ≤ P."""
    return (math.isqrt(8 * processes + 1) - 1) // 2


def _pairs(processes: int) -> tuple[list[tuple[int, ...]], list[int]]:
    """Return the groups I ≤ J of each process, or one without a block, and where it is at home."""
    g = number_of_groups(processes)
    pairs: list[tuple[int, ...]] = [(i, j) for j in range(g) for i in range(j + 1)]
    home = [i if (j - i) % 2 else j for i, j in pairs]  # half of the pairs of each group
    further = [rank % g for rank in range(len(pairs), processes)]
    return pairs + [(i,) for i in further], home + further
