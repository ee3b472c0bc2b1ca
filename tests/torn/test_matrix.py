# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The seam: a torn matrix is the assembled operator, and what travels on it."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import scipy.sparse
from collective import COMM, agree, dense, equal, raises, whole

import dolfinx_feti
from dolfinx_feti.errors import SetUpError
from dolfinx_feti.runtime.connectivity import (
    block_graph,
    connected_blocks,
    coupled_nodes,
    is_symmetric,
    load_graph_code,
)
from dolfinx_feti.runtime.petsc_library import Rows
from dolfinx_feti.torn.matrix import Torn, create_torn_matrix, set_condensed

SEED = 60914


@pytest.mark.parametrize(
    ("subdomains", "cells", "components"), [((3,), (4,), 1), ((2, 2), (2, 3), 2)]
)
def test_torn_matrix_acts_as_the_assembled_one(torn_grid, subdomains, cells, components):
    problem = torn_grid(subdomains, cells, components=components)
    x = np.random.default_rng(SEED).standard_normal(len(problem.dirichlet))
    x_vec, y_vec = problem.vector(x), problem.A.createVecLeft()
    problem.A.mult(x_vec, y_vec)
    expected = problem.T.T @ problem.K_torn @ problem.T @ x
    equal(whole(y_vec.array_r), expected, 1e-13)
    assembled = PETSc.Mat()
    problem.A.convert("aij", assembled)
    equal(dense(assembled), problem.T.T @ problem.K_torn @ problem.T, 1e-13)


def test_tear_and_assemble_are_transposed(torn_grid, lifetime):
    problem = torn_grid((2, 2), (2, 2), components=2)
    torn = lifetime.own(Torn(problem.A))
    rng = np.random.default_rng(SEED + 1)
    x, t = rng.standard_normal(len(problem.dirichlet)), rng.standard_normal(len(problem.to_global))
    mine = slice(torn.start, torn.start + torn.n)
    equal(whole(torn.tear(problem.vector(x).array_r)), problem.T @ x)
    equal(whole(torn.assemble(t[mine])), problem.T.T @ t, 1e-14)
    equal(whole(torn.multiplicity()), problem.T.sum(axis=0).astype(int))
    equal(whole(torn.multiply(t[mine])), problem.K_torn @ t, 1e-13)
    equal(whole(torn.dirichlet), problem.dirichlet[problem.to_global])
    equal(whole(torn.prescribed), problem.dirichlet)


@pytest.mark.parametrize("columns", [0, 1, 3])
@pytest.mark.parametrize("transpose", [False, True])
def test_several_columns_at_once(torn_grid, columns, transpose, lifetime):
    problem = torn_grid((2, 2), (2, 2), components=2)
    torn = lifetime.own(Torn(problem.A))
    t = np.random.default_rng(SEED + 2).standard_normal((len(problem.to_global), columns))
    K = problem.K_torn.T if transpose else problem.K_torn
    product = torn.multiply(t[torn.start : torn.start + torn.n], transpose=transpose)
    equal(whole(product), K @ t, 1e-13)


def test_gather_brings_copies_in_the_order_of_dofs(torn_grid, monkeypatch, lifetime):
    """Without a name that mpi4py keeps to itself."""
    monkeypatch.delattr(MPI, "_typedict", raising=False)
    problem = torn_grid((2, 2), (2, 2))
    torn = lifetime.own(Torn(problem.A))
    gathered = whole(torn.gather(torn.start + np.arange(torn.n, dtype=np.float64)))
    copies = np.split(gathered.astype(int), np.cumsum(problem.T.sum(axis=0).astype(int))[:-1])
    agree(
        all(sorted(c) == list(np.flatnonzero(problem.T[:, j])) for j, c in enumerate(copies)),
        gathered,
    )


def test_subdomains_are_the_blocks(torn_grid, lifetime):
    problem = torn_grid((3, 2), (2, 1), components=2)
    torn = lifetime.own(Torn(problem.A))
    sizes = COMM.allreduce([len(rows) for rows in torn.subdomains])
    equal(sizes, [len(K) for K in problem.K])
    agree(all(np.all(np.diff(rows) > 0) for rows in torn.subdomains))


def test_blocks_are_found_when_a_first_row_does_not_couple():
    """Two nodes that are coupled by their second components only."""
    csr = ([0, 1, 3, 4, 6], [0, 1, 3, 2, 1, 3], np.ones(6))
    K = PETSc.Mat().createAIJ((4, 4), bsize=2, csr=csr, comm=PETSc.COMM_SELF)
    blocks = connected_blocks(block_graph(K, load_graph_code(COMM)), 2)
    agree([list(rows) for rows in blocks] == [[0, 1, 2, 3]])
    K.destroy()


@pytest.mark.parametrize("full", [True, False])
@pytest.mark.parametrize("bs", [1, 2, 3])
def test_graph_is_that_of_the_blocks(bs, full):
    """With full blocks, and with others."""
    rng = np.random.default_rng(bs)
    blocks = scipy.sparse.random_array((30, 30), density=0.1, rng=rng)
    K = scipy.sparse.kron(blocks, np.ones((bs, bs))).tocsr()
    K.sort_indices()
    if not full:
        K.data[rng.permutation(K.nnz)[: K.nnz // 3]] = 0.0
        K.eliminate_zeros()
    csr = (K.indptr.astype(PETSc.IntType), K.indices.astype(PETSc.IntType), K.data)
    matrix = PETSc.Mat().createAIJ(K.shape, bsize=bs, csr=csr, comm=PETSc.COMM_SELF)
    graph = block_graph(matrix, load_graph_code(COMM))
    matrix.destroy()
    expected = np.abs(K.toarray()).reshape(30, bs, 30, bs).sum(axis=(1, 3)) > 0.0
    agree(np.array_equal(graph.toarray() != 0, expected))


@pytest.mark.parametrize(
    "wrong",
    [
        {"rows": [0, 0, 3]},
        {"rows": [0, 1, 4]},
        {"rows": [-1, 1, 3]},
        {"number": [0, 1, -1, 3]},
        {"number": [0, 2, -1, 1]},
        {"number": [0, 1, 2]},
        {"node": [0, 0, 2]},
        {"node": [1, 1, 0]},
        {"node": [0, 1, 2]},
        {"node": [0, 0, 0]},
        {"node": [0, 1]},
        {"indices": [0, 1, 0, 4, 2, 3]},
        {"indices": [0, 1, 0, -1, 2, 3]},
    ],
    ids=str,
)
def test_graph_of_other_rows_is_refused(wrong):
    """Whatever is out of range is one error, and nothing is written there."""
    right = {"indices": [0, 1, 0, 3, 2, 3], "rows": [0, 1, 3], "number": [0, 1, -1, 2]}
    right["node"] = [0, 0, 1]

    def graph(indices, **arrays):
        indptr, indices = (np.array(a, dtype=np.int32) for a in ([0, 2, 4, 5, 6], indices))
        K = Rows(indptr, indices, np.ones(6))
        arrays = {name: np.array(array, dtype=np.int32) for name, array in arrays.items()}
        return coupled_nodes(load_graph_code(COMM), K, **arrays, m=2)

    ptr, adjacent = graph(**right)
    agree(list(ptr) == [0, 2, 3] and list(adjacent) == [0, 1, 1])
    with raises(ValueError, "do not belong to this matrix"):
        graph(**{**right, **wrong})


def test_subdomains_may_be_interleaved():
    csr = ([0, 2, 4, 6, 8, 9], [0, 2, 1, 3, 0, 2, 1, 3, 4], np.arange(1.0, 10.0))
    K = PETSc.Mat().createAIJ((5, 5), csr=csr, comm=PETSc.COMM_SELF)
    sizes = (5, 5 * COMM.size)
    A = create_torn_matrix(K, 5 * COMM.rank + np.arange(5), sizes, comm=COMM)
    torn = Torn(A)
    found = [rows.tolist() for rows in torn.subdomains]
    agree(found == [[0, 2], [1, 3], [4]], found)
    for owned in (torn, A, K):
        owned.destroy()


def test_dirichlet_dofs_may_be_named_by_any_process(torn_grid, lifetime):
    problem = torn_grid((2, 2), (2, 2))
    dofs = np.flatnonzero(problem.dirichlet)
    named = dofs if COMM.rank == COMM.size - 1 else dofs[:1]
    problem.A.compose("dirichlet", PETSc.IS().createGeneral(named.astype(PETSc.IntType), comm=COMM))
    torn = lifetime.own(Torn(problem.A))
    equal(whole(torn.dirichlet), problem.dirichlet[problem.to_global])


def test_near_kernel_is_orthonormal_and_spans_the_modes(torn_grid, lifetime):
    problem = torn_grid((2, 1, 1), (2, 2, 1), components=3)
    modes = np.column_stack([whole(v.array_r) for v in problem.A.getNearNullSpace().getVecs()])
    equal(modes.T @ modes, np.eye(6), 1e-14)
    coefficients = np.linalg.lstsq(modes, problem.modes)[0]
    equal(modes @ coefficients, problem.modes, 1e-13)
    torn = lifetime.own(Torn(problem.A))
    equal(whole(torn.near_kernel()), modes[problem.to_global])


def test_scalar_problem_needs_no_near_kernel(torn_grid, lifetime):
    problem = torn_grid((3,), (2,), modes=0)
    torn = lifetime.own(Torn(problem.A))
    equal(torn.near_kernel(), np.ones((torn.n, 1)))


def test_stiffness_is_the_diagonal_or_what_is_attached(torn_grid):
    problem = torn_grid((2, 2), (2, 2), stiffness=lambda i: 10.0**i)
    torn = Torn(problem.A)
    mine = slice(torn.start, torn.start + torn.n)
    equal(torn.stiffness(), np.diag(problem.K_torn)[mine])
    weight = 1.0 + np.arange(torn.n)
    A = dolfinx_feti.create_torn_matrix(
        problem.local, problem.to_global[mine], problem.A.getSizes()[0], comm=COMM, stiffness=weight
    )
    other = Torn(A)
    weight[:] = -1.0  # the matrix has taken a copy
    equal(other.stiffness(), 1.0 + np.arange(torn.n))
    for owner in (torn, other, A):
        owner.destroy()


def test_stiffness_has_no_sign(torn_grid, lifetime):
    """Under compression a diagonal entry may be negative; a weight must not be."""

    def compress(K, dofs):
        np.fill_diagonal(K[0], -0.3 * K[0].diagonal())

    problem = torn_grid((2, 2), (2, 2), change=compress)
    torn = lifetime.own(Torn(problem.A))
    mine = slice(torn.start, torn.start + torn.n)
    diagonal = np.diag(problem.K_torn)
    agree(diagonal.min() < 0.0)
    equal(torn.diagonal(), diagonal[mine])
    equal(torn.stiffness(), np.abs(diagonal[mine]))


def test_subdomains_are_numbered_over_the_processes(torn_grid, lifetime):
    torn = lifetime.own(Torn(torn_grid((5,), (2,)).A))
    counts = COMM.allgather(len(torn.subdomains))
    agree(torn.first == sum(counts[: COMM.rank]) and sum(counts) == 5)


@pytest.mark.parametrize("components", [1, 2, 3])
def test_coordinates_of_the_torn_dofs(components, torn_grid, lifetime):
    """Also where the number of components is not the dimension; None if there are none."""
    dim = 3 if components == 1 else components
    problem = torn_grid((2,) * dim, (1,) * dim, components=components)
    torn = lifetime.own(Torn(problem.A))
    expected = problem.x[problem.to_global // components]
    equal(whole(torn.coordinates()), expected)
    problem.A.compose("coordinates", None)
    agree(torn.coordinates() is None)


def test_symmetry_is_tested(torn_grid, lifetime):
    def skew(K, dofs):
        K[-1][0, 1] += 1e-6

    for change, expected in ((None, True), (skew, False)):
        torn = lifetime.own(Torn(torn_grid((2, 2), (2, 2), change=change).A))
        agree(torn.is_symmetric() == expected)


@pytest.mark.parametrize("kappa", [1.0, 1e6])
def test_skew_part_is_measured_entry_by_entry(kappa):
    """Against the diagonal of its own rows: beside κ it is nothing, and still not rounding."""
    rng = np.random.default_rng(SEED + 5)
    n = 30
    K = rng.standard_normal((n, n))
    K = K @ K.T + n * np.eye(n)
    K[:10, :10] *= kappa
    K[np.abs(K) < 2.0] = 0.0  # gaps in the pattern
    noise = 1e-14 * rng.standard_normal((n, n)) * np.sqrt(np.outer(K.diagonal(), K.diagonal()))
    noise[K == 0.0] = 0.0

    def symmetric(entries):
        csr = scipy.sparse.csr_array(entries)
        M = PETSc.Mat().createAIJ(
            (n, n), csr=(csr.indptr, csr.indices, csr.data), comm=PETSc.COMM_SELF
        )
        A = create_torn_matrix(M, np.arange(n) + n * COMM.rank, (n, n * COMM.size), comm=COMM)
        found = is_symmetric(A)
        A.destroy()
        M.destroy()
        return found

    agree(symmetric(K) and symmetric(K + noise))
    for i, j in ((20, 25), (25, 20), (0, 29), (29, 0)):
        skew = K.copy()
        skew[i, j] += 1e-8 * np.sqrt(K[i, i] * K[j, j])
        agree(not symmetric(skew), f"entry ({i}, {j})")
    circle = np.roll(np.eye(n), 1, axis=1)  # what a rigid motion does not feel: rows that sum to 0
    roots = np.sqrt(np.outer(K.diagonal(), K.diagonal()))
    agree(not symmetric(K + 1e-9 * (circle - circle.T) * roots))
    for units in (1.0, 1e-12, 1e12):  # an entry without counterpart, and no diagonal on either side
        saddle = units * K
        saddle[[20, 25], [20, 25]] = saddle[20, 25] = saddle[25, 20] = 0.0
        agree(symmetric(saddle))
        saddle[20, 25] = 1e-15 * np.abs(saddle[[20, 25]]).max()
        agree(not symmetric(saddle), f"in units of {units}")


def test_columns_in_any_order():
    """Which PETSc does not look at where it takes arrays as they are."""
    rows = np.array([0, 2, 4], dtype=PETSc.IntType), np.array([1, 0, 0, 1], dtype=PETSc.IntType)
    M = PETSc.Mat().createAIJWithArrays((2, 2), (*rows, np.ones(4)), comm=PETSc.COMM_SELF)
    mine = np.arange(2) + 2 * COMM.rank
    A = create_torn_matrix(M, mine, (2, 2 * COMM.size), comm=COMM)
    agree(is_symmetric(A))
    A.destroy()
    M.destroy()


def test_form_tells_of_symmetry(torn_grid):
    """What is known counts; else it is looked for."""

    def skew(K, _dofs):
        K[-1][0, 1] += 1e-6

    problem = torn_grid((2, 2), (2, 2), change=skew)
    agree(not is_symmetric(problem.A))
    K, lgmap = problem.A.getISLocalMat(), problem.A.getLGMap()[0]
    sizes = problem.A.getSizes()[0]
    for known in (True, False):
        A = create_torn_matrix(K, lgmap.getBlockIndices(), sizes, comm=COMM, symmetric=known)
        agree(is_symmetric(A) == known)
        K.stateIncrease()
        agree(is_symmetric(A) == known)
        A.destroy()


def test_blocked_matrix_without_near_kernel_is_refused(torn_grid, lifetime):
    torn = lifetime.own(Torn(torn_grid((2, 1), (1, 1), components=2, modes=0).A))
    with raises(SetUpError, "set_near_kernel"):
        torn.near_kernel()


def test_other_matrix_types_are_refused():
    A = PETSc.Mat().createAIJ((4, 4), comm=COMM)
    A.setUp()
    A.assemble()
    with raises(TypeError, "create_torn_matrix"):
        Torn(A)
    A.destroy()


def test_dense_local_matrix_is_refused():
    K = PETSc.Mat().createDense((1, 1), array=np.ones((1, 1)), comm=PETSc.COMM_SELF)
    K.assemble()
    A = dolfinx_feti.create_torn_matrix(K, np.array([COMM.rank]), (1, COMM.size), comm=COMM)
    with raises(ValueError, "AIJ"):
        Torn(A)
    A.destroy()
    K.destroy()


def test_torn_dofs_are_numbered_from_process_to_process(torn_grid, lifetime):
    problem = torn_grid((3,), (2,))
    torn = lifetime.own(Torn(problem.A))
    sizes = COMM.allgather(torn.n)
    agree(torn.start == sum(sizes[: COMM.rank]))
    agree(sum(sizes) == len(problem.to_global))


def test_condensed_pressures_are_noted(torn_grid, lifetime):
    """On the matrix, whoever holds it."""
    problem = torn_grid((2, 2), (2, 2))
    torn = lifetime.own(Torn(problem.A))
    agree(torn.pressures is None)
    set_condensed(problem.A, 7 * COMM.rank)
    agree(torn.pressures == 7 * COMM.rank)
