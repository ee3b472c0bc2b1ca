# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The coarse columns near each subdomain: its own and those of its neighbours.

Subdomain i has :math:`c_i` of the columns of all subdomains as one dense block :math:`W_i`,
(n_i, c_i). With the boolean :math:`C_i` that picks them, coarse matrices are assembled from
*element matrices* as in the finite element method,

.. math:: \sum_i C_i^⊤ (W_i^⊤ S_i W_i)\, C_i.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse

from dolfinx_feti.feti.coarse.fields import Fields
from dolfinx_feti.feti.gluing.copies import consecutive, star_forest
from dolfinx_feti.feti.subdomain.blocks import on_subdomains
from dolfinx_feti.runtime.arrays import Array, Integers, Numbers
from dolfinx_feti.runtime.native import load, pointer
from dolfinx_feti.torn.matrix import create_torn_matrix

DECLARATIONS = """
int add_element(int, const int *, const double *, const int *, const int *, const int *,
                const int *, const int64_t *, double *);
"""


class NearColumns:
    """Which columns are near each subdomain of this process.

    Attributes:
        blocks: Columns of each subdomain among those near all of them, (near,).
        near: Number of these.
    """

    def __init__(self, W: Fields, counts: Sequence[int], comm: MPI.Comm) -> None:
        """Find the owners of the columns W; each subdomain has so many of its own. Collective."""
        self._comm, self._owners = comm, W.owners
        self._code = load(Path(__file__).with_name("near.c"), DECLARATIONS, comm)
        self._size = sum(counts)
        self._total = comm.allreduce(self._size)
        sizes = [panels.shape[1] for panels in W.panels]
        self.blocks, self.near = consecutive(sizes), sum(sizes)
        self._owner = joined(W.owners, np.int64)  # of each panel, and its columns
        self._count = joined([panels.count for panels in W.panels], np.int32)
        self._forest = star_forest(_expanded(self._owner, self._count), self._size, comm)

    def to_owners(self, near: Array) -> Array:
        """Sum what subdomains have for the columns near them, (near,), at the owners, (size,)."""
        own, leaves = np.zeros(self._size), np.ascontiguousarray(near)
        self._forest.reduceBegin(MPI.DOUBLE, leaves, own, MPI.SUM)
        self._forest.reduceEnd(MPI.DOUBLE, leaves, own, MPI.SUM)
        return own

    def from_owners(self, own: Array) -> Array:
        """Hand the owners' values, (size,), to the columns near each subdomain, (near,)."""
        near, root = np.zeros(self.near), np.ascontiguousarray(own)
        self._forest.bcastBegin(MPI.DOUBLE, root, near, MPI.REPLACE)
        self._forest.bcastEnd(MPI.DOUBLE, root, near, MPI.REPLACE)
        return near

    def sum(self, elements: Iterable[Array]) -> PETSc.Mat:
        """Assemble an element matrix of each subdomain, (c_i, c_i), into one, (K, K). Collective.

        What the elements of a process raise, all processes raise.
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
        to, add = partial(pointer, self._code), self._code.lib.add_element
        first, local = np.unique(self._owner, return_inverse=True)  # owners near this process
        owner, width = local.astype(np.int32), np.zeros(len(first), dtype=np.int32)
        width[owner] = self._count
        panels = consecutive([len(of_subdomain) for of_subdomain in self._owners])
        near = scipy.sparse.csr_array(
            (np.ones(len(owner), dtype=np.int32), owner, [0, *(each.stop for each in panels)]),
            (len(panels), len(first)),
        )
        graph = scipy.sparse.csr_array(near.T @ near)  # owners that are near one subdomain
        graph.sort_indices()
        ptr, adjacent = (a.astype(np.int32, copy=False) for a in (graph.indptr, graph.indices))
        places = np.cumsum(width[adjacent]) - width[adjacent]
        length = np.diff(np.append(places, width[adjacent].sum())[ptr])  # of a row of each owner
        place = (places - np.repeat(places[ptr[:-1]], np.diff(ptr))).astype(np.int32)
        start = np.cumsum(np.append(0, width * length))
        rows = tuple(map(to, (width, ptr, adjacent, place, start)))
        values = np.zeros(start[-1])
        for i, element in enumerate(elements):
            size = self.blocks[i].stop - self.blocks[i].start
            if element.shape != (size, size):
                raise ValueError(f"element matrix {i} is {element.shape}, not ({size}, {size})")
            E, own = np.ascontiguousarray(element), owner[panels[i]]
            if add(len(own), to(own), to(E), *rows, to(values)):
                raise ValueError(f"element matrix {i} couples owners that are not neighbours")
        indices = np.empty(len(values), dtype=np.int32)
        columns = _expanded((np.cumsum(width) - width)[adjacent], width[adjacent])
        row = np.split(columns, np.cumsum(length)[:-1]) if len(length) else []
        for a, there in enumerate(row):  # all rows of an owner have the same columns
            indices[start[a] : start[a + 1]].reshape(-1, max(1, len(there)))[:] = there
        n = int(width.sum())
        indptr = np.append(0, np.cumsum(np.repeat(length, width)))
        csr = tuple(array.astype(PETSc.IntType, copy=False) for array in (indptr, indices))
        K = PETSc.Mat().createAIJWithArrays((n, n), (*csr, values), comm=PETSc.COMM_SELF)
        return K, _expanded(first, width)

    def destroy(self) -> None:
        """Free the star forest."""
        self._forest.destroy()


def joined(parts: Sequence[npt.NDArray[Any]], dtype: npt.DTypeLike = float) -> npt.NDArray[Any]:
    """Concatenate arrays of one type, of which there may be none."""
    return np.concatenate([np.zeros(0, dtype), *parts], dtype=dtype)


def _expanded(first: Integers, count: Integers) -> Numbers:
    """Return the numbers of columns, ``count`` of them from each ``first`` on."""
    end = np.cumsum(count)
    return np.arange(count.sum()) + np.repeat(first - end + count, count)
