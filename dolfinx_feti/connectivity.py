# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the pattern of a torn matrix tells: its blocks, and the copies of its dofs; and symmetry."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse
import scipy.sparse.csgraph

__all__ = ["block_graph", "connected_blocks", "copy_forest", "is_symmetric"]

Indices = npt.NDArray[np.int32]


def is_symmetric(K: PETSc.Mat) -> bool:
    """Test xᵀ K y = yᵀ K x for one pair of random vectors, up to rounding.

    Note:
        Collective on K.
    """
    x, y = K.createVecs()
    Kx, Ky = x.duplicate(), x.duplicate()
    x.array[:], y.array[:] = np.random.default_rng(20140715).standard_normal((2, x.getLocalSize()))
    K.mult(x, Kx)
    K.mult(y, Ky)
    skew = abs(y.dot(Kx) - x.dot(Ky))
    scale = max(Kx.norm() * y.norm(), Ky.norm() * x.norm())
    for v in (x, y, Kx, Ky):
        v.destroy()
    return bool(skew <= 1e-10 * scale)


def connected_blocks(graph: scipy.sparse.csr_array, bs: int) -> list[Indices]:
    """Find the connected components of a block-diagonal matrix.

    Args:
        graph: Which blocks of dofs the matrix couples, symmetric, (n / bs, n / bs).
        bs: Size of these blocks.

    Returns:
        For each component its rows, ascending; components in the order of their first row.
    """
    if graph.shape[0] == 0:
        return []
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    label = np.repeat(label, bs)
    order = np.argsort(label, kind="stable").astype(np.int32)
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def block_graph(K: PETSc.Mat) -> scipy.sparse.csr_array:
    """Return which blocks of dofs a matrix couples, (n / bs, n / bs).

    Args:
        K: Sequential AIJ matrix, (n, n), of block size bs.
    """
    n, bs = K.getSize()[0], K.getBlockSize()
    indptr, indices = K.getRowIJ()
    entries = scipy.sparse.csr_array((np.ones(len(indices), dtype=bool), indices, indptr), (n, n))
    graph = _graph_of_full_blocks(entries, bs)
    if graph is None:
        blocks = entries.tobsr((bs, bs))
        there = np.ones(len(blocks.indices), dtype=bool)
        graph = scipy.sparse.csr_array((there, blocks.indices, blocks.indptr), (n // bs, n // bs))
    return graph


def _graph_of_full_blocks(
    entries: scipy.sparse.csr_array, bs: int
) -> scipy.sparse.csr_array | None:
    """Read the graph off the first row of each block; None if some block is not full."""
    width = np.diff(entries.indptr).reshape(-1, bs)
    first = entries[::bs].indices
    if np.any(width != width[:, :1]) or np.any(width % bs):
        return None
    columns = first.reshape(-1, bs)
    full = np.all(columns == columns[:, :1] + np.arange(bs)) and not np.any(columns[:, 0] % bs)
    if not full or any(np.any(entries[j::bs].indices != first) for j in range(1, bs)):
        return None
    indptr = np.concatenate([[0], np.cumsum(width[:, 0] // bs)])
    there = np.ones(len(columns), dtype=bool)
    return scipy.sparse.csr_array((there, columns[:, 0] // bs, indptr), (len(width), len(width)))


def copy_forest(A: PETSc.Mat) -> PETSc.SF:
    """Build the star forest with the dofs as roots and their torn copies as leaves."""
    lgmap = A.getLGMap()[0]
    dofs = lgmap.getIndices()
    ranges = A.getOwnershipRanges()
    rank = np.searchsorted(ranges, dofs, side="right") - 1
    remote = np.column_stack([rank, dofs - ranges[rank]]).astype(PETSc.IntType)
    forest = PETSc.SF().create(A.comm)
    forest.setGraph(A.getLocalSize()[0], None, remote)
    return forest
