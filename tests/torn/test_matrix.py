# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A torn matrix acts as the assembled operator, and carries what the solver reads."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import scipy.sparse
from collective import COMM, agree, dense, equal, raises, whole

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.runtime.petsc_library import CSRMatrix
from dolfinx_feti.torn import symmetry
from dolfinx_feti.torn.connectivity import block_graph, diagonal_places
from dolfinx_feti.torn.matrix import Torn, create_torn_matrix, set_condensed_pressures
from dolfinx_feti.torn.rounding import EPS, product_rounding_squares
from dolfinx_feti.torn.symmetry import is_symmetric

SEED = 60914


@pytest.fixture
def create_torn(torn_grid, lifetime):
    """Return a function that tears a brick and returns it, its ``Torn``, and the own torn dofs."""

    def create(*arguments, **options):
        problem = torn_grid(*arguments, **options)
        torn = lifetime.own(Torn(problem.A))
        return problem, torn, slice(torn.first_torn_dof, torn.first_torn_dof + torn.n)

    return create


@pytest.mark.parametrize(
    ("subdomains", "cells", "components"), [((3,), (4,), 1), ((2, 2), (2, 3), 2)]
)
def test_torn_matrix_acts_as_the_assembled_one(
    create_torn, subdomains, cells, components, lifetime
):
    """T, K and Tᵀ agree with those made by hand, for vectors and columns."""
    problem, torn, own_rows = create_torn(subdomains, cells, components=components)
    rng = np.random.default_rng(SEED)
    x = rng.standard_normal(len(problem.dirichlet))
    t = rng.standard_normal(len(problem.to_global))
    x_vec = lifetime.own(problem.vector(x))
    y_vec = lifetime.own(problem.A.createVecLeft())
    problem.A.mult(x_vec, y_vec)
    equal(whole(y_vec.array_r), problem.matrix @ x, 1e-13)
    assembled = lifetime.own(problem.A.convert("aij", PETSc.Mat()))
    equal(dense(assembled), problem.matrix, 1e-13)
    equal(whole(torn.tear(x_vec.array_r)), problem.T @ x)
    equal(whole(torn.assemble(t[own_rows])), problem.T.T @ t, 1e-14)
    equal(whole(torn.multiplicity()), problem.T.sum(axis=0).astype(int))
    equal(whole(torn.is_dirichlet_copy), problem.dirichlet[problem.to_global])
    equal(whole(torn.is_dirichlet), problem.dirichlet)
    for columns in ((), (0,), (1,), (3,)):
        t = rng.standard_normal((len(problem.to_global), *columns))
        equal(whole(torn.multiply(t[own_rows])), problem.K_torn @ t, 1e-13)
        equal(whole(torn.multiply(t[own_rows], transpose=True)), problem.K_torn.T @ t, 1e-13)


@pytest.mark.parametrize("wrong", [-1, 3, 10**6])
def test_dof_numbers_out_of_range_are_refused(wrong, lifetime):
    """All processes raise, even if one alone has such a number: PETSc would wait."""
    K = lifetime.own(PETSc.Mat().createAIJ((2, 2), nnz=2, comm=PETSc.COMM_SELF))
    K.setValues([0, 1], [0, 1], [2.0, -1.0, -1.0, 2.0])
    K.assemble()
    size = (3 if COMM.rank == 0 else 0, 3)
    right = np.array([0, 1])
    last = COMM.rank == COMM.size - 1
    numbers = np.array([0, wrong]) if last else right
    with raises(ValueError, f"torn_to_global has the number {wrong}, but .* are 0 … 2"):
        create_torn_matrix(K, numbers, size, comm=COMM)
    with raises(ValueError, f"dirichlet has the number {wrong}, but .* are 0 … 2"):
        create_torn_matrix(K, right, size, comm=COMM, dirichlet=numbers)
    with raises(ValueError, "torn_to_global has 1 numbers, but the local matrix has 2 rows"):
        create_torn_matrix(K, right[:1] if last else right, size, comm=COMM)


def test_gather_orders_copies_by_dof(monkeypatch, create_torn):
    """Gathering does not need ``MPI._typedict``, which is private to mpi4py."""
    monkeypatch.delattr(MPI, "_typedict", raising=False)
    problem, torn, _ = create_torn((2, 2), (2, 2))
    gathered = whole(torn.gather(torn.first_torn_dof + np.arange(torn.n, dtype=np.float64)))
    copies = np.split(gathered.astype(int), np.cumsum(problem.T.sum(axis=0).astype(int))[:-1])
    agree(
        all(sorted(c) == list(np.flatnonzero(problem.T[:, j])) for j, c in enumerate(copies)),
        gathered,
    )


def test_subdomains_are_numbered_from_process_to_process(create_torn):
    """So are their dofs; each subdomain is a block of the local matrix."""
    problem, torn, _ = create_torn((3, 2), (2, 1), components=2)
    counts = COMM.allgather(len(torn.subdomains))
    sizes = COMM.allgather(torn.n)
    equal(COMM.allreduce([len(rows) for rows in torn.subdomains]), [len(K) for K in problem.K])
    agree(all(np.all(np.diff(rows) > 0) for rows in torn.subdomains))
    agree(torn.first_subdomain == sum(counts[: COMM.rank]) and sum(counts) == 6)
    agree(torn.first_torn_dof == sum(sizes[: COMM.rank]) and sum(sizes) == len(problem.to_global))


@pytest.mark.parametrize("full", [True, False])
@pytest.mark.parametrize("bs", [1, 2, 3])
def test_block_graph_has_an_edge_for_each_nonzero_block(bs, full):
    """A block counts, even if it has a single entry."""
    rng = np.random.default_rng(bs)
    blocks = scipy.sparse.random_array((30, 30), density=0.1, rng=rng)
    K = scipy.sparse.kron(blocks, np.ones((bs, bs))).tocsr()
    K.sort_indices()
    if not full:
        K.data[rng.permutation(K.nnz)[: K.nnz // 3]] = 0.0
        K.eliminate_zeros()
    graph = block_graph(CSRMatrix(K.indptr, K.indices, K.data), bs)
    expected = np.abs(K.toarray()).reshape(30, bs, 30, bs).sum(axis=(1, 3)) > 0.0
    equal(graph.toarray() != 0, expected)


def test_subdomains_may_be_interleaved(lifetime):
    """Subdomains are connected components, whatever the order of their rows."""
    csr = ([0, 2, 4, 6, 8, 9], [0, 2, 1, 3, 0, 2, 1, 3, 4], np.arange(1.0, 10.0))
    K = lifetime.own(PETSc.Mat().createAIJ((5, 5), csr=csr, comm=PETSc.COMM_SELF))
    dofs = 5 * COMM.rank + np.arange(5)
    A = lifetime.own(create_torn_matrix(K, dofs, (5, 5 * COMM.size), comm=COMM))
    subdomains = [rows.tolist() for rows in lifetime.own(Torn(A)).subdomains]
    agree(subdomains == [[0, 2], [1, 3], [4]])


def test_dirichlet_dofs_may_be_named_by_any_process(torn_grid, lifetime):
    """The index set may have dofs that other processes own, and some of them twice."""
    problem = torn_grid((2, 2), (2, 2))
    dofs = np.flatnonzero(problem.dirichlet)
    named = dofs if COMM.rank == COMM.size - 1 else dofs[:1]
    problem.A.compose("dirichlet", PETSc.IS().createGeneral(named.astype(PETSc.IntType), comm=COMM))
    torn = lifetime.own(Torn(problem.A))
    equal(whole(torn.is_dirichlet_copy), problem.dirichlet[problem.to_global])


def test_near_kernel_is_orthonormal_and_spans_the_modes(create_torn):
    """The torn near kernel has the copies of the assembled vectors."""
    problem, torn, _ = create_torn((2, 1, 1), (2, 2, 1), components=3)
    modes = np.column_stack([whole(v.array_r) for v in problem.A.getNearNullSpace().getVecs()])
    equal(modes.T @ modes, np.eye(6), 1e-14)
    coefficients = np.linalg.lstsq(modes, problem.modes)[0]
    equal(modes @ coefficients, problem.modes, 1e-13)
    equal(whole(torn.near_kernel()), modes[problem.to_global])


def test_near_kernel_is_required_only_with_several_components(create_torn):
    """With one component it is the constant."""
    _, scalar, _ = create_torn((3,), (2,), modes=0)
    equal(scalar.near_kernel(), np.ones((scalar.n, 1)))
    _, blocked, _ = create_torn((2, 1), (1, 1), components=2, modes=0)
    with raises(SetUpError, "set_near_kernel"):
        blocked.near_kernel()


def test_stiffness_is_the_diagonal_unless_it_is_attached(create_torn, lifetime):
    """Under compression a diagonal entry may be negative; a weight must not be."""

    def compress(K, dofs):
        np.fill_diagonal(K[0], -0.3 * K[0].diagonal())

    problem, torn, own_rows = create_torn(
        (2, 2), (2, 2), change=compress, stiffness=lambda i: 10.0**i
    )
    diagonal = np.diag(problem.K_torn)
    agree(diagonal.min() < 0.0)
    equal(torn.diagonal(), diagonal[own_rows])
    equal(torn.stiffness(), np.abs(diagonal[own_rows]))
    weight = 1.0 + np.arange(torn.n)
    sizes = problem.A.getSizes()[0]
    to_global = problem.to_global[own_rows]
    A = lifetime.own(
        create_torn_matrix(problem.local, to_global, sizes, comm=COMM, stiffness=weight)
    )
    weight[:] = -1.0  # the matrix has taken a copy
    equal(lifetime.own(Torn(A)).stiffness(), 1.0 + np.arange(torn.n))


@pytest.mark.parametrize("components", [1, 2, 3])
def test_torn_dofs_have_the_coordinates_of_their_nodes(components, create_torn):
    """Components need not be as many as dimensions; without coordinates there are none."""
    dim = 3 if components == 1 else components
    problem, torn, _ = create_torn((2,) * dim, (1,) * dim, components=components)
    equal(whole(torn.coordinates()), problem.x[problem.to_global // components])
    problem.A.compose("coordinates", None)
    agree(torn.coordinates() is None)


@pytest.mark.parametrize("kappa", [1.0, 1e6])
def test_symmetry_is_judged_entry_by_entry(kappa, lifetime):
    """A skew entry of 1e-8 relative to the diagonal of its rows is not rounding, even beside κ."""
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
        arrays = (csr.indptr, csr.indices, csr.data)
        M = lifetime.own(PETSc.Mat().createAIJ((n, n), csr=arrays, comm=PETSc.COMM_SELF))
        dofs = np.arange(n) + n * COMM.rank
        return is_symmetric(
            lifetime.own(create_torn_matrix(M, dofs, (n, n * COMM.size), comm=COMM))
        )

    agree(symmetric(K) and symmetric(K + noise) and symmetric(K + 1e3 * noise))
    for i, j in ((20, 25), (25, 20), (0, 29), (29, 0)):
        skew = K.copy()
        skew[i, j] += 1e-8 * np.sqrt(K[i, i] * K[j, j])
        agree(not symmetric(skew), f"entry ({i}, {j})")
    cyclic = np.roll(np.eye(n), 1, axis=1)
    skew = cyclic - cyclic.T  # rows sum to zero, which a rigid motion does not detect
    roots = np.sqrt(np.outer(K.diagonal(), K.diagonal()))
    agree(not symmetric(K + 1e-9 * skew * roots))
    for units in (1.0, 1e-12, 1e12):  # an entry without counterpart, and no diagonal on either side
        saddle = units * K
        saddle[[20, 25], [20, 25]] = saddle[20, 25] = saddle[25, 20] = 0.0
        agree(symmetric(saddle))
        saddle[20, 25] = 1e-15 * np.abs(saddle[[20, 25]]).max()
        agree(not symmetric(saddle), f"in units of {units}")


def test_probe_sees_entries_that_nearly_cancel_in_their_rows():
    """Three rows with a pair of opposite entries each: the difference of their weights is left.

    The entries of K − Kᵀ are twice SYMMETRY_RTOL. Weights that differ by a few per cent leave a few
    times PROBE_RTOL of them.
    """
    n = 30
    weights = np.random.default_rng(n).uniform(1.0, 2.0, n)  # as in the probe
    rows = np.argsort(weights)
    first = int(np.argmin(np.abs(weights[rows[2:]] - weights[rows[:-2]] - 0.03)))
    i, j, k = rows[first : first + 3]
    K = np.eye(n)
    for a, b in ((i, j), (j, k), (k, i)):
        K[a, b] = symmetry.SYMMETRY_RTOL
        K[b, a] = -symmetry.SYMMETRY_RTOL
    M = PETSc.Mat().createDense((n, n), array=K, comm=PETSc.COMM_SELF).convert("aij")
    agree(not symmetry._has_symmetric_entries(M))
    M.destroy()


def test_probe_passes_rounding_without_a_look_at_the_entries(monkeypatch):
    """Rounding errors of a sum of 30 terms: PROBE_RTOL has room for them."""
    rng = np.random.default_rng(SEED + 6)
    n = 30
    K = rng.standard_normal((n, n))
    K = K @ K.T + n * np.eye(n)
    K += 1e-15 * n * rng.standard_normal((n, n))
    monkeypatch.delattr(symmetry, "csr_of")
    M = PETSc.Mat().createDense((n, n), array=K, comm=PETSc.COMM_SELF).convert("aij")
    agree(symmetry._has_symmetric_entries(M))
    M.destroy()


def test_symmetry_is_detected_with_unsorted_columns(lifetime):
    """PETSc does not sort the columns of arrays that it uses without a copy."""
    rows = np.array([0, 2, 4], dtype=PETSc.IntType), np.array([1, 0, 0, 1], dtype=PETSc.IntType)
    csr = (*rows, np.ones(4))
    M = lifetime.own(PETSc.Mat().createAIJWithArrays((2, 2), csr, comm=PETSc.COMM_SELF))
    own_dofs = np.arange(2) + 2 * COMM.rank
    A = create_torn_matrix(M, own_dofs, (2, 2 * COMM.size), comm=COMM)
    agree(is_symmetric(lifetime.own(A)))


def test_declared_symmetry_is_trusted(torn_grid):
    """Without ``symmetric=`` it is detected."""

    def skew(K, _dofs):
        K[-1][0, 1] += 1e-6

    problem = torn_grid((2, 2), (2, 2), change=skew)
    agree(not is_symmetric(problem.A))
    K = problem.A.getISLocalMat()
    lgmap = problem.A.getLGMap()[0]
    sizes = problem.A.getSizes()[0]
    for declared in (True, False):
        A = create_torn_matrix(K, lgmap.getBlockIndices(), sizes, comm=COMM, symmetric=declared)
        agree(is_symmetric(A) == declared)
        K.stateIncrease()
        agree(is_symmetric(A) == declared)
        A.destroy()


def test_other_matrix_types_are_refused(lifetime):
    """The torn matrix is a MATIS, and its local matrices are AIJ."""
    A = lifetime.own(PETSc.Mat().createAIJ((4, 4), comm=COMM))
    A.assemble()
    with raises(TypeError, "create_torn_matrix"):
        Torn(A)
    K = lifetime.own(PETSc.Mat().createDense((1, 1), array=np.ones((1, 1)), comm=PETSc.COMM_SELF))
    K.assemble()
    A = create_torn_matrix(K, np.array([COMM.rank]), (1, COMM.size), comm=COMM)
    with raises(ValueError, "AIJ"):
        Torn(lifetime.own(A))


def test_number_of_condensed_pressures_is_stored_in_the_matrix(create_torn):
    """Any object that refers to the matrix reads the present number."""
    problem, torn, _ = create_torn((2, 2), (2, 2))
    agree(torn.n_condensed_pressures is None)
    set_condensed_pressures(problem.A, 7 * COMM.rank)
    agree(torn.n_condensed_pressures == 7 * COMM.rank)


# -- entries of a sequential matrix that are read in place


def test_diagonal_places_of_unsorted_rows():
    """A row without a diagonal entry has place −1."""
    K = scipy.sparse.random_array((60, 60), density=0.2, rng=SEED, format="csr")
    K.setdiag(np.arange(1.0, 61.0))
    K = scipy.sparse.csr_array(K)
    K.data[K.data == 7.0] = 0.0  # row 6 has no diagonal entry, once it is taken out
    K.eliminate_zeros()
    rng = np.random.default_rng(SEED)
    for order in (np.sort, rng.permutation):
        indices = np.concatenate([order(row) for row in np.split(K.indices, K.indptr[1:-1])])
        row = np.repeat(np.arange(60), np.diff(K.indptr))
        values = K.toarray()[row, indices]
        csr = (K.indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), values)
        matrix = PETSc.Mat().createAIJWithArrays((60, 60), csr, comm=PETSc.COMM_SELF)
        place = diagonal_places(matrix)
        agree((place < 0).nonzero()[0].tolist() == [6], place)
        equal(np.where(place < 0, 0.0, values[place]), K.diagonal())
        matrix.destroy()


def test_rounding_of_a_product_is_that_of_its_terms(create_torn):
    """Its square is estimated by ε² Σ_j K_ij² t_j²."""
    problem, torn, own_rows = create_torn((2, 2), (3, 2), components=2)
    t = np.random.default_rng(SEED).standard_normal(len(problem.to_global))
    squares = whole(product_rounding_squares(torn.K, t[own_rows]))
    equal(squares / EPS**2, (problem.K_torn**2) @ t**2, 1e-13)


def test_destroyed_matrix_is_refused():
    """A destroyed matrix is an empty one of PETSc's; the message says what has to be kept."""
    empty = PETSc.Mat().create(COMM)
    with raises(TypeError, "has no type, as after its destruction.*Keep the problem"):
        Torn(empty)
    empty.destroy()
