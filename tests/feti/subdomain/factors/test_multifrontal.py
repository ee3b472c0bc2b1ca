# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The multifrontal method: S and the factor of K_II agree with dense algebra."""

import ctypes

import numpy as np
import pytest
import scipy.sparse
from collective import COMM, agree, equal, raises

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.factors import nested_dissection as ordering
from dolfinx_feti.feti.subdomain.factors.multifrontal import create_fronts, load_fronts
from dolfinx_feti.feti.subdomain.factors.work_space import WorkSpace, pack
from dolfinx_feti.runtime.petsc_library import CSRMatrix
from dolfinx_feti.torn.connectivity import block_graph

EPS = np.finfo(np.float64).eps
ROUNDING = 100.0  # error of a solution, in multiples of eps cond(K_II)


def grid(shape, bs, seed=3):
    """Return a random definite matrix on a grid of nodes of bs dofs, and its Γ, one face."""
    line = [
        scipy.sparse.diags_array([1.0, 2.0, 1.0], offsets=[-1, 0, 1], shape=(k, k)) for k in shape
    ]
    graph = line[0]
    for other in line[1:]:
        graph = scipy.sparse.kron(graph, other)
    pattern = scipy.sparse.kron(graph, np.ones((bs, bs))).tocsr()
    pattern.data = np.random.default_rng(seed).standard_normal(pattern.nnz)
    K = (pattern + pattern.T).tocsr()
    K = (K + scipy.sparse.diags_array(np.abs(K).sum(axis=1) + 1.0)).tocsr()
    K.sort_indices()
    n = K.shape[0]
    face = bs * int(np.prod(shape[1:]))
    return K, np.arange(n - face, n, dtype=np.int32)


def csr_arrays(K):
    """Return the arrays of a sparse matrix, row by row."""
    return CSRMatrix(K.indptr.astype(np.int32), K.indices.astype(np.int32), K.data)


def create_fronts_of(K, Γ, bs, rows=None):
    """Return the fronts of a sparse matrix.

    Args:
        K: Matrix of the process.
        Γ: Interface, by the rows of the subdomain.
        bs: Block size.
        rows: Rows of K that are the subdomain; all if not given.
    """
    rows = np.arange(K.shape[0], dtype=np.int32) if rows is None else rows
    number = np.full(K.shape[0], -1, dtype=np.int32)
    number[rows] = np.arange(len(rows))
    graph = block_graph(csr_arrays(K), bs)
    return create_fronts(load_fronts(COMM), graph, rows, number, bs, Γ)


def factor_with(fronts, K):
    """Return the factor of K_II and S in packed format, or None if K_II is not definite."""
    return fronts.factor(csr_arrays(K), WorkSpace())


def dense_blocks(K, Γ):
    """Return K_II, (n_I, n_I), K_IΓ, (n_I, n_Γ), and K_ΓΓ, (n_Γ, n_Γ), as arrays."""
    K = K.toarray()
    I = np.setdiff1d(np.arange(len(K)), Γ)  # noqa: E741
    return K[np.ix_(I, I)], K[np.ix_(I, Γ)], K[np.ix_(Γ, Γ)]


def check_fronts(K, Γ, bs, rows=None):
    """Assert that S and K_II⁻¹ agree with dense algebra; return the fronts.

    A second factor by the same fronts exists meanwhile: neither changes the other.

    Args:
        K: Matrix of the process.
        Γ: Interface, by the rows of the subdomain.
        bs: Block size.
        rows: Rows of K that are the subdomain; all if not given.
    """
    fronts = create_fronts_of(K, Γ, bs, rows)
    (factor, S), (other, S_4) = (factor_with(fronts, c * K) for c in (1.0, 4.0))
    K_II, K_IΓ, K_ΓΓ = dense_blocks(K if rows is None else K[rows][:, rows], Γ)
    tolerance = ROUNDING * EPS * np.linalg.cond(K_II) if len(K_II) else EPS
    equal(S, pack(K_ΓΓ - K_IΓ.T @ np.linalg.solve(K_II, K_IΓ)), tolerance)
    Y = np.random.default_rng(1).standard_normal((len(K_II), 3))
    equal(K_II @ factor.solve(Y), Y, tolerance)
    equal(factor.solve(Y[:, 0]), factor.solve(Y)[:, 0], tolerance)
    equal(4.0 * other.solve(Y), factor.solve(Y), 10 * EPS)
    equal(S_4, 4.0 * S, 10 * EPS)
    agree(factor.memory() == 8 * fronts.factor_entries / 2**20)
    return fronts


@pytest.mark.parametrize("bs", [1, 3])
@pytest.mark.parametrize("shape", [(40,), (13, 9), (6, 5, 4), (2, 1, 2)])
def test_schur_complement_and_factor_agree_with_dense_algebra(shape, bs):
    """S = K_ΓΓ − K_ΓI K_II⁻¹ K_IΓ, and K_II K_II⁻¹ Y = Y, for one column and several."""
    check_fronts(*grid(shape, bs), bs)


@pytest.mark.parametrize("pivots", [1, 47, 48, 49, 96, 97, 130])
def test_dense_front_of_any_number_of_pivots(pivots):
    """Numbers around multiples of 48, the block size in solve_update_columns."""
    n = pivots + 20
    Q = np.linalg.qr(np.random.default_rng(n).standard_normal((n, n)))[0]
    K = (Q * np.geomspace(1.0, 1e8, n)) @ Q.T
    fronts = check_fronts(
        scipy.sparse.csr_array(0.5 * (K + K.T)), np.arange(pivots, n, dtype=np.int32), 1
    )
    agree(fronts.tree.front_count == 1 and len(fronts.last_dofs) == pivots)


@pytest.mark.parametrize("bs", [1, 2, 3])
def test_nodes_may_have_dofs_on_the_interface_and_inside(bs):
    """Of the dofs of a node, some are on Γ, some inside, and some fixed."""
    K, _ = grid((5, 5, 6), 3)
    rng = np.random.default_rng(bs)
    free = np.sort(rng.permutation(K.shape[0])[:-40])
    Γ = np.sort(rng.permutation(len(free))[:60]).astype(np.int32)
    check_fronts(K, Γ, bs, free.astype(np.int32))


@pytest.mark.parametrize("metis", [True, False], ids=["METIS", "PETSc"])
def test_nested_dissection_orders_each_node_once(metis, monkeypatch):
    """By METIS if PETSc is linked with it; by PETSc without it, or if it fails."""
    metis_function = ordering.c_function("METIS_NodeND", (ctypes.c_void_p,) * 7)
    if not metis:
        monkeypatch.setattr(ordering, "c_function", lambda *_: None)
    K, Γ = grid((7, 6, 5), 1)
    ptr = K.indptr
    adjacent = K.indices
    interior = np.arange(K.shape[0] - len(Γ), dtype=np.int32)
    order = ordering.nested_dissection(ptr, adjacent, interior)
    equal(np.sort(order), interior)
    check_fronts(*grid((7, 6, 5), 3), 3)
    one_way = adjacent.copy()
    one_way[ptr[0] : ptr[1]] = 0  # edges to the first node, but none from it
    equal(np.sort(ordering.nested_dissection(ptr, one_way, interior)), interior)
    if metis_function and not metis:
        monkeypatch.setattr(ordering, "c_function", lambda *_: lambda *_: -3)  # out of memory
        equal(ordering.nested_dissection(ptr, adjacent, interior), order)


def test_metis_takes_fewer_flops_than_petsc(monkeypatch):
    """On a cube it finds smaller separators than PETSc."""
    if ordering.c_function("METIS_NodeND", (ctypes.c_void_p,) * 7) is None:
        pytest.skip("PETSc is not linked with METIS")
    K, Γ = grid((12, 9, 9), 3)
    dissected = create_fronts_of(K, Γ, 3).flops
    monkeypatch.setattr(ordering, "_metis_order", lambda *_: None)
    agree(dissected < create_fronts_of(K, Γ, 3).flops)


def test_interior_may_be_split_or_empty():
    """An interface that cuts the interior in two, no interior, no interface, no dofs."""
    K, _ = grid((9, 4, 4), 3)
    check_fronts(K, np.arange(4 * 48, 5 * 48, dtype=np.int32), 3)
    check_fronts(K, np.arange(K.shape[0], dtype=np.int32), 3)
    check_fronts(K, np.zeros(0, dtype=np.int32), 3)
    check_fronts(K[:0][:, :0], np.zeros(0, dtype=np.int32), 3)


def test_random_patterns_agree_with_dense_algebra():
    """Symmetric patterns at random, in which blocks are not full."""
    rng = np.random.default_rng(5)
    for m in range(3, 80, 7):
        bs = 1 + m % 3
        n = m - m % bs
        pattern = scipy.sparse.random_array((n, n), density=0.08, rng=rng)
        K = (pattern + pattern.T).tocsr()
        K = (K + scipy.sparse.diags_array(np.abs(K).sum(axis=1) + 1.0)).tocsr()
        Γ = np.sort(rng.permutation(n)[: n // 3]).astype(np.int32)
        check_fronts(K, Γ, bs)


def with_entries(K, i, j):
    """Return K with 1 at (i, j) and (j, i), in its pattern."""
    more = scipy.sparse.coo_array(([1.0, 1.0], ([i, j], [j, i])), K.shape)
    return scipy.sparse.csr_array(K + more)


def test_new_entries_outside_of_the_fronts_are_refused():
    """Entries that happen to fit into the fronts are part of the factor; others raise."""
    K, Γ = grid((12, 5, 4), 1)
    fronts = create_fronts_of(K, Γ, 1)
    refused = 0
    Y = np.ones(len(fronts.ranks))
    positions = [(i, j) for i in range(0, 120, 7) for j in range(i + 60, 220, 11)]
    for i, j in positions:
        try:
            factor, _ = factor_with(fronts, with_entries(K, i, j))
        except FactorError as error:
            if "pattern of the matrix has changed" in str(error):
                refused += 1
        else:
            equal(dense_blocks(with_entries(K, i, j), Γ)[0] @ factor.solve(Y), Y, 1e-12)
    agree(refused > len(positions) // 2)


def test_entries_that_couple_subdomains_are_refused():
    """Also columns out of range, and a matrix of another size."""
    K, Γ = grid((5, 4), 3)
    n = K.shape[0]
    both = scipy.sparse.csr_array(scipy.sparse.block_array([[K, None], [None, K]]))
    number = np.tile(np.arange(n, dtype=np.int32), 2)
    rows = np.arange(n, 2 * n, dtype=np.int32)
    code = load_fronts(COMM)
    for interface in (Γ, Γ[:0]):
        fronts = create_fronts(code, block_graph(csr_arrays(both), 3), rows, number, 3, interface)
        agree(factor_with(fronts, both) is not None)
        for i in (0, n - 1):
            with raises(FactorError, "pattern of the matrix has changed"):
                factor_with(fronts, with_entries(both, i, n + i))
        for column in (-1, 2 * n, 2**31 - 1):
            indptr, indices, values = csr_arrays(both)
            indices[-1] = column
            with raises(FactorError, "pattern of the matrix has changed"):
                fronts.factor(CSRMatrix(indptr, indices, values), WorkSpace())
        with raises(FactorError, "pattern of the matrix has changed"):
            factor_with(fronts, K)


@pytest.mark.parametrize("pivot", ["negative", "zero", "nan"])
def test_indefinite_matrix_has_no_factor(pivot):
    """A first, middle or last pivot that is not positive ends the factorisation."""
    K, Γ = grid((6, 5, 4), 3)
    row, column = K.nonzero()
    for dof in (0, 100, 290):
        K_wrong = K.copy()
        if pivot == "zero":
            K_wrong.data[(row == dof) | (column == dof)] = 0.0
        else:
            K_wrong[dof, dof] = -1e3 if pivot == "negative" else np.nan
        result = factor_with(create_fronts_of(K, Γ, 3), K_wrong)
        if pivot == "nan" and result is not None:
            agree(not np.isfinite(result[1]).all())
        else:
            agree(result is None)
