# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The modes of a subdomain: its kernel, soft and buckling modes, and orthonormal bases."""

from types import SimpleNamespace

import hand_torn
import numpy as np
import pytest
import scipy.linalg
from cases import each, every_interior, every_type
from collective import COMM, agree, equal, small, whole
from hand_torn import components_at, edge, face, nowhere, origin, random_values, softened, solve
from mixed import errors_of_solves
from modes import factors_of, modes_of
from walls import tube, wall

from dolfinx_feti.feti.setup import set_up
from dolfinx_feti.feti.subdomain.blocks import sparse_block
from dolfinx_feti.feti.subdomain.generalized_inverse import subdomain_matrices
from dolfinx_feti.feti.subdomain.modes import rigid_modes
from dolfinx_feti.feti.subdomain.orthonormal import (
    append_orthonormal,
    orthonormal,
    orthonormal_combinations,
)
from dolfinx_feti.feti.subdomain.scaled import scale_matrix
from dolfinx_feti.feti.subdomain.soft_modes import (
    MAX_DOFS_FOR_EIGH,
    SUBSPACE_STEPS,
    buckling_modes,
    soft_modes,
)

SEED = 1744
BRICK = (2, 2, 2)
NODES = np.argwhere(np.ones((3, 3, 3))) * 1.0


#: Where a brick is held, in which components, and how many rigid body modes are left.
FIXED_DOFS = {
    "nowhere": (components_at(nowhere), 6),
    "one component of a vertex": (components_at(origin, 1), 5),
    "two components of a vertex": (components_at(origin, 0, 2), 4),
    "a vertex": (components_at(origin, 0, 1, 2), 3),
    "one component along an edge": (components_at(edge, 0), 4),
    "the axis of an edge": (components_at(edge, 2), 5),
    "an edge": (components_at(edge, 0, 1, 2), 1),
    "one component of a face": (components_at(face, 0), 3),
    "two components of a face": (components_at(face, 0, 1), 1),
    "a face": (components_at(face, 0, 1, 2), 0),
    "three faces, one component each": (lambda x: x == 0.0, 0),
    "all of it": (lambda x: np.full(x.shape, True), 0),
}


@each(("is_held", "dimension"), FIXED_DOFS)
def test_kernel_is_the_null_space_without_fixed_dofs(is_held, dimension, torn_grid, create_dual):
    """For a brick that classical FETI holds in some of its dofs, against dense algebra.

    Another subdomain is held by a face, so that the whole is regular; it has no kernel. The factor
    of the regularised matrix is positive definite: the kernel is no larger.
    """

    def fixed(x):
        return is_held(x) | (x[:, :1] == 4.0)

    problem = torn_grid((2, 1, 1), BRICK, components=3, fixed=fixed)
    system = create_dual(problem.A, type="classical")
    errors = {"R is orthonormal": 0.0, "K R = 0": 0.0, "R lies in the null space": 0.0}
    nullities = []
    for K_i in system.inverse.by_subdomain:
        rows = K_i.dofs
        R = K_i.modes.R
        K = problem.K_torn[
            np.ix_(system.torn.first_torn_dof + rows, system.torn.first_torn_dof + rows)
        ]
        null_space = scipy.linalg.null_space(K, rcond=1e-10) if len(K) else K
        of_subdomain = {
            "R is orthonormal": R.T @ R - np.eye(R.shape[1]),
            "K R = 0": K @ R / np.abs(K).max(initial=1.0),
            "R lies in the null space": null_space @ (null_space.T @ R) - R,
        }
        for name, difference in of_subdomain.items():
            errors[name] = np.maximum(errors[name], np.abs(difference).max(initial=0.0))
        nullities.append(null_space.shape[1])
    agree(all(error <= 1e-12 for error in errors.values()), errors)
    equal(whole(modes_of(system).dimensions), whole(np.array(nullities)))
    agree(whole(np.array(nullities))[0] == dimension, nullities)
    counts = [factor.inertia for factor in factors_of(system)]
    agree(all(count == (0, 0) for count in counts), counts)


def test_coinciding_modes_count_once():
    """On a single node a rotation is a translation."""
    modes = np.hstack([np.eye(3), np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])])
    equal(rigid_modes(modes, np.zeros(3, dtype=bool)).shape, (3, 3))
    equal(rigid_modes(np.eye(3), np.ones(3, dtype=bool)).shape, (0, 0))


@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_kernel_does_not_depend_on_the_origin(shift):
    """Far from the origin rotations look like translations to one part in a million."""
    modes = hand_torn.kernel(NODES + shift, 3)
    fixed = components_at(edge, 0, 1, 2)(NODES).ravel()
    R = rigid_modes(np.linalg.qr(modes)[0], fixed)
    _, K = hand_torn.brick(BRICK, 3)
    agree(R.shape[1] == 1, R.shape)
    eps = np.finfo(float).eps
    small(np.abs(K[np.ix_(~fixed, ~fixed)] @ R).max(), 100 * eps * (1 + shift) * np.abs(K).max())


# ---- a few P2–P0 cells ----------------------------------------------------------------------

QUARTER = {"media": 2, "around": 11, "along": 1, "length": 0.13, "quarter": True}
CELLS = 198


def quarter_tube(subdomains, kappa=1000.0, **options):
    """Return a quarter of a short tube, and its problem under no load."""
    body = wall(tube(**QUARTER), kappa=kappa, quarter=True)
    return body, body.problem(subdomains, options)


@every_interior
@pytest.mark.parametrize("kappa", [1000.0, 1e5])
@pytest.mark.parametrize("subdomains", [64, CELLS])
def test_null_vectors_of_few_cells_are_kernel(subdomains, kappa, interior, create_dual):
    """A P2–P0 cell has three beside the rigid ones; all count as kernel, with D = 0."""
    _, problem = quarter_tube(subdomains, kappa)
    problem._system.residual()
    problem._system.linearise()
    system = create_dual(problem.A, interior=interior, coarse_modes=0)
    torn = system.torn
    modes = modes_of(system)
    expected = []
    for rows in torn.subdomains:
        K = sparse_block(torn.K, rows, rows).toarray()
        root = np.sqrt(K.diagonal())
        scaled = K / root[:, None] / root
        expected.append(scipy.linalg.null_space(scaled, rcond=1e-11).shape[1])
    sizes = np.array(modes.n_rigid) + np.array(modes.n_null)
    equal(sizes.astype(np.int64), expected)
    agree(len(whole(np.array(expected))) >= subdomains and COMM.allreduce(sum(expected)) > 0)
    if subdomains == CELLS:
        agree(set(expected) <= {9})
    agree(all(modes.is_exact))
    small(max((np.abs(D).max(initial=0.0) for D in modes.D), default=0.0), 0.0)
    error = 0.0
    matrices = subdomain_matrices(system.operator, system.pattern.analysis)
    for K, K_i in zip(matrices, system.inverse.by_subdomain, strict=True):
        image = K.multiply(K_i.modes.E)
        error = np.maximum(error, np.abs(image).max(initial=0.0) / K_i.modes.rho)
    small(error, 1e-11)


@every_interior
@every_type
def test_few_cells_agree_with_a_direct_solver(kind, interior):
    """Every linear solve of a load step, with null vectors at rest and without them under load."""
    body, problem = quarter_tube(64, feti_type=kind, feti_interior=interior, ksp_rtol=1e-10)
    errors = errors_of_solves(problem)
    steps = body.inflate(problem, [5.0])
    agree(len(steps) == len(errors) >= 3)
    small(np.max(errors), 1e-8)
    small(max(step.linear_residual for step in steps), 1e-10)


# ---- a graded matrix ------------------------------------------------------------------------


class DenseMatrix:
    """A dense ``SubdomainMatrix``, with a dense inverse as factor."""

    def __init__(self, K):
        self.K = K
        self.diagonal_of_K = np.abs(K.diagonal())

    def multiply(self, X):
        return self.K @ X

    def factor(self, R, rho, shift=None, *, is_graded=False):
        addend = 0.0 if shift is None else np.diag(shift)
        inverse = np.linalg.inv(self.K + rho * R @ R.T + addend)
        return SimpleNamespace(solve=lambda X, transpose: inverse @ X, destroy=lambda: None)


@pytest.mark.parametrize("max_dofs_for_svd", [100, 5], ids=["all-vectors", "inverse-iteration"])
def test_null_vectors_are_those_of_the_scaled_matrix(max_dofs_for_svd, monkeypatch):
    """The factor is that of the matrix before its rows were scaled to a unit diagonal."""
    monkeypatch.setattr(
        "dolfinx_feti.feti.subdomain.null_vectors.MAX_DOFS_FOR_SVD", max_dofs_for_svd
    )
    rng = np.random.default_rng(SEED)
    n = 60
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    values = np.append(0.0, np.geomspace(1e-3, 1.0, n - 1))
    row_scale = 10.0 ** rng.uniform(-2.0, 2.0, n)
    K = row_scale[:, None] * ((Q * values) @ Q.T) * row_scale
    scaled = scale_matrix(DenseMatrix(K), np.zeros(n), allow_single_precision=False)
    Y = scaled.null_vectors(np.zeros((n, 0)))
    expected = scaled.scale * Q[:, 0] / row_scale
    check_span(Y, expected[:, None] / np.linalg.norm(expected), 1e-6)


# ---- soft and buckling modes ----------------------------------------------------------------

SIZES = (60, MAX_DOFS_FOR_EIGH + 100)  # dense, and by subspace iteration or Lanczos' method

every_size = pytest.mark.parametrize("n", SIZES)


def matrix_with_eigenvalues(n, values, most=2.0):
    """Return a symmetric matrix, (n, n), and some of its eigenvectors.

    Args:
        n: Order of the matrix.
        values: Some eigenvalues; the others are from 1 to ``most``.
        most: Largest of the others.

    Returns:
        The matrix, and orthonormal eigenvectors to ``values``, (n, len(values)).
    """
    rng = np.random.default_rng(SEED)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    spectrum = np.concatenate([values, np.geomspace(1.0, most, n - len(values))])
    return (Q * spectrum) @ Q.T, Q[:, : len(values)]


def dense_solver(K):
    """Return a function that multiplies columns by K⁻¹."""
    inverse = np.linalg.inv(K)
    return lambda X: inverse @ X


def check_span(Y, expected, tolerance):
    """Assert that the columns Y span those expected."""
    Q = np.linalg.qr(Y)[0]
    agree(Y.shape == expected.shape, (Y.shape, expected.shape))
    small(np.linalg.norm(expected - Q @ (Q.T @ expected), 2), tolerance)


@every_size
@pytest.mark.parametrize(("threshold", "count"), [(1e-4, 1), (1e-2, 2), (0.1, 3), (0.5, 4)])
def test_soft_modes_are_those_below_the_threshold(n, threshold, count):
    """With unit weights μ is an eigenvalue of K, and each subspace step multiplies the error by μ.

    In a large subdomain a mode close to the threshold may be missed.
    """
    values = [5e-5, 5e-3, 5e-2, 0.3] if n <= MAX_DOFS_FOR_EIGH else [5e-5, 5e-3, 5e-2, 0.15]
    K, modes = matrix_with_eigenvalues(n, values)
    Y = soft_modes(dense_solver(K), np.ones(n), 12, threshold)
    check_span(
        Y,
        modes[:, :count],
        1e-10 if n <= MAX_DOFS_FOR_EIGH else 10.0 * values[count - 1] ** SUBSPACE_STEPS,
    )


@every_size
def test_softest_modes_join_first(n):
    """Modes solve K y = μ k y, so that a larger stiffness k of the interface makes K softer."""
    K, modes = matrix_with_eigenvalues(n, [1e-4, 1e-3, 2e-3, 5e-3])
    check_span(soft_modes(dense_solver(K), np.ones(n), 2, 1e-2), modes[:, :2], 0.05)
    for most, threshold in ((0, 1e-2), (12, 0.0)):
        agree(soft_modes(dense_solver(K), np.ones(n), most, threshold).shape == (n, 0))
    K, modes = matrix_with_eigenvalues(n, [0.05])
    agree(soft_modes(dense_solver(K), np.ones(n), 12, 1e-2).shape[1] == 0)
    check_span(soft_modes(dense_solver(K), np.full(n, 10.0), 1, 1e-2), modes, 0.05)


@every_size
@pytest.mark.parametrize(
    ("values", "most"), [((-0.5, -0.02, -1e-3), 2.0), ((-1e5, -1.0, -0.5), 1e5)]
)
def test_buckling_modes_span_the_negative_eigenvectors(values, most, n):
    """Those near zero are found by the inverse of K, those far below it by K."""
    K, modes = matrix_with_eigenvalues(n, values, most)
    check_span(
        buckling_modes(dense_solver(K), lambda X: K @ X, n, 3),
        modes,
        1e-10 if n <= MAX_DOFS_FOR_EIGH else 0.05,
    )


@every_type
def test_more_soft_modes_take_fewer_dual_iterations(kind, torn_grid, create_ksp):
    """Slender subdomains bend softly; the solution does not depend on the modes."""
    problem = torn_grid((2, 3), (16, 2), components=2)
    values = random_values(problem)
    iterations = []
    sizes = []
    for threshold in (0.0, 0.01, 0.5):
        ksp = create_ksp(
            problem.A,
            feti_type=kind,
            feti_coarse_threshold=threshold,
            feti_coarse_modes=20,
            feti_formulation="dual",
            ksp_rtol=1e-10,
        )
        reason, x = solve(ksp, problem, values)
        agree(reason > 0)
        small(np.abs(x - problem.solve(values)).max(), 1e-6)
        iterations.append(ksp.getIterationNumber())
        sizes.append(ksp.getPythonContext().report().coarse_size)
    agree(sizes[0] < sizes[1] < sizes[2], sizes)
    agree(iterations[2] < iterations[1] < iterations[0], iterations)


@pytest.mark.parametrize(
    ("share", "adaptive", "has_soft_modes"),
    [(0.0, 9, False), (0.0, 0, True), (1e-6, 9, False), (1e-3, 9, True)],
    ids=["at-rest", "no-adaptive-columns", "hardly-softened", "softened"],
)
def test_adaptive_columns_replace_soft_modes_in_the_primal_form(
    share, adaptive, has_soft_modes, torn_grid, read_pattern, lifetime
):
    """Not if stress takes a share of the stiffness away."""
    problem = torn_grid((2, 3), (16, 2), components=2, change=softened(share))
    options = {"interior": "eliminate", "coarse_adaptive": adaptive, "coarse_threshold": 0.5}
    setup = set_up(read_pattern(problem.A, **options), lifetime, lifetime, is_primal=True)
    agree(
        (COMM.allreduce(sum(modes.n_soft for modes in setup.inverse.modes)) > 0) == has_soft_modes
    )


# ---- orthonormal bases, and columns that depend on others -----------------------------------

EPS = np.finfo(float).eps


def dependent_columns(n, rank, repeated):
    """Return columns of sizes from 1e-3 to 1e3 and combinations of them, (n, rank + repeated)."""
    rng = np.random.default_rng(1907)
    X = rng.standard_normal((n, rank)) * np.geomspace(1e-3, 1e3, rank)
    return np.hstack([X, X @ rng.standard_normal((rank, repeated))])


@pytest.mark.parametrize("repeated", [0, 3])
def test_orthonormal_bases_have_the_rank_of_the_columns(repeated):
    """Columns that depend on others are dropped, whatever their sizes."""
    X = dependent_columns(40, 4, repeated)
    Q = orthonormal(X)
    B = orthonormal_combinations(X)
    agree(Q.shape == (40, 4) and B.shape == (4 + repeated, 4))
    equal(Q.T @ Q, np.eye(4), 100 * EPS)
    small(np.abs(X - Q @ (Q.T @ X)).max(), 1e2 * EPS * np.abs(X).max())
    equal((X @ B).T @ X @ B, np.eye(4), 1e6 * 100 * EPS)  # κ = 1e6


def test_appended_columns_are_orthonormal():
    """What is in the span already is dropped."""
    rng = np.random.default_rng(1907)
    R = np.linalg.qr(rng.standard_normal((30, 4)))[0]
    new = rng.standard_normal((30, 2))
    wider = append_orthonormal(R, np.hstack([R[:, :1] + R[:, 2:3], 1e9 * new, 0.0 * new]))
    agree(wider.shape == (30, 6))
    equal(wider[:, :4], R)
    equal(wider.T @ wider, np.eye(6), 1e-13)
    small(np.abs(new - wider @ (wider.T @ new)).max(), 1e-10)
