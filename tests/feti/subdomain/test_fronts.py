# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Fronts: S and the factor of K_II at once, against dense algebra and against MUMPS."""

from __future__ import annotations

import ctypes
import logging

from petsc4py import PETSc

import numpy as np
import pytest
import scipy.sparse
from collective import COMM, agree, equal

from dolfinx_feti import native
from dolfinx_feti.feti.subdomain import elimination
from dolfinx_feti.feti.subdomain.dense import pack
from dolfinx_feti.feti.subdomain.sparse import fronts
from dolfinx_feti.feti.subdomain.sparse.fronts import Fronts, load_fronts, load_fronts_for
from dolfinx_feti.petsc_library import rows_of

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


def petsc_matrix(K):
    csr = (K.indptr.astype(PETSc.IntType), K.indices.astype(PETSc.IntType), K.data)
    return PETSc.Mat().createAIJ(K.shape, csr=csr, comm=PETSc.COMM_SELF)


def factored(K, Γ, bs, rows=None):
    """Return the fronts, and S, of a sparse matrix, or of some of its rows."""
    rows = np.arange(K.shape[0], dtype=np.int32) if rows is None else rows
    number = np.full(K.shape[0], -1, dtype=np.int32)
    number[rows] = np.arange(len(rows))
    matrix = petsc_matrix(K)
    with rows_of(matrix) as of_K:
        found = Fronts(load_fronts(COMM), of_K, rows, number, bs, Γ)
        S = found.factor(of_K, np.empty(found.work))
    matrix.destroy()
    return found, S


def parts(K, Γ):
    """Return I, and K_II, K_IΓ and K_ΓΓ as dense matrices."""
    K = K.toarray()
    I = np.setdiff1d(np.arange(len(K)), Γ)  # noqa: E741
    return I, K[np.ix_(I, I)], K[np.ix_(I, Γ)], K[np.ix_(Γ, Γ)]


def check(K, Γ, bs):
    found, S = factored(K, Γ, bs)
    _, K_II, K_IΓ, K_ΓΓ = parts(K, Γ)
    tolerance = ROUNDING * EPS * np.linalg.cond(K_II) if len(K_II) else EPS
    equal(S, pack(K_ΓΓ - K_IΓ.T @ np.linalg.solve(K_II, K_IΓ)), tolerance)
    Y = np.random.default_rng(1).standard_normal((len(K_II), 3))
    equal(K_II @ found.solve(Y), Y, tolerance)
    equal(found.solve(Y[:, 0]), found.solve(Y)[:, 0], tolerance)
    return found


@pytest.mark.parametrize("bs", [1, 3])
@pytest.mark.parametrize("shape", [(40,), (13, 9), (6, 5, 4), (2, 1, 2)])
def test_schur_complement_and_factor(shape, bs):
    """S = K_ΓΓ − K_ΓI K_II⁻¹ K_IΓ, and K_II K_II⁻¹ Y = Y, for one column and several."""
    found = check(*grid(shape, bs), bs)
    agree(found.factored and found.memory() > 0.0)
    found.release()
    agree(not found.factored and found.memory() == 0.0)


@pytest.mark.parametrize("pivots", [1, 47, 48, 49, 96, 97, 130])
def test_a_front_of_several_narrow_triangles(pivots):
    """All dofs touch each other: one front, here with condition 1e8, a few triangles wide."""
    n = pivots + 20
    Q = np.linalg.qr(np.random.default_rng(n).standard_normal((n, n)))[0]
    K = (Q * np.geomspace(1.0, 1e8, n)) @ Q.T
    found = check(scipy.sparse.csr_array(0.5 * (K + K.T)), np.arange(pivots, n, dtype=np.int32), 1)
    agree(found._fronts.count == 1)


@pytest.mark.parametrize("bs", [1, 2, 3])
def test_interface_that_cuts_nodes(bs):
    """Single dofs of a node may be of Γ, and others missing."""
    K, _ = grid((5, 5, 5), 3)
    rng = np.random.default_rng(bs)
    free = np.sort(rng.permutation(K.shape[0])[:-40])
    Γ = np.sort(rng.permutation(len(free))[:60]).astype(np.int32)
    _, S = factored(K, Γ, bs, free.astype(np.int32))
    _, K_II, K_IΓ, K_ΓΓ = parts(K[free][:, free], Γ)
    equal(
        S, pack(K_ΓΓ - K_IΓ.T @ np.linalg.solve(K_II, K_IΓ)), ROUNDING * EPS * np.linalg.cond(K_II)
    )


@pytest.mark.parametrize("metis", [True, False], ids=["METIS", "PETSc"])
def test_orders(metis, monkeypatch):
    """METIS orders where PETSc is linked with it; without it, or if it fails, PETSc does."""
    found = fronts.function("METIS_NodeND", (ctypes.c_void_p,) * 7)
    if not metis:
        monkeypatch.setattr(fronts, "function", lambda *_: None)
    ptr, adjacent, interior = grid_graph((7, 6, 5))
    orders = fronts._orders(ptr, adjacent, interior)
    agree(len(orders) == (1 if metis and found else 2))
    agree(all(np.array_equal(np.sort(order), interior) for order in orders))
    check(*grid((7, 6, 5), 3), 3)
    one_way = adjacent.copy()
    one_way[ptr[0] : ptr[1]] = 0  # the first node has no neighbours, though it is one of theirs
    agree(len(fronts._orders(ptr, one_way, interior)) == 2)
    if found and not metis:
        monkeypatch.setattr(fronts, "function", lambda *_: lambda *_: -3)  # out of memory
        agree(len(fronts._orders(ptr, adjacent, interior)) == 2)


def grid_graph(shape):
    """Return the graph of a grid, and the nodes off one face."""
    K, Γ = grid(shape, 1)
    return K.indptr, K.indices, np.arange(K.shape[0] - len(Γ), dtype=np.int32)


def test_metis_saves_flops(monkeypatch):
    """Its separators are smaller: on a cube the fronts take less time than those of PETSc."""
    if fronts.function("METIS_NodeND", (ctypes.c_void_p,) * 7) is None:
        pytest.skip("PETSc is not linked with METIS")
    K, Γ = grid((12, 9, 9), 3)
    dissected = factored(K, Γ, 3)[0]._fronts.seconds
    monkeypatch.setattr(fronts, "_dissect", lambda *_: None)
    agree(dissected < factored(K, Γ, 3)[0]._fronts.seconds)


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
    for n in range(2, 80, 7):
        pattern = scipy.sparse.random_array((n, n), density=0.08, rng=rng)
        K = (pattern + pattern.T).tocsr()
        K = (K + scipy.sparse.diags_array(np.abs(K).sum(axis=1) + 1.0)).tocsr()
        Γ = np.sort(rng.permutation(n)[: n // 3]).astype(np.int32)
        check(K, Γ, 1 + n % 3)


def test_values_of_another_matrix():
    """The analysis serves all matrices of a pattern; the last one counts."""
    K, Γ = grid((6, 5, 4), 3)
    found, S = factored(K, Γ, 3)
    matrix = petsc_matrix(4.0 * K)
    with rows_of(matrix) as of_K:
        equal(found.factor(of_K, np.empty(found.work)), 4.0 * S, 10 * EPS)
    matrix.destroy()
    Y = np.ones((K.shape[0] - len(Γ), 1))
    equal(4.0 * parts(K, Γ)[1] @ found.solve(Y), Y, 1e-12)


@pytest.mark.parametrize("wrong", ["negative", "zero", "nan"])
def test_not_definite(wrong):
    """A pivot that is not positive ends the factorisation, wherever it is met."""
    K, Γ = grid((6, 5, 4), 3)
    for dof in (0, 100, 290):
        bad = K.copy()
        bad[dof, dof] = {"negative": -1e3, "zero": 0.0, "nan": np.nan}[wrong]
        if wrong == "zero":
            bad.data[bad.indptr[dof] : bad.indptr[dof + 1]] = 0.0
            bad = (bad.T.multiply(np.arange(K.shape[0]) != dof)).tocsr() + 0.0 * K
        found, S = factored(scipy.sparse.csr_array(bad), Γ, 3)
        agree(S is None or not np.isfinite(S).all())
        agree(wrong == "nan" or (S is None and not found.factored))


def buckled(factor):
    """Return a change that lowers the stiffness of all dofs of every subdomain."""
    return lambda K, dofs: [np.fill_diagonal(k, factor * k.diagonal()) for k in K]


@pytest.mark.parametrize("factor", [1.0, 0.5], ids=["definite", "indefinite"])
def test_pivots_where_they_are_needed(factor, torn_grid, parts, monkeypatch):
    """With fronts as with MUMPS: S, the inertia of K_II, loads and displacements inside."""
    monkeypatch.setattr(elimination, "SMALL", -1)
    problem = torn_grid((2, 2), (6, 5), components=2, change=buckled(factor))
    by_fronts = parts(problem.A, type="all_floating", interior="eliminate").matrices
    monkeypatch.setattr(elimination, "load_fronts_for", lambda *_: None)
    by_mumps = parts(problem.A, type="all_floating", interior="eliminate").matrices
    inertia = by_fronts.interior_inertia()
    agree(inertia == by_mumps.interior_inertia())
    agree(COMM.allreduce(inertia[0]) > 0 if factor < 1.0 else inertia == (0, 0))
    fronts = [f for f in by_fronts._elimination.factors._fronts if f.factored]
    agree(COMM.allreduce(len(fronts)) < 4 if factor < 1.0 else len(fronts) == len(by_fronts.dofs))
    unused = [f for f in by_fronts._elimination.factors._fronts if not f.factored]
    agree(all(f.memory() == 0.0 for f in unused))
    f, u = np.random.default_rng(2 + COMM.rank).standard_normal(
        (2, problem.A.getISLocalMat().getSize()[0])
    )
    equal(by_fronts.multiply(u), by_mumps.multiply(u), 1e-10)
    equal(by_fronts.condense(f), by_mumps.condense(f), 1e-10)
    equal(by_fronts.extend(u, f), by_mumps.extend(u, f), 1e-10)


@pytest.mark.parametrize("name", ["pc_factor_mat_solver_type", "pc_type"])
def test_options_that_name_a_solver_are_followed(name):
    """Who names the solver of K_II gets it."""
    agree(load_fronts_for("fronts_", COMM) is not None)
    options = PETSc.Options("fronts_")
    options[name] = {"pc_type": "cholesky"}.get(name, "mumps")
    agree(load_fronts_for("fronts_", COMM) is None)
    options.delValue(name)


def test_without_a_compiler(torn_grid, parts, monkeypatch, caplog):
    """MUMPS takes over, and a warning names the remedy."""

    def fails(*_):
        raise OSError("no compiler here")

    monkeypatch.setattr(elimination, "SMALL", -1)
    monkeypatch.setattr(native, "load", fails)
    monkeypatch.setattr(native, "_failed", set())
    with caplog.at_level(logging.WARNING, logger="dolfinx_feti"):
        system = parts(torn_grid((2, 2), (4, 3)).A, type="all_floating", interior="eliminate")
    agree(isinstance(system.matrices._elimination, elimination.PartialElimination))
    agree(COMM.rank > 0 or ("no compiler here" in caplog.text and "XDG_CACHE_HOME" in caplog.text))
