# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the pattern of a torn matrix tells: its blocks, and the copies of its dofs; and symmetry."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse
import scipy.sparse.csgraph

from dolfinx_feti.native import load_or_do_without, pointer
from dolfinx_feti.petsc_library import Rows, rows_of

__all__ = [
    "block_graph",
    "connected_blocks",
    "copy_forest",
    "coupled_nodes",
    "is_symmetric",
    "load_graph_code",
]

Indices = npt.NDArray[np.int32]

DECLARATION = """
int couple_nodes(int, const int *, const int *, const int *, const int *, const int *, int, int *,
                 int *, int *);
"""


def load_graph_code(comm: MPI.Comm) -> Any | None:
    """Load ``connectivity.c``, compiled at first use; None if it cannot be compiled. Collective."""
    return load_or_do_without(Path(__file__).with_name("connectivity.c"), DECLARATION, comm)


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


def block_graph(K: PETSc.Mat, code: Any | None) -> scipy.sparse.csr_array:
    """Return which blocks of dofs a matrix couples, (n / bs, n / bs).

    Args:
        K: Sequential AIJ matrix, (n, n), of block size bs.
        code: What :func:`load_graph_code` returns; without it the work takes ten times as long.
    """
    n, bs = K.getSize()[0], K.getBlockSize()
    m, rows = n // bs, np.arange(n, dtype=np.int32)
    with rows_of(K) as of_K:
        if code is not None:
            indptr, indices = coupled_nodes(code, of_K, rows, rows, rows // bs, m)
        else:
            there = np.ones(of_K.indptr[-1], dtype=bool)
            entries = (there, of_K.indices, of_K.indptr)
            blocks = scipy.sparse.csr_array(entries, (n, n)).tobsr((bs, bs))
            indptr, indices = blocks.indptr, blocks.indices
    return scipy.sparse.csr_array((np.ones(len(indices), dtype=bool), indices, indptr), (m, m))


def coupled_nodes(
    code: Any, K: Rows, rows: Indices, number: Indices, node: Indices, m: int
) -> tuple[Indices, Indices]:
    """Return the graph of nodes, groups of consecutive rows: its rows and columns, unsorted.

    Args:
        code: What :func:`load_graph_code` returns.
        K: A symmetric matrix, (n, n).
        rows: Rows that count, (k,).
        number: For each column its place among these rows, or a negative number, (n,).
        node: Node of each of these rows, ascending, (k,).
        m: Number of nodes.
    """

    def to(array: Indices) -> Any:
        return pointer(code, array)

    most = int((K.indptr[rows + 1] - K.indptr[rows]).sum())
    ptr, mark, adjacent = (np.empty(k, dtype=np.int32) for k in (m + 1, m, most))
    entries = code.lib.couple_nodes(
        len(rows),
        *map(to, (rows, K.indptr, K.indices, number, node)),
        m,
        *map(to, (ptr, adjacent, mark)),
    )
    return ptr, adjacent[:entries].copy()


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
