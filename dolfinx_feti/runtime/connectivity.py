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
import scipy.sparse
import scipy.sparse.csgraph

from dolfinx_feti.runtime.arrays import Indices
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.native import load, pointer
from dolfinx_feti.runtime.petsc_library import Rows, rows_of

__all__ = [
    "block_graph",
    "connected_blocks",
    "copy_forest",
    "coupled_nodes",
    "diagonal_places",
    "has_joined_copies",
    "is_symmetric",
    "load_graph_code",
]


DECLARATION = """
int couple_nodes(int, int, const int *, const int *, const int *, const int *, const int *,
                 int, int *, int *, int *);
"""

#: What assembly and condensation may take from the symmetry of a matrix, entry by entry: with κ/μ
#: of 10⁶ it is up to 7e-12 (P2) and 3e-13 (P2–P0).
ROUNDING = 1e-10


def load_graph_code(comm: MPI.Comm) -> Any:
    """Load ``connectivity.c``, compiled at first use. Collective."""
    return load(Path(__file__).with_name("connectivity.c"), DECLARATION, comm)


def is_symmetric(A: PETSc.Mat) -> bool:
    """Tell whether the matrices K_i of all subdomains are symmetric: as is known, or as they look.

    Up to rounding, that is, entry by entry: |a_ij − a_ji| ≤ 1e-10 s_i s_j, s_i² = |a_ii|, and no
    less than 1e-8 max_j |a_ij|. Against ‖K‖, which is κ's, the skew part of a small load would be
    nothing, though it is what the load does. The assembled matrix may be symmetric where the K_i
    are not, as with the full tangent of a pressure whose rim is clamped.

    Args:
        A: Torn matrix. What is known of its local matrix is PETSc's flag.

    Note:
        Collective.
    """
    comm, K = A.comm.tompi4py(), A.getISLocalMat()
    known, symmetric = K.isSymmetricKnown()
    here = on_all(lambda: symmetric if known else _looks_symmetric(K), comm)
    return bool(comm.allreduce(here, op=MPI.LAND))


def _looks_symmetric(K: PETSc.Mat) -> bool:
    """Tell whether the entries of a sequential AIJ matrix, perhaps empty, equal their mirrors."""
    if not K.getSize()[0]:
        return True
    with rows_of(K) as of_K:
        A = scipy.sparse.csr_array((of_K.values, of_K.indices, of_K.indptr), K.getSize())
        most = np.abs(A).max(axis=1).toarray().ravel()
        s = np.sqrt(np.maximum(np.abs(A.diagonal()), 1e-8 * most))
        skew = (A - A.T.tocsr()).tocoo()
        return bool(np.all(np.abs(skew.data) <= ROUNDING * s[skew.row] * s[skew.col]))


def connected_blocks(graph: scipy.sparse.csr_array, bs: int) -> list[Indices]:
    """Return the rows of each connected component, ascending, in the order of their first row.

    Args:
        graph: Which blocks of dofs a matrix couples, symmetric, (n / bs, n / bs).
        bs: Size of these blocks.
    """
    if graph.shape[0] == 0:
        return []
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    label = np.repeat(label, bs)
    order = np.argsort(label, kind="stable").astype(np.int32)
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def has_joined_copies(A: PETSc.Mat, subdomains: list[Indices]) -> bool:
    """Tell whether a subdomain holds two copies of one dof, on any process. Collective.

    Args:
        A: Torn matrix.
        subdomains: For each subdomain its torn dofs.
    """
    dofs = A.getLGMap()[0].getIndices()
    joined = any(len(np.unique(dofs[rows])) < len(rows) for rows in subdomains)
    return bool(A.comm.tompi4py().allreduce(joined, op=MPI.LOR))


def block_graph(K: PETSc.Mat, code: Any) -> scipy.sparse.csr_array:
    """Return which blocks of dofs a matrix couples, (n / bs, n / bs).

    Args:
        K: Sequential AIJ matrix, (n, n), of block size bs.
        code: What :func:`load_graph_code` returns.
    """
    n, bs = K.getSize()[0], K.getBlockSize()
    m, rows = n // bs, np.arange(n, dtype=np.int32)
    with rows_of(K) as of_K:
        indptr, indices = coupled_nodes(code, of_K, rows, rows, rows // bs, m)
    return scipy.sparse.csr_array((np.ones(len(indices), dtype=bool), indices, indptr), (m, m))


def diagonal_places(K: PETSc.Mat) -> Indices:
    """Return where the entries on the diagonal of a sequential AIJ matrix stand among all, (n,).

    It is −1 for a row without one.
    """
    n = K.getSize()[0]
    place = np.full(n, -1, dtype=np.int32)
    with rows_of(K) as of_K:
        row = np.repeat(np.arange(n, dtype=np.int32), np.diff(of_K.indptr))
        on_diagonal = np.flatnonzero(of_K.indices == row)
        place[row[on_diagonal]] = on_diagonal
    return place


def coupled_nodes(
    code: Any, K: Rows, rows: Indices, number: Indices, node: Indices, m: int
) -> tuple[Indices, Indices]:
    """Return the graph of nodes, groups of consecutive rows: its rows and columns, unsorted.

    Args:
        code: What :func:`load_graph_code` returns.
        K: A symmetric matrix, (n, n).
        rows: Rows that count, ascending, (k,).
        number: For each column its place among these rows, or a negative number, (n,).
        node: Node of each of these rows, ascending from 0 to m − 1, (k,).
        m: Number of nodes.

    Raises:
        ValueError: The rows, numbers or nodes do not belong to this matrix.
    """

    def to(array: Indices) -> Any:
        return pointer(code, array)

    n, entries = len(K.indptr) - 1, -1
    sizes = (m + 1, m, int(K.indptr[n]))
    ptr, mark, adjacent = (np.empty(size, dtype=np.int32) for size in sizes)
    if len(number) == n and len(node) == len(rows):
        arrays = map(to, (rows, K.indptr, K.indices, number, node))
        results = map(to, (ptr, adjacent, mark))
        entries = code.lib.couple_nodes(n, len(rows), *arrays, m, *results)
    if entries < 0:
        raise ValueError(
            f"the rows, numbers or nodes do not belong to this matrix, ({n}, {n}): rows and nodes "
            "have to ascend, and columns of the matrix to be among the rows or to have no number"
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
