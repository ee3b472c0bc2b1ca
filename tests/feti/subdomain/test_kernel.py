# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Kernels of subdomains: what is left of the rigid body modes, and null vectors beyond them."""

from petsc4py import PETSc

import hand_torn
import numpy as np
import pytest
import scipy.linalg
from cases import each, every_interior, every_type
from collective import COMM, agree, equal, small, whole
from mixed import errors_of_solves
from modes import modes_of
from walls import tube, wall

from dolfinx_feti.feti.subdomain import nullspace
from dolfinx_feti.feti.subdomain.blocks import sparse_block
from dolfinx_feti.feti.subdomain.factors.dense import DenseFactor, PackedMatrix, pack
from dolfinx_feti.feti.subdomain.factors.direct import Choice
from dolfinx_feti.feti.subdomain.factors.multifrontal import create_fronts, load_fronts
from dolfinx_feti.feti.subdomain.factors.pivoted import PivotedFactor
from dolfinx_feti.feti.subdomain.factors.regularised import factor_by_fronts
from dolfinx_feti.feti.subdomain.modes import kernel_basis
from dolfinx_feti.feti.subdomain.nullspace import factor_tells_singular, null_space
from dolfinx_feti.runtime.connectivity import block_graph
from dolfinx_feti.runtime.petsc_library import rows_of

SEED = 60221
BRICK = (2, 2, 2)
NODES = np.argwhere(np.ones((3, 3, 3))) * 1.0


def vertex(x):
    return np.all(x == 0.0, axis=1)


def edge(x):
    return np.all(x[:, :2] == 0.0, axis=1)


def face(x):
    return x[:, 0] == 0.0


def component(*which):
    return lambda mask: np.stack([mask if j in which else 0 * mask for j in range(3)], axis=-1)


#: Where a brick is held, in which components, and how many rigid body modes are left.
HELD = {
    "nowhere": (lambda x: np.zeros(len(x), dtype=bool), component(0, 1, 2), 6),
    "one component of a vertex": (vertex, component(1), 5),
    "two components of a vertex": (vertex, component(0, 2), 4),
    "a vertex": (vertex, component(0, 1, 2), 3),
    "one component along an edge": (edge, component(0), 4),
    "the axis of an edge": (edge, component(2), 5),
    "an edge": (edge, component(0, 1, 2), 1),
    "one component of a face": (face, component(0), 3),
    "two components of a face": (face, component(0, 1), 1),
    "a face": (face, component(0, 1, 2), 0),
    "three faces, one component each": (lambda x: x == 0.0, lambda mask: mask, 0),
    "all of it": (lambda x: np.full(len(x), True), component(0, 1, 2), 0),
}


@each(("where", "components", "dimension"), HELD)
def test_kernel_is_what_a_singular_value_decomposition_finds(where, components, dimension):
    """The tested candidates against the null space of the brick's matrix without its fixed dofs."""
    _, K = hand_torn.brick(BRICK, 3)
    fixed = components(where(NODES)).astype(bool).ravel()
    R = kernel_basis(hand_torn.kernel(NODES, 3), fixed)
    equal(R.shape, (np.count_nonzero(~fixed), dimension))
    K_free = K[np.ix_(~fixed, ~fixed)]
    equal(R.T @ R, np.eye(dimension), 1e-14)
    small(np.abs(K_free @ R).max(initial=0.0), 1e-12 * np.abs(K).max())
    null = scipy.linalg.null_space(K_free, rcond=1e-10) if len(K_free) else np.zeros((0, 0))
    agree(null.shape[1] == dimension, f"{null.shape[1]} null vectors, {dimension} candidates")
    equal(null @ (null.T @ R), R, 1e-11)


@each(("where", "components", "dimension"), HELD)
def test_classical_kernel_agrees_with_inertia(where, components, dimension, torn_grid, parts):
    """The factor of the regularised matrix is positive definite: the kernel is no larger.

    Another subdomain is held by a face, so that the whole is regular; it has no kernel.
    """

    def fixed(x):
        return components(where(x)).astype(bool) | (x[:, :1] == 4.0)

    problem = torn_grid((2, 1, 1), BRICK, components=3, fixed=fixed)
    system = parts(problem.A, type="classical")
    free = ~problem.dirichlet[problem.dofs[1]]
    second = scipy.linalg.null_space(problem.K[1][np.ix_(free, free)], rcond=1e-10).shape[1]
    equal(whole(modes_of(system).dimensions), [dimension, second])
    counts = [factor.pivots for factor in system.inverse.factors]
    agree(all(count == (0, 0) for count in counts), counts)


def test_too_few_candidates_are_no_silent_error(torn_grid, feti):
    """Without the rotations the regularised matrices are singular but for rounding.

    Either the missing mode is found as one of negative stiffness, or the solver says it failed.
    """
    problem = torn_grid((2, 2), (2, 2), components=2, modes=2)
    ksp = feti(problem.A)
    values = hand_torn.random_values(problem)
    reason, x = hand_torn.solve(ksp, problem, values)
    expected = problem.solve(values)
    right = np.abs(x - expected).max() < 1e-7 * np.abs(expected).max()
    agree(right or (reason < 0 and ksp.getPythonContext().message))


def test_modes_that_coincide_on_a_subdomain_count_once():
    """On a single node a rotation is a translation."""
    modes = np.hstack([np.eye(3), np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])])
    equal(kernel_basis(modes, np.zeros(3, dtype=bool)).shape, (3, 3))
    equal(kernel_basis(np.eye(3), np.ones(3, dtype=bool)).shape, (0, 0))


@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_kernel_does_not_depend_on_the_origin(shift):
    """Far from the origin rotations look like translations to one part in a million."""
    modes = hand_torn.kernel(NODES + shift, 3)
    fixed = component(0, 1, 2)(edge(NODES)).astype(bool).ravel()
    R = kernel_basis(np.linalg.qr(modes)[0], fixed)
    _, K = hand_torn.brick(BRICK, 3)
    agree(R.shape[1] == 1, R.shape)
    eps = np.finfo(float).eps
    small(np.abs(K[np.ix_(~fixed, ~fixed)] @ R).max(), 100 * eps * (1 + shift) * np.abs(K).max())


# ---- null vectors of random matrices --------------------------------------------------------

every_size = pytest.mark.parametrize("dense", [1000, 10], ids=["all vectors", "inverse iteration"])
every_kind = pytest.mark.parametrize("kind", ["pivots", "fronts", "dense"])


def singular(n, nullity, spread, *, softest=1e-6):
    """A positive semi-definite matrix, its null vectors, and its diagonal; scales far apart."""
    rng = np.random.default_rng(SEED + n)
    root = 10.0 ** (spread * (rng.random(n) - 0.5))
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    values = np.concatenate([np.zeros(nullity), np.geomspace(softest, 1.0, n - nullity)])
    K = root[:, None] * ((Q * values) @ Q.T) * root
    K = 0.5 * (K + K.T)
    return K, Q[:, :nullity] / root[:, None], np.abs(K.diagonal())


@pytest.fixture
def factor_of(lifetime):
    """What factors a matrix as one block, given R, ρ and a shift."""

    def create(K, kind):
        rows = np.arange(len(K), dtype=np.int32)
        if kind == "dense":
            S = PackedMatrix(pack(K), len(K), np.empty(len(K) ** 2))
            return lambda R=None, rho=1.0, shift=None: DenseFactor(S, R, rho, shift)
        M = lifetime.own(PETSc.Mat().createAIJ(K.shape, nnz=len(K), comm=PETSc.COMM_SELF))
        M.setValues(rows, rows, K)
        M.assemble()

        def factor(R=None, rho=1.0, shift=None):
            if kind == "fronts" and shift is None:
                R = K[:, :0] if R is None else R
                with rows_of(M) as of_M:
                    graph = block_graph(of_M, 1)
                    fronts = create_fronts(load_fronts(COMM), graph, rows, rows, 1, rows[:0])
                    by_fronts = factor_by_fronts(fronts, of_M, np.empty(fronts.work), R, rho)
                if by_fronts is not None:
                    return by_fronts
            return lifetime.own(PivotedFactor(M, rows, Choice("null_", True, 8), R, rho, shift))

        return factor

    return create


def refactored(factor):
    return lambda known, shift: factor(known, 1.0, shift)


@every_size
@every_kind
@pytest.mark.parametrize("spread", [0.0, 3.0])
@pytest.mark.parametrize(("known", "unknown"), [(0, 0), (3, 0), (0, 2), (3, 3), (1, 14)])
def test_null_vectors_are_found(dense, kind, spread, known, unknown, factor_of, monkeypatch):
    """All of them but those that are known, whatever the scales."""
    monkeypatch.setattr(nullspace, "ALL_VECTORS", dense)
    K, null, d = singular(50, known + unknown, spread)
    R = np.linalg.qr(null[:, :known])[0]
    factor = factor_of(K, kind)
    agree(factor_tells_singular(factor(R, float(d.mean())), d) == (unknown > 0))
    Y = null_space(lambda X: K @ X, refactored(factor), d, R)
    agree(Y.shape == (50, unknown), Y.shape)
    root = np.sqrt(d)[:, None]
    both = np.linalg.qr(root * np.hstack([R, Y]))[0]
    expected = np.linalg.qr(root * null)[0]
    small(np.linalg.norm(expected - both @ (both.T @ expected)), 1e-6)


@every_kind
@pytest.mark.parametrize("softest", [1e-9, -1e-9])
def test_soft_and_buckling_modes_are_no_null_vectors(kind, softest, factor_of):
    K, _, d = singular(40, 0, 2.0, softest=abs(softest))
    if softest < 0.0:
        values, Q = np.linalg.eigh(K)
        K = K - 2.0 * values[0] * np.outer(Q[:, 0], Q[:, 0])
    factor = factor_of(K, kind)
    agree(not factor_tells_singular(factor(), d))
    agree(null_space(lambda X: K @ X, refactored(factor), d).shape[1] == 0)


def test_right_null_vectors_of_an_unsymmetric_matrix(factor_of):
    rng = np.random.default_rng(SEED)
    K = rng.standard_normal((30, 28)) @ rng.standard_normal((28, 30))
    Y = null_space(lambda X: K @ X, refactored(factor_of(K, "pivots")), np.abs(K.diagonal()))
    agree(Y.shape == (30, 2))
    small(np.abs(K @ Y).max(), 1e-10 * np.abs(K).max() * np.abs(Y).max())


# ---- a few P2–P0 cells ----------------------------------------------------------------------

QUARTER = {"media": 2, "around": 11, "along": 1, "length": 0.13, "quarter": True}
CELLS = 198


def quarter_tube(subdomains, kappa=1000.0, **options):
    body = wall(tube(**QUARTER), kappa=kappa, quarter=True)
    return body, body.problem(subdomains, options)


@every_interior
@pytest.mark.parametrize("kappa", [1000.0, 1e5])
@pytest.mark.parametrize("subdomains", [64, CELLS])
def test_kernel_of_a_few_cells(subdomains, kappa, interior, parts):
    """A cell has three null vectors beside the rigid ones; all count as kernel, with D = 0."""
    _, problem = quarter_tube(subdomains, kappa)
    problem._system.residual()
    problem._system.linearise()
    system = parts(problem.A, interior=interior, coarse_modes=0)
    torn, modes = system.torn, modes_of(system)
    expected = []
    for rows in torn.subdomains:
        K = sparse_block(torn.K, rows, rows).toarray()
        root = np.sqrt(K.diagonal())
        scaled = K / root[:, None] / root
        expected.append(scipy.linalg.null_space(scaled, rcond=1e-11).shape[1])
    equal(np.array(modes.kernel, dtype=np.int64), expected)
    agree(len(whole(np.array(expected))) >= subdomains and COMM.allreduce(sum(expected)) > 0)
    agree(subdomains < CELLS or set(expected) <= {9}, expected)
    agree(all(modes.exact))
    small(max((np.abs(D).max(initial=0.0) for D in modes.D), default=0.0), 0.0)
    error = 0.0
    for i, (E, rho) in enumerate(zip(modes.E, modes.rho, strict=True)):
        image = system.operator.local_product(i, E)
        error = max(error, np.abs(image).max(initial=0.0) / rho)
    small(error, 1e-11)


@every_interior
@every_type
def test_few_cells_agree_with_a_direct_solver(kind, interior):
    """Every linear solve of a load step, with null vectors at rest and without them under load."""
    body, problem = quarter_tube(64, feti_type=kind, feti_interior=interior, ksp_rtol=1e-10)
    errors = errors_of_solves(problem)
    steps = body.inflate(problem, [5.0])
    agree(len(steps) == len(errors) >= 3)
    small(max(errors), 1e-8)
    small(max(step.linear_residual for step in steps), 1e-10)
