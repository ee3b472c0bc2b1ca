# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The pattern of a torn matrix: coupled blocks, connected components, copies, diagonal."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from dolfinx_feti.runtime.arrays import Indices
from dolfinx_feti.runtime.petsc_library import CSRMatrix, csr_of


def block_graph(K: CSRMatrix, bs: int) -> scipy.sparse.csr_array:
    """Return which blocks of bs dofs a matrix couples.

    Args:
        K: The matrix, (n, n).
        bs: Dofs of a block.

    Returns:
        True for each pair of coupled blocks, (n / bs, n / bs).
    """
    n = len(K.indptr) - 1
    ones = np.ones(len(K.indices), dtype=np.int8)
    blocks = scipy.sparse.csr_array((ones, K.indices, K.indptr), (n, n)).tobsr((bs, bs))
    ones = np.ones(len(blocks.indices), dtype=bool)
    arrays = (ones, blocks.indices.copy(), blocks.indptr.copy())
    return scipy.sparse.csr_array(arrays, (n // bs, n // bs))


def rows_of_components(graph: scipy.sparse.csr_array, bs: int) -> list[Indices]:
    """Return the rows of each connected component of a matrix, whose dofs come in blocks.

    Args:
        graph: Which blocks the matrix couples, (n / bs, n / bs). An entry couples its row and
            column even if the pattern is not symmetric.
        bs: Dofs of a block.

    Returns:
        For each component its rows, ascending; components in the order of their first row.
    """
    if graph.shape[0] == 0:
        return []
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    label = np.repeat(label, bs)
    order = np.argsort(label, kind="stable").astype(np.int32)
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def has_repeated_dofs(A: PETSc.Mat, subdomains: list[Indices]) -> bool:
    """Return True if some subdomain has two copies of one dof. Collective.

    This happens if entries of the local matrix couple two subdomains that share a dof: the two are
    then one component of its graph.

    Args:
        A: The torn matrix.
        subdomains: Torn dofs of each subdomain of this process, as local rows of A.
    """
    dofs = A.getLGMap()[0].getIndices()
    is_repeated = any(len(np.unique(dofs[rows])) < len(rows) for rows in subdomains)
    return bool(A.comm.tompi4py().allreduce(is_repeated, op=MPI.LOR))


def diagonal_places(K: PETSc.Mat) -> Indices:
    """Return the place of each diagonal entry among the stored entries of a sequential AIJ matrix.

    Returns:
        Places, (n,); −1 for a diagonal entry outside of the pattern.
    """
    n = K.getSize()[0]
    place = np.full(n, -1, dtype=np.int32)
    with csr_of(K) as csr:
        row = np.repeat(np.arange(n, dtype=np.int32), np.diff(csr.indptr))
        on_diagonal = np.flatnonzero(csr.indices == row)
        place[row[on_diagonal]] = on_diagonal
    return place
