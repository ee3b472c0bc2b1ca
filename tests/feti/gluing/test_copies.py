# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Sums, averages and scalar products of copies, against the dense T."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal, small, whole

from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.gluing.weights import create_weights

SEED = 77


@pytest.fixture
def copies_of(pattern):
    made = []

    def create(problem, **options):
        read = pattern(problem.A, **options)
        weights = create_weights(read.torn, read.gluing, read.torn.stiffness())
        made.append(Copies(read.torn, read.dofs.interface, weights.delta))
        weights.destroy()
        return made[-1], whole(made[-1].dofs + read.torn.start)

    yield create
    for each in made:
        each.destroy()


@pytest.mark.parametrize("kind", ["all_floating", "classical"])
@pytest.mark.parametrize("shape", [(1, 1), (3, 2), (2, 2, 2)])
def test_sum_average_and_product(kind, shape, torn_grid, copies_of):
    """T Tᵀ t, T Tᵀ δ t and xᵀ y; nothing is left of dofs with a prescribed value."""
    problem = torn_grid(shape, [2] * len(shape), components=len(shape))
    copies, rows = copies_of(problem, type=kind)
    T = np.where(problem.dirichlet, 0.0, problem.T[rows])
    values = np.random.default_rng(SEED).standard_normal((2, len(rows)))
    last = COMM.scan(copies.n)
    t, s = values[:, last - copies.n : last]
    δ = whole(copies.delta)
    equal(whole(copies.sum(t)), T @ (T.T @ values[0]), 1e-14)
    equal(whole(copies.average(t)), T @ (T.T @ (δ * values[0])), 1e-14)
    x, y = T.T @ (δ * values)[0], T.T @ (δ * values)[1]
    small(copies.dot(copies.average(t), copies.average(s)) - x @ y, 1e-12 * max(1.0, abs(x @ y)))
    t, s = copies.average(t), copies.average(s)
    equal(copies.dots((t, s), (s, s)), [copies.dot(t, s), copies.dot(s, s)], 1e-14)
    agree(len(copies.row) == np.count_nonzero((T @ T.T)[last - copies.n : last]))


def test_copies_agree_to_the_last_bit(torn_grid, copies_of):
    """Each copy gets the same sum, in whatever order the processes answer."""
    problem = torn_grid((2, 2, 2), (2, 2, 2))
    copies, rows = copies_of(problem, type="all_floating")
    t = np.random.default_rng(SEED + COMM.rank).standard_normal(copies.n)
    total, dof = whole(copies.sum(t)), problem.to_global[rows]
    for each in np.unique(dof):
        agree(len(np.unique(total[dof == each])) == 1)
