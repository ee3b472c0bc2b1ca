# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Soft and buckling modes against dense eigenvectors, their effect on solves; orthonormal bases."""

import numpy as np
import pytest
from cases import every_type
from collective import COMM, agree, equal, small
from hand_torn import random_values, softened, solve

from dolfinx_feti.feti.setup import set_up
from dolfinx_feti.feti.subdomain.orthonormal import (
    append_orthonormal,
    orthonormal,
    orthonormalising,
)
from dolfinx_feti.feti.subdomain.soft import ALL_MODES, POWERS, buckling_modes, soft_modes

SEED = 1744
SIZES = (60, ALL_MODES + 100)  # dense, and by subspace iteration or Lanczos' method

every_size = pytest.mark.parametrize("n", SIZES)


def matrix(n, values, most=2.0):
    """A symmetric matrix with some given eigenvalues, others from 1 to most, and its vectors."""
    rng = np.random.default_rng(SEED)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    spectrum = np.concatenate([values, np.geomspace(1.0, most, n - len(values))])
    return (Q * spectrum) @ Q.T, Q[:, : len(values)]


def solver(K):
    inverse = np.linalg.inv(K)
    return lambda X: inverse @ X


def spans(Y, expected, tolerance):
    """Assert that the columns Y span those expected."""
    Q = np.linalg.qr(Y)[0]
    agree(Y.shape == expected.shape, (Y.shape, expected.shape))
    small(np.linalg.norm(expected - Q @ (Q.T @ expected), 2), tolerance)


@every_size
@pytest.mark.parametrize(("threshold", "count"), [(1e-4, 1), (1e-2, 2), (0.1, 3), (0.5, 4)])
def test_soft_modes_are_those_below_the_threshold(n, threshold, count):
    """With unit weights μ is an eigenvalue of K, and each power takes μ off the error.

    Of a large subdomain one that is close to the threshold is not found for sure.
    """
    values = [5e-5, 5e-3, 5e-2, 0.3] if n <= ALL_MODES else [5e-5, 5e-3, 5e-2, 0.15]
    K, modes = matrix(n, values)
    Y = soft_modes(solver(K), np.ones(n), 12, threshold)
    spans(Y, modes[:, :count], 1e-10 if n <= ALL_MODES else 10.0 * values[count - 1] ** POWERS)


@every_size
def test_soft_modes_are_the_softest_that_may_join(n):
    """K y = μ k y: the same K is soft beside a stiff interface only."""
    K, modes = matrix(n, [1e-4, 1e-3, 2e-3, 5e-3])
    spans(soft_modes(solver(K), np.ones(n), 2, 1e-2), modes[:, :2], 0.05)
    for most, threshold in ((0, 1e-2), (12, 0.0)):
        agree(soft_modes(solver(K), np.ones(n), most, threshold).shape == (n, 0))
    K, modes = matrix(n, [0.05])
    agree(soft_modes(solver(K), np.ones(n), 12, 1e-2).shape[1] == 0)
    spans(soft_modes(solver(K), np.full(n, 10.0), 1, 1e-2), modes, 0.05)


@every_size
@pytest.mark.parametrize(
    ("values", "most"), [((-0.5, -0.02, -1e-3), 2.0), ((-1e5, -1.0, -0.5), 1e5)]
)
def test_buckling_modes(values, most, n):
    """The inverse shows those near zero, the matrix one that is far below."""
    K, modes = matrix(n, values, most)
    spans(
        buckling_modes(solver(K), lambda X: K @ X, n, 3), modes, 1e-10 if n <= ALL_MODES else 0.05
    )


@every_type
def test_more_soft_modes_fewer_iterations(kind, torn_grid, feti):
    """Slender subdomains bend softly; the solution stays what it is."""
    problem = torn_grid((2, 3), (16, 2), components=2)
    values = random_values(problem)
    iterations, sizes = [], []
    for threshold in (0.0, 0.01, 0.5):
        ksp = feti(
            problem.A, feti_type=kind, feti_coarse_threshold=threshold, feti_coarse_modes=20,
            ksp_rtol=1e-10,
        )  # fmt: skip
        reason, x = solve(ksp, problem, values)
        agree(reason > 0)
        small(np.abs(x - problem.solve(values)).max(), 1e-6)
        iterations.append(ksp.getIterationNumber())
        sizes.append(ksp.getPythonContext().report().coarse_size)
    agree(sizes[0] < sizes[1] < sizes[2], sizes)
    agree(iterations[2] < iterations[1] < iterations[0], iterations)


@pytest.mark.parametrize(
    ("taken", "adaptive", "found"),
    [(0.0, 9, False), (0.0, 0, True), (1e-6, 9, False), (1e-3, 9, True)],
    ids=["at rest", "no adaptive columns", "hardly softened", "softened"],
)
def test_adaptive_columns_take_the_place_of_soft_modes(
    taken, adaptive, found, torn_grid, pattern, lifetime
):
    """In the primal form; not where stress takes a share of the stiffness away."""
    problem = torn_grid((2, 3), (16, 2), components=2, change=softened(taken))
    options = {"interior": "eliminate", "coarse_adaptive": adaptive, "coarse_threshold": 0.5}
    setup = set_up(pattern(problem.A, **options), lifetime, lifetime, rough=True)
    agree((COMM.allreduce(sum(modes.soft for modes in setup.inverse.modes)) > 0) == found)


# ---- orthonormal bases, and columns that depend on others -----------------------------------

EPS = np.finfo(float).eps


def columns(n, rank, repeated):
    """Columns of sizes from 1e-3 to 1e3, and combinations of them, up to rounding."""
    rng = np.random.default_rng(1907)
    X = rng.standard_normal((n, rank)) * np.geomspace(1e-3, 1e3, rank)
    return np.hstack([X, X @ rng.standard_normal((rank, repeated))])


@pytest.mark.parametrize("repeated", [0, 3])
def test_bases_in_euclids_scalar_product(repeated):
    X = columns(40, 4, repeated)
    Q, B = orthonormal(X), orthonormalising(X)
    agree(Q.shape == (40, 4) and B.shape == (4 + repeated, 4))
    equal(Q.T @ Q, np.eye(4), 100 * EPS)
    small(np.abs(X - Q @ (Q.T @ X)).max(), 1e2 * EPS * np.abs(X).max())
    equal((X @ B).T @ X @ B, np.eye(4), 1e6 * 100 * EPS)  # κ = 1e6


def test_append_orthonormal():
    """The columns are orthonormal, and what is there already is dropped."""
    rng = np.random.default_rng(1907)
    R = np.linalg.qr(rng.standard_normal((30, 4)))[0]
    new = rng.standard_normal((30, 2))
    wider = append_orthonormal(R, np.hstack([R[:, :1] + R[:, 2:3], 1e9 * new, 0.0 * new]))
    agree(wider.shape == (30, 6))
    equal(wider[:, :4], R)
    equal(wider.T @ wider, np.eye(6), 1e-13)
    small(np.abs(new - wider @ (wider.T @ new)).max(), 1e-10)
