# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the pattern of a torn matrix tells: its blocks, and the copies of its dofs; and symmetry."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from dolfinx_feti.runtime.arrays import Indices
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.petsc_library import Rows, product, rows_of

#: What assembly and condensation may take from the symmetry of a matrix, entry by entry: with κ/μ
#: of 10⁶ it is up to 7e-12 (P2) and 3e-13 (P2–P0).
ROUNDING = 1e-10

#: The same of a row's sum with random weights, which leaves no doubt about its entries.
NO_DOUBT = 1e-12


def is_symmetric(A: PETSc.Mat) -> bool:
    """Tell whether the matrices K_i of all subdomains are symmetric: as PETSc knows, or they look.

    Up to rounding, that is, entry by entry: |a_ij − a_ji| ≤ 1e-10 s_i s_j, s_i² = |a_ii|, and no
    less than 1e-8 max_j |a_ij|. Against ‖K‖, which is κ's, the skew part of a small load would be
    nothing. The assembled matrix may be symmetric where the K_i are not, as with the full tangent
    of a pressure whose rim is clamped. Collective.
    """
    comm, K = A.comm.tompi4py(), A.getISLocalMat()
    known, symmetric = K.isSymmetricKnown()
    here = on_all(lambda: symmetric if known else _looks_symmetric(K), comm)
    return bool(comm.allreduce(here, op=MPI.LAND))


def _looks_symmetric(K: PETSc.Mat) -> bool:
    """Tell whether the entries of a sequential AIJ matrix, perhaps empty, equal their mirrors.

    Products with random weights ω tell fast, |(K − Kᵀ) s⁻¹ ω| ≤ 1e-12 s, or all entries do.
    """
    n = K.getSize()[0]
    if not n:
        return True
    s = np.sqrt(np.abs(K.getDiagonal().array_r))
    if s.all():
        x = np.random.default_rng(n).uniform(1.0, 2.0, n) / s
        sums = product(K, x) - product(K, x, transpose=True)
        if np.all(np.abs(sums) <= NO_DOUBT * s):
            return True
    with rows_of(K) as of_K:
        A = scipy.sparse.csr_array((of_K.values, of_K.indices, of_K.indptr), K.getSize())
        most = np.abs(A).max(axis=1).toarray().ravel()
        s = np.sqrt(np.maximum(s**2, 1e-8 * most))
        skew = (A - A.T.tocsr()).tocoo()
        return bool(np.all(np.abs(skew.data) <= ROUNDING * s[skew.row] * s[skew.col]))


def block_graph(K: Rows, bs: int) -> scipy.sparse.csr_array:
    """Return which blocks of bs dofs a matrix, (n, n), couples, (n / bs, n / bs)."""
    n, ones = len(K.indptr) - 1, np.ones(len(K.indices), dtype=np.int8)
    blocks = scipy.sparse.csr_array((ones, K.indices, K.indptr), (n, n)).tobsr((bs, bs))
    ones = np.ones(len(blocks.indices), dtype=bool)
    arrays = (ones, blocks.indices.copy(), blocks.indptr.copy())
    return scipy.sparse.csr_array(arrays, (n // bs, n // bs))


def connected_blocks(graph: scipy.sparse.csr_array, bs: int) -> list[Indices]:
    """Return the rows of each connected component, ascending, in the order of their first row.

    The graph tells which blocks of bs dofs a matrix couples, symmetric, (n / bs, n / bs).
    """
    if graph.shape[0] == 0:
        return []
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    label = np.repeat(label, bs)
    order = np.argsort(label, kind="stable").astype(np.int32)
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def has_joined_copies(A: PETSc.Mat, subdomains: list[Indices]) -> bool:
    """Tell whether the torn dofs of a subdomain hold two copies of a dof, anywhere. Collective."""
    dofs = A.getLGMap()[0].getIndices()
    joined = any(len(np.unique(dofs[rows])) < len(rows) for rows in subdomains)
    return bool(A.comm.tompi4py().allreduce(joined, op=MPI.LOR))


def diagonal_places(K: PETSc.Mat) -> Indices:
    """Return where the diagonal of a sequential matrix is among all entries, (n,); −1: absent."""
    n = K.getSize()[0]
    place = np.full(n, -1, dtype=np.int32)
    with rows_of(K) as of_K:
        row = np.repeat(np.arange(n, dtype=np.int32), np.diff(of_K.indptr))
        on_diagonal = np.flatnonzero(of_K.indices == row)
        place[row[on_diagonal]] = on_diagonal
    return place


def copy_forest(A: PETSc.Mat) -> PETSc.SF:
    """Build the star forest with the dofs as roots and their torn copies as leaves."""
    dofs, ranges = A.getLGMap()[0].getIndices(), A.getOwnershipRanges()
    rank = np.searchsorted(ranges, dofs, side="right") - 1
    remote = np.column_stack([rank, dofs - ranges[rank]]).astype(PETSc.IntType)
    forest = PETSc.SF().create(A.comm)
    forest.setGraph(A.getLocalSize()[0], None, remote)
    return forest
