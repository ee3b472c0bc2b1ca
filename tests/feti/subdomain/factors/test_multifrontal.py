# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Fronts: S and the factor of K_II at once, against dense algebra and against MUMPS."""

import ctypes

import numpy as np
import pytest
import scipy.sparse
from collective import COMM, agree, equal, raises

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.factors import multifrontal as fronts
from dolfinx_feti.feti.subdomain.factors.dense import pack
from dolfinx_feti.feti.subdomain.factors.multifrontal import create_fronts, load_fronts
from dolfinx_feti.runtime.connectivity import block_graph
from dolfinx_feti.runtime.petsc_library import Rows

EPS = np.finfo(np.float64).eps
ROUNDING = 100.0  # multiples of eps cond(K_II) that a solution may be off


def grid(shape, bs, seed=3):
    """Return a random definite matrix on a grid of nodes of bs dofs, and its Γ: one face."""
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
    n, face = K.shape[0], bs * int(np.prod(shape[1:]))
    return K, np.arange(n - face, n, dtype=np.int32)


def arrays(K):
    """Return a sparse matrix row by row."""
    return Rows(K.indptr.astype(np.int32), K.indices.astype(np.int32), K.data)


def analysed(K, Γ, bs, rows=None):
    """Return the fronts of a sparse matrix, or of some of its rows."""
    rows = np.arange(K.shape[0], dtype=np.int32) if rows is None else rows
    number = np.full(K.shape[0], -1, dtype=np.int32)
    number[rows] = np.arange(len(rows))
    graph = block_graph(arrays(K), bs)
    return create_fronts(load_fronts(COMM), graph, rows, number, bs, Γ)


def factored(fronts, K):
    """Return the factor and S; None if there is none."""
    return fronts.factor(arrays(K), np.empty(fronts.work))


def parts(K, Γ):
    """Return K_II, K_IΓ and K_ΓΓ as dense matrices."""
    K = K.toarray()
    I = np.setdiff1d(np.arange(len(K)), Γ)  # noqa: E741
    return K[np.ix_(I, I)], K[np.ix_(I, Γ)], K[np.ix_(Γ, Γ)]


def check(K, Γ, bs, rows=None):
    """Compare S and K_II⁻¹ with dense algebra, while another factor exists; return the fronts."""
    fronts = analysed(K, Γ, bs, rows)
    (factor, S), (other, S_4) = (factored(fronts, c * K) for c in (1.0, 4.0))
    K_II, K_IΓ, K_ΓΓ = parts(K if rows is None else K[rows][:, rows], Γ)
    tolerance = ROUNDING * EPS * np.linalg.cond(K_II) if len(K_II) else EPS
    equal(S, pack(K_ΓΓ - K_IΓ.T @ np.linalg.solve(K_II, K_IΓ)), tolerance)
    Y = np.random.default_rng(1).standard_normal((len(K_II), 3))
    equal(K_II @ factor.solve(Y), Y, tolerance)
    equal(factor.solve(Y[:, 0]), factor.solve(Y)[:, 0], tolerance)
    equal(4.0 * other.solve(Y), factor.solve(Y), 10 * EPS)
    equal(S_4, 4.0 * S, 10 * EPS)
    agree(factor.memory() == 8 * fronts.entries / 2**20)
    return fronts


@pytest.mark.parametrize("bs", [1, 3])
@pytest.mark.parametrize("shape", [(40,), (13, 9), (6, 5, 4), (2, 1, 2)])
def test_schur_complement_and_factor(shape, bs):
    """S = K_ΓΓ − K_ΓI K_II⁻¹ K_IΓ, and K_II K_II⁻¹ Y = Y, for one column and several."""
    check(*grid(shape, bs), bs)


@pytest.mark.parametrize("pivots", [1, 47, 48, 49, 96, 97, 130])
def test_a_front_of_several_narrow_triangles(pivots):
    """All dofs touch each other: one front, here with condition 1e8, a few triangles wide."""
    n = pivots + 20
    Q = np.linalg.qr(np.random.default_rng(n).standard_normal((n, n)))[0]
    K = (Q * np.geomspace(1.0, 1e8, n)) @ Q.T
    fronts = check(scipy.sparse.csr_array(0.5 * (K + K.T)), np.arange(pivots, n, dtype=np.int32), 1)
    agree(fronts.data.count == 1 and len(fronts.last) == pivots)


@pytest.mark.parametrize("bs", [1, 2, 3])
def test_interface_that_cuts_nodes(bs):
    """Single dofs of a node may be of Γ, and others missing."""
    K, _ = grid((5, 5, 6), 3)
    rng = np.random.default_rng(bs)
    free = np.sort(rng.permutation(K.shape[0])[:-40])
    Γ = np.sort(rng.permutation(len(free))[:60]).astype(np.int32)
    check(K, Γ, bs, free.astype(np.int32))


@pytest.mark.parametrize("metis", [True, False], ids=["METIS", "PETSc"])
def test_orders(metis, monkeypatch):
    """METIS orders where PETSc is linked with it; without it, or if it fails, PETSc does."""
    found = fronts.function("METIS_NodeND", (ctypes.c_void_p,) * 7)
    if not metis:
        monkeypatch.setattr(fronts, "function", lambda *_: None)
    K, Γ = grid((7, 6, 5), 1)
    ptr, adjacent, interior = K.indptr, K.indices, np.arange(K.shape[0] - len(Γ), dtype=np.int32)
    order = fronts._order(ptr, adjacent, interior)
    agree(np.array_equal(np.sort(order), interior))
    check(*grid((7, 6, 5), 3), 3)
    one_way = adjacent.copy()
    one_way[ptr[0] : ptr[1]] = 0  # the first node has no neighbours, though it is one of theirs
    agree(np.array_equal(np.sort(fronts._order(ptr, one_way, interior)), interior))
    if found and not metis:
        monkeypatch.setattr(fronts, "function", lambda *_: lambda *_: -3)  # out of memory
        agree(np.array_equal(fronts._order(ptr, adjacent, interior), order))


def test_metis_saves_flops(monkeypatch):
    """Its separators are smaller: on a cube the fronts take fewer flops than those of PETSc."""
    if fronts.function("METIS_NodeND", (ctypes.c_void_p,) * 7) is None:
        pytest.skip("PETSc is not linked with METIS")
    K, Γ = grid((12, 9, 9), 3)
    dissected = analysed(K, Γ, 3).flops
    monkeypatch.setattr(fronts, "_dissect", lambda *_: None)
    agree(dissected < analysed(K, Γ, 3).flops)


def test_interior_in_pieces_none_and_all():
    """Γ through the middle, no interior, no interface, nothing at all."""
    K, _ = grid((9, 4, 4), 3)
    check(K, np.arange(4 * 48, 5 * 48, dtype=np.int32), 3)
    check(K, np.arange(K.shape[0], dtype=np.int32), 3)
    check(K, np.zeros(0, dtype=np.int32), 3)
    check(K[:0][:, :0], np.zeros(0, dtype=np.int32), 3)


def test_random_patterns():
    """Any symmetric pattern, also one whose blocks are not full."""
    rng = np.random.default_rng(5)
    for m in range(3, 80, 7):
        bs = 1 + m % 3
        n = m - m % bs
        pattern = scipy.sparse.random_array((n, n), density=0.08, rng=rng)
        K = (pattern + pattern.T).tocsr()
        K = (K + scipy.sparse.diags_array(np.abs(K).sum(axis=1) + 1.0)).tocsr()
        Γ = np.sort(rng.permutation(n)[: n // 3]).astype(np.int32)
        check(K, Γ, bs)


def with_entries(K, i, j):
    """Return K with 1 at (i, j) and (j, i), in its pattern."""
    more = scipy.sparse.coo_array(([1.0, 1.0], ([i, j], [j, i])), K.shape)
    return scipy.sparse.csr_array(K + more)


def test_new_pattern_is_noticed():
    """Entries outside of the fronts are refused, whatever couples them."""
    K, Γ = grid((12, 5, 4), 1)
    fronts, refused = analysed(K, Γ, 1), 0
    Y = np.ones(len(fronts.ranks))
    new = [(i, j) for i in range(0, 120, 7) for j in range(i + 60, 220, 11)]
    for i, j in new:
        try:
            factor, _ = factored(fronts, with_entries(K, i, j))
        except FactorError as error:
            refused += "pattern of the matrix has changed" in str(error)
        else:
            equal(parts(with_entries(K, i, j), Γ)[0] @ factor.solve(Y), Y, 1e-12)
    agree(refused > len(new) // 2)


def test_entries_that_couple_subdomains_are_refused():
    """As when the pattern changes between the analysis and a factorisation, also out of range."""
    K, Γ = grid((5, 4), 3)
    n = K.shape[0]
    both = scipy.sparse.csr_array(scipy.sparse.block_array([[K, None], [None, K]]))
    number = np.tile(np.arange(n, dtype=np.int32), 2)
    rows = np.arange(n, 2 * n, dtype=np.int32)
    code = load_fronts(COMM)
    for interface in (Γ, Γ[:0]):
        fronts = create_fronts(code, block_graph(arrays(both), 3), rows, number, 3, interface)
        agree(factored(fronts, both) is not None)
        for i in (0, n - 1):
            with raises(FactorError, "pattern of the matrix has changed"):
                factored(fronts, with_entries(both, i, n + i))
        for column in (-1, 2 * n, 2**31 - 1):
            indptr, indices, values = arrays(both)
            indices[-1] = column
            with raises(FactorError, "pattern of the matrix has changed"):
                fronts.factor(Rows(indptr, indices, values), np.empty(fronts.work))
        with raises(FactorError, "pattern of the matrix has changed"):
            factored(fronts, K)


@pytest.mark.parametrize("wrong", ["negative", "zero", "nan"])
def test_not_definite(wrong):
    """A pivot that is not positive ends the factorisation, wherever it is met."""
    K, Γ = grid((6, 5, 4), 3)
    row, column = K.nonzero()
    for dof in (0, 100, 290):
        bad = K.copy()
        if wrong == "zero":
            bad.data[(row == dof) | (column == dof)] = 0.0
        else:
            bad[dof, dof] = -1e3 if wrong == "negative" else np.nan
        made = factored(analysed(K, Γ, 3), bad)
        agree(made is None or not np.isfinite(made[1]).all())
        agree(wrong == "nan" or made is None)
