# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Columns that fall into panels, against the same columns as one dense matrix."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal

from dolfinx_feti.feti.subdomain.factors.dense import TILE, PackedMatrix, pack
from dolfinx_feti.feti.subdomain.panels import Panels, load_panels, rows_product

SEED = 1815


def some_panels(n):
    """A whole panel, one on a few rows, one of no rows, one on a single row, one of no columns."""
    rng = np.random.default_rng(SEED)
    rows = [np.arange(n), np.arange(0, n, 3), np.arange(0), np.array([n - 1]), np.arange(2)]
    widths = [4, 2, 3, 1, 0]
    values = [rng.standard_normal((len(of), k)) for of, k in zip(rows, widths, strict=True)]
    W = np.zeros((n, 0))
    for k, of, part in zip(widths, rows, values, strict=True):
        columns = np.zeros((n, k))
        columns[of] = part
        W = np.hstack([W, columns])
    return of_panels(n, rows, widths, values), W


def of_panels(n, rows, widths, values):
    first = np.cumsum([0, *map(len, rows)])
    first, rows, widths = (
        np.asarray(array, dtype=np.int32) for array in (first, np.concatenate([*rows, []]), widths)
    )
    code = load_panels(COMM)
    return Panels(code, n, first, rows, widths, np.concatenate([*map(np.ravel, values), []]))


@pytest.mark.parametrize("n", [5, TILE, 2 * TILE + 7])
def test_products_are_those_of_the_dense_columns(n, monkeypatch):
    """S is in packed format, as Schur complements are; every entry of a result is written."""
    monkeypatch.setattr(np, "empty", lambda shape, dtype=float: np.full(shape, np.nan, dtype))
    panels, W = some_panels(n)
    rng = np.random.default_rng(SEED)
    S, Y = rng.standard_normal((n, n)), rng.standard_normal((n, 3))
    S = S + S.T
    agree(panels.shape == W.shape)
    equal(panels.dense(), W)
    equal(panels.overlap(Y), W.T @ Y, 1e-13 * n)
    E = panels.overlap(S @ W, symmetric=True)
    equal(E, W.T @ S @ W, 1e-13 * n**2)
    equal(panels.product(S), S @ W, 1e-13 * n)
    single = S.astype(np.float32)
    for rows in (S, single):
        found = rows_product(panels.code, rows, Y[:, 0])
        equal(found, rows.astype(np.float64) @ Y[:, 0], 1e-13 * n)
    equal(panels.squares(), (W**2).sum(axis=0), 1e-13 * n)
    matrix = PackedMatrix(pack(S), n, np.empty(n * n))
    equal(matrix.multiply_panels(panels), S @ W, 1e-13 * n)


@pytest.mark.parametrize("n", [0, 3])
def test_no_panels(n):
    panels = of_panels(n, [], [], [])
    agree(panels.shape == (n, 0) == panels.dense().shape == panels.product(np.eye(n)).shape)
    agree(panels.overlap(np.ones((n, 2))).shape == (0, 2) and len(panels.squares()) == 0)
    matrix = PackedMatrix(pack(np.eye(n)), n, np.empty(n * n))
    agree(matrix.multiply_panels(panels).shape == (n, 0))
