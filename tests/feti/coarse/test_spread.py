# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The inverse of a coarse matrix in blocks for the pairs of groups of processes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from collective import COMM, agree, equal

from dolfinx_feti.feti.coarse.spread import SpreadInverse, pairs_of_groups

pytestmark = pytest.mark.processes(1, 2, 3, 4, 8)

SEED = 9173


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("rows", ["alike", "some have none"])
def test_product_with_blocks_is_that_with_the_inverse(rows, symmetric):
    """A symmetric one is stored once but for the blocks on the diagonal."""
    sizes = np.array([5 if rows == "alike" or rank % 2 else 0 for rank in range(COMM.size)])
    starts = np.append(0, np.cumsum(sizes))
    K, own = int(starts[-1]), slice(*starts[COMM.rank : COMM.rank + 2])
    rng = np.random.default_rng(SEED)
    matrix = rng.standard_normal((K, K))
    matrix += matrix.T if symmetric else 0.0
    inverse = SpreadInverse(matrix[own].copy(), starts, symmetric=symmetric, comm=COMM)
    for b in rng.standard_normal((3, K)):
        equal(inverse.solve(b[own]), (matrix @ b)[own], 1e-13)
    stored, all_of_it = COMM.allreduce(inverse.nbytes), matrix.nbytes
    agree(stored < all_of_it if symmetric and COMM.size >= 3 and K > 10 else stored <= all_of_it)


@pytest.mark.processes(1)
@pytest.mark.parametrize("processes", [1, 2, 3, 5, 6, 14, 15, 512, 10_000])
def test_every_pair_of_groups_has_one_process(processes):
    """And the homes of a group are half of its pairs, or some more where processes are left."""
    pairs, home = pairs_of_groups(processes)
    groups = 1 + int(home.max())
    wanted = list(itertools.combinations_with_replacement(range(groups), 2))
    assert sorted((i, j) for i, j in pairs.tolist() if j >= 0) == wanted
    assert len(pairs) == len(home) == processes < len(wanted) + groups + 1
    assert (pairs == home[:, None]).any(axis=1).all()
    homes = np.bincount(home)
    assert homes.min() >= groups // 2 and homes.max() <= groups // 2 + 2
