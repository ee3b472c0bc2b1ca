# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Additive Schwarz for a large coarse matrix N: small systems that overlap.

.. math:: D = \sum_i R_i^⊤ (R_i N R_i^⊤)^{-1} R_i

with the rows :math:`R_i` of subdomain i, and of some others that N couples with it most, by
:math:`\|N_{ij}\|_F`. The systems of a process are those of its subdomains; their inverses are
stored, (b, b) for b rows.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.feti.coarse.near import CoupledSubdomains, expanded
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.collective import on_all

__all__ = ["SchwarzBlocks"]


#: Multiple of the diagonal that is added to the blocks, which may be singular where columns depend.
SHIFT = 1e-8


class SchwarzBlocks:
    """D, by the inverse blocks of this process."""

    def __init__(self, N: PETSc.Mat, graph: CoupledSubdomains, others: int) -> None:
        """Invert the blocks. Collective.

        Args:
            N: Matrix, (K, K), distributed by subdomains.
            graph: Which subdomains it couples.
            others: Subdomains of a block beside its own one.

        Raises:
            LinAlgError: A block is not positive definite; on all processes.
        """
        rows = list(_rows(N, graph, others))
        near = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *rows]))
        index = PETSc.IS().createGeneral(near.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        (copied,) = N.createSubMatrices([index])
        indptr, indices, values = copied.getValuesCSR()
        local = scipy.sparse.csr_array((values, indices, indptr), (len(near), len(near)))
        places = [np.searchsorted(near, own) for own in rows]
        self._blocks = on_all(lambda: list(_inverses(local, places)), N.comm.tompi4py())
        self._near = PETSc.Vec().createSeq(len(near), comm=PETSc.COMM_SELF)
        r = N.createVecRight()
        self._scatter = PETSc.Scatter().create(r, index, self._near, None)
        for owned in (copied, index, r):
            owned.destroy()

    def apply(self, r: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = D r. Collective."""
        self._scatter.scatter(r, self._near, mode=PETSc.ScatterMode.FORWARD)
        x = self._near.array_r
        parts = [(inverse @ x[places][:, :, None]).ravel() for places, inverse in self._blocks]
        to = [places.ravel() for places, _ in self._blocks]
        if parts:
            sums = np.bincount(np.concatenate(to), np.concatenate(parts), minlength=len(x))
            self._near.array[:] = sums  # those that overlap are added
        y.set(0.0)
        backward, add = PETSc.ScatterMode.REVERSE, PETSc.InsertMode.ADD_VALUES
        self._scatter.scatter(self._near, y, addv=add, mode=backward)

    @property
    def nbytes(self) -> int:
        """Memory of the blocks of this process in bytes."""
        return sum(inverse.nbytes + places.nbytes for places, inverse in self._blocks)

    def destroy(self) -> None:
        """Free vector and scatter."""
        self._scatter.destroy()
        self._near.destroy()


def _rows(N: PETSc.Mat, graph: CoupledSubdomains, others: int) -> Iterator[Numbers]:
    """Yield the rows of each block of this process, ascending, (b,)."""
    start, size = graph.starts[:-1], np.diff(graph.starts)
    for i, near in enumerate(_nearest(N, graph, others)):
        if size[graph.first + i]:
            subdomains = np.append(near, graph.first + i)
            yield np.sort(expanded(start[subdomains], size[subdomains]))


def _nearest(N: PETSc.Mat, graph: CoupledSubdomains, others: int) -> list[Numbers]:
    """Return the subdomains that N couples most with each one of this process, (up to others,)."""
    first, last = N.getOwnershipRange()
    own, total = len(graph.indptr) - 1, len(graph.starts) - 1
    if not others:
        return [graph.indices[:0]] * own
    of_row = np.repeat(np.arange(total), np.diff(graph.starts))
    indptr, indices, values = N.getValuesCSR()
    squares = scipy.sparse.csr_array((values**2, indices, indptr), (last - first, len(of_row)))
    ends = np.arange(len(of_row) + 1)
    columns = scipy.sparse.csr_array((np.ones(len(of_row)), of_row, ends), (len(of_row), total))
    rows = columns[first:last, graph.first : graph.first + own].T
    strength = scipy.sparse.csr_array(rows @ squares @ columns)  # ‖N_ij‖_F²
    found = []
    for i, (begin, end) in enumerate(itertools.pairwise(strength.indptr.tolist())):
        near, squared = strength.indices[begin:end], strength.data[begin:end]
        near = near[np.argsort(-squared, kind="stable")]
        found.append(near[near != graph.first + i][:others].astype(np.int64))
    return found


def _inverses(
    local: scipy.sparse.csr_array, rows: list[Numbers]
) -> Iterator[tuple[Numbers, Array]]:
    """Yield rows and inverses of all blocks of each size b, (blocks, b) and (blocks, b, b).

    Raises:
        LinAlgError: A block is not positive definite.
    """
    size = np.array([len(own) for own in rows], dtype=np.int64)
    for b in np.unique(size):
        alike = np.stack([rows[i] for i in np.flatnonzero(size == b)])
        blocks = np.stack([local[own][:, own].toarray() for own in alike])
        np.einsum("ibb->ib", blocks)[:] *= 1.0 + SHIFT
        np.linalg.cholesky(blocks)
        yield alike, np.asarray(np.linalg.inv(blocks), dtype=np.float64)
