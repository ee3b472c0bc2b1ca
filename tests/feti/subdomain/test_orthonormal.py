# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Orthonormal bases and scalar products, with columns that depend on others."""

from __future__ import annotations

import numpy as np
import pytest
from collective import agree, equal, small

from dolfinx_feti.feti.subdomain.orthonormal import (
    append_orthonormal,
    diagonalising,
    null_combinations,
    orthonormal,
    orthonormalising,
)

SEED = 1907
EPS = np.finfo(float).eps


def columns(n, rank, repeated):
    """Columns of sizes from 1e-3 to 1e3, and combinations of them, up to rounding."""
    rng = np.random.default_rng(SEED)
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


@pytest.mark.parametrize("shape", [(0, 3), (3, 0), (0, 0)])
def test_no_columns_or_no_rows(shape):
    X = np.zeros(shape)
    agree(orthonormal(X).shape == (shape[0], 0) and orthonormalising(X).shape == (shape[1], 0))
    equal(np.abs(null_combinations(X, 0.0)), np.eye(shape[1]))
    θ, B = diagonalising(np.zeros((shape[1], shape[1])), 1e-6)
    agree(len(θ) == 0 and B.shape == (shape[1], 0))


@pytest.mark.parametrize("rows", [2, 30])
def test_null_combinations(rows):
    """They are orthonormal, and as many as columns beyond the rank, whatever the shape."""
    X = columns(rows, 2, 3)
    C = null_combinations(X, 1e-10 * np.abs(X).max())
    agree(C.shape == (5, 3))
    equal(C.T @ C, np.eye(3), 100 * EPS)
    small(np.abs(X @ C).max(), 1e2 * EPS * np.abs(X).max())


@pytest.mark.parametrize("signs", [(1, 1, 1, 1), (1, -1, 1, -1)], ids=["definite", "indefinite"])
def test_scalar_product_of_a_gram_matrix(signs):
    """Large, repeated and zero columns count once, or not at all, and the signature stays."""
    rng = np.random.default_rng(SEED)
    X = np.linalg.qr(rng.standard_normal((30, 4)))[0]
    X = np.hstack([X, 1e5 * X[:, :2], 0.0 * X[:, :1]])
    weight = np.linalg.qr(X[:, :4])[0]
    H = X.T @ (weight * signs) @ weight.T @ X
    θ, B = diagonalising(H, 1e-6)
    agree(B.shape == (7, 4) and np.all(np.diff(θ) >= 0.0))
    agree(sorted(np.sign(θ)) == sorted(signs))
    equal(B.T @ H @ B, np.diag(θ), 1e3 * EPS)


def test_append_orthonormal():
    """The columns are orthonormal, and what is there already is dropped."""
    rng = np.random.default_rng(SEED)
    R = np.linalg.qr(rng.standard_normal((30, 4)))[0]
    new = rng.standard_normal((30, 2))
    wider = append_orthonormal(R, np.hstack([R[:, :1] + R[:, 2:3], 1e9 * new, 0.0 * new]))
    agree(wider.shape == (30, 6))
    equal(wider[:, :4], R)
    equal(wider.T @ wider, np.eye(6), 1e-13)
    small(np.abs(new - wider @ (wider.T @ new)).max(), 1e-10)
