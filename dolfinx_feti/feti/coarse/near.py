# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The coarse columns near each subdomain: its own and those of its neighbours.

Subdomain i sees :math:`c_i` of the columns of all subdomains, and has them as one dense block
:math:`W_i`, (n_i, c_i). With the boolean :math:`C_i` that picks them, coarse matrices are

.. math:: \sum_i C_i^⊤ (W_i^⊤ S_i W_i)\, C_i,

assembled from *element matrices* as finite elements are: the work grows with the number of
subdomains, and no sparse product is needed. The columns of a subdomain go together: its rows have
the same columns in the sum, one group after the other, so that where an entry goes follows from two
groups.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse

from dolfinx_feti.feti.copies import consecutive, star_forest
from dolfinx_feti.torn import create_torn_matrix

__all__ = ["NearColumns", "joined"]

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]


class NearColumns:
    """Which columns are near each subdomain of this process.

    Attributes:
        blocks: Columns of each subdomain among those near all of them, (near,).
    """

    def __init__(self, numbers: Sequence[Numbers], counts: Sequence[int], comm: MPI.Comm) -> None:
        """Find the owners of the columns.

        Args:
            numbers: Numbers of the columns near each subdomain, all or none of an owner's.
            counts: Number of columns of each subdomain's own.
            comm: Communicator.

        Note:
            Collective.
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
        """Assemble an element matrix for each subdomain, (c_i, c_i), into a matrix, (K, K).

        Args:
            elements: The element matrices, one after the other.

        Returns:
            The matrix, distributed as the columns are; the caller destroys it.

        Note:
            Collective.
        """
        owners = [np.unique(self._owner(numbers)) for numbers in self._numbers]
        near = np.unique(joined(owners, np.int64))  # whose columns this process sees
        first, width = self._first[near], np.diff(self._first)[near]
        panels = _neighbours([np.searchsorted(near, of) for of in owners], len(near))
        panel = np.repeat(np.arange(len(near)), np.diff(panels.indptr))  # of each group
        before = _ends(width[panels.indices])  # columns of all panels before each group
        shift = before[:-1] - before[panels.indptr[panel]]  # columns of its own panel before it
        row = _ends(width)  # first row of each panel
        indptr = _ends(np.repeat(np.diff(before[panels.indptr]), width))
        data, places = np.zeros(indptr[-1]), panel * len(near) + panels.indices
        for numbers, element in zip(self._numbers, elements, strict=True):
            of, group = np.unique(self._owner(numbers), return_inverse=True)
            a = np.searchsorted(near, of)
            own = numbers - first[a][group]  # number of each column among its owner's
            at = shift[np.searchsorted(places, a[:, None] * len(near) + a)]
            data[(indptr[row[a][group] + own])[:, None] + at[group][:, group] + own] += element
        columns = np.repeat(row[panels.indices] - before[:-1], width[panels.indices])
        columns += np.arange(before[-1])
        indices = np.empty(len(data), dtype=PETSc.IntType)
        for k, w in enumerate(width):
            rows = indices[indptr[row[k]] : indptr[row[k] + w]].reshape(w, -1)
            rows[:] = columns[slice(*before[panels.indptr[k : k + 2]])]
        csr = (indptr.astype(PETSc.IntType), indices, data)
        K = PETSc.Mat().createAIJWithArrays((row[-1], row[-1]), csr, comm=PETSc.COMM_SELF)
        pairs = zip(first, width, strict=True)
        numbers = joined([np.arange(f, f + w) for f, w in pairs], np.int64)
        torn = create_torn_matrix(K, numbers, (self._size, self._total), comm=self._comm)
        A = PETSc.Mat()
        torn.convert("aij", A)
        torn.destroy()
        K.destroy()
        return A

    def _owner(self, numbers: Numbers) -> Numbers:
        """Return the owner of each column."""
        return np.searchsorted(self._first, numbers, side="right") - 1

    def destroy(self) -> None:
        """Free the star forest."""
        self._forest.destroy()


def _neighbours(seen: Sequence[Numbers], count: int) -> scipy.sparse.csr_array:
    """Return which owners are seen together, (count, count), columns ascending."""
    indptr = _ends(np.array([len(owners) for owners in seen], dtype=np.int64))
    together = joined(seen, np.int64)
    sees = scipy.sparse.csr_array(
        (np.ones(len(together)), together, indptr), shape=(len(seen), count)
    )
    pairs = scipy.sparse.csr_array(sees.T @ sees)
    pairs.sort_indices()
    return pairs


def _ends(sizes: Numbers) -> Numbers:
    """Return 0 and where parts of these sizes, one after the other, end."""
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


def joined(parts: Sequence[npt.NDArray[Any]], dtype: npt.DTypeLike = float) -> npt.NDArray[Any]:
    """Concatenate arrays of one type, of which there may be none."""
    return np.concatenate([np.zeros(0, dtype), *parts], dtype=dtype)
