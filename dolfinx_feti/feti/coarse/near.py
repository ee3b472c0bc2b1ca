# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The coarse columns near each subdomain: its own and those of its neighbours.

Subdomain i has :math:`c_i` of the columns of all subdomains as one dense block :math:`W_i`,
(n_i, c_i). With the boolean :math:`C_i` that picks them, coarse matrices are assembled from
*element matrices* as in the finite element method,

.. math:: \sum_i C_i^⊤ (W_i^⊤ S_i W_i)\, C_i.

All columns of a subdomain are near another one or none: its rows in the sum have the same columns.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.gluing.copies import consecutive, star_forest
from dolfinx_feti.feti.subdomain.blocks import on_subdomains
from dolfinx_feti.torn.matrix import create_torn_matrix

__all__ = ["NearColumns", "joined"]

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]


class NearColumns:
    """Which columns are near each subdomain of this process.

    Attributes:
        blocks: Columns of each subdomain among those near all of them, (near,).
    """

    def __init__(self, numbers: Sequence[Numbers], counts: Sequence[int], comm: MPI.Comm) -> None:
        """Find the owners of the columns. Collective.

        Args:
            numbers: Numbers of the columns near each subdomain, all or none of an owner's.
            counts: Number of columns of each subdomain's own.
            comm: Communicator.
        """
        self._comm = comm
        self._numbers = list(numbers)
        self._size = sum(counts)
        self._total = comm.allreduce(self._size)
        every = np.concatenate(comm.allgather(np.array(counts, dtype=np.int64)))
        self._first = np.concatenate(([0], np.cumsum(every[every > 0])))  # of each owner, and end
        self.blocks = consecutive([len(near) for near in self._numbers])
        self._forest = star_forest(joined(self._numbers, np.int64), self._size, comm)

    def to_owners(self, near: Array) -> Array:
        """Sum what subdomains have for the columns near them, (near,), at the owners, (size,)."""
        own, leaves = np.zeros(self._size), np.ascontiguousarray(near)
        self._forest.reduceBegin(MPI.DOUBLE, leaves, own, MPI.SUM)
        self._forest.reduceEnd(MPI.DOUBLE, leaves, own, MPI.SUM)
        return own

    def from_owners(self, own: Array) -> Array:
        """Hand the owners' values, (size,), to the columns near each subdomain, (near,)."""
        near, root = np.zeros(self.blocks[-1].stop if self.blocks else 0), np.ascontiguousarray(own)
        self._forest.bcastBegin(MPI.DOUBLE, root, near, MPI.REPLACE)
        self._forest.bcastEnd(MPI.DOUBLE, root, near, MPI.REPLACE)
        return near

    def sum(self, elements: Iterable[Array]) -> PETSc.Mat:
        """Assemble an element matrix of each subdomain, (c_i, c_i), into one, (K, K). Collective.

        Args:
            elements: The element matrices, one after the other; none is kept. Not collective.

        Raises:
            Exception: What the elements of a process raise, on all processes.
        """
        K, numbers = on_subdomains(lambda: self._sum_of_own(elements), self._comm)
        torn = create_torn_matrix(K, numbers, (self._size, self._total), comm=self._comm)
        A = PETSc.Mat()
        torn.convert("aij", A)
        torn.destroy()
        K.destroy()
        return A

    def _sum_of_own(self, elements: Iterable[Array]) -> tuple[PETSc.Mat, Numbers]:
        """Sum the element matrices of this process; return the numbers of the columns, too."""
        reached: dict[int, list[Numbers]] = {}  # by the rows of each owner
        for numbers in self._numbers:
            for a, _ in self._owners(numbers):
                reached.setdefault(a, []).append(numbers)
        columns = {a: np.unique(np.concatenate(reached[a])) for a in sorted(reached)}
        width = np.diff(self._first)
        rows = {a: np.zeros((width[a], len(columns[a]))) for a in columns}
        for numbers, element in zip(self._numbers, elements, strict=True):
            for a, own in self._owners(numbers):
                rows[a][:, np.searchsorted(columns[a], numbers)] += element[own]
        every = joined([np.arange(*self._first[a : a + 2]) for a in columns], np.int64)
        local = [np.searchsorted(every, columns[a]) for a in columns]
        indices = [np.tile(c, width[a]) for a, c in zip(columns, local, strict=True)]
        length = joined([np.full(width[a], len(columns[a])) for a in columns], np.int64)
        indptr = np.concatenate([[0], np.cumsum(length)]).astype(PETSc.IntType)
        csr = (indptr, joined(indices, PETSc.IntType), joined([R.ravel() for R in rows.values()]))
        n = len(every)
        return PETSc.Mat().createAIJWithArrays((n, n), csr, comm=PETSc.COMM_SELF), every

    def _owners(self, numbers: Numbers) -> list[tuple[int, slice]]:
        """Return the owners of columns, and where theirs are."""
        owner = np.searchsorted(self._first, numbers, side="right") - 1
        starts = np.flatnonzero(np.diff(owner, prepend=-1))
        places = [slice(*part) for part in itertools.pairwise([*starts, len(numbers)])]
        return list(zip(map(int, owner[starts]), places, strict=True))

    def destroy(self) -> None:
        """Free the star forest."""
        self._forest.destroy()


def joined(parts: Sequence[npt.NDArray[Any]], dtype: npt.DTypeLike = float) -> npt.NDArray[Any]:
    """Concatenate arrays of one type, of which there may be none."""
    return np.concatenate([np.zeros(0, dtype), *parts], dtype=dtype)
