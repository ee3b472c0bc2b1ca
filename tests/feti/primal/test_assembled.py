# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a subdomain sees of the assembled interface, against dense matrices."""

from __future__ import annotations

from functools import partial

import numpy as np
import primal_form
import pytest
from collective import COMM, agree, raises, small

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.primal.assembled import (
    assembled_products,
    copy_block,
    load_block_code,
    shares_of_neighbours,
)

GRID = {"subdomains": (3, 2), "cells": (3, 2), "components": 2}
every_type = pytest.mark.parametrize("kind", ["all_floating", "classical"])


@every_type
@pytest.mark.parametrize("interior", ["keep", "eliminate"])
def test_products_with_the_assembled_matrix(kind, interior, torn_grid, form):
    """T_i A T_iᵀ of the formed S, with neighbours on any process; δ^−½ S_i δ^−½ otherwise."""
    problem = torn_grid(**GRID)
    primal = form(problem, type=kind, interior=interior)
    exact, copies = primal_form.reference(problem, primal), primal.copies
    start = COMM.scan(copies.n) - copies.n
    glued = exact.T.any(axis=1)  # the rows without a prescribed value
    coupled = exact.T @ exact.T.T > 0.0
    product = assembled_products(primal.parts.operator, copies)
    worst = 0.0
    for i, block in enumerate(copies.blocks):
        rows = np.arange(start + block.start, start + block.stop)
        copies_of = coupled[rows].astype(float)  # T_i Tᵀ: the copies of each row
        alone = ~glued[rows]
        copies_of[alone, rows[alone]] = 1.0
        A = copies_of @ exact.S @ copies_of.T
        if interior == "keep":
            root = np.where(alone, 1.0, exact.delta[rows]) ** -0.5
            A = root[:, None] * exact.S[np.ix_(rows, rows)] * root
        found = product(i)(np.eye(len(rows)))
        worst = max(worst, float(np.abs(found - A).max(initial=0.0) / np.abs(A).max(initial=1.0)))
    small(worst, 1e-10 if interior == "keep" else 1e-6)  # A is unpacked in single precision


def test_a_block_that_fails_on_one_process(torn_grid, form):
    """All raise before a message is awaited; on one process no block is sent."""
    primal = form(torn_grid(**GRID), interior="eliminate")

    def block(i, rows):
        if COMM.rank == COMM.size - 1:
            raise MemoryError("no room")
        return np.zeros(len(rows) * (len(rows) + 1) // 2)

    if COMM.size == 1:
        shares = shares_of_neighbours(primal.copies, block)
        with raises(MemoryError, "no room"):
            shares(0)
        return
    with raises(SetUpError, "no room"):
        shares_of_neighbours(primal.copies, block)


def test_rows_in_any_order(torn_grid, form):
    """The lower triangle of a block, row by row."""
    operator = form(torn_grid(**GRID), interior="eliminate").parts.operator
    block = partial(copy_block, load_block_code(COMM), operator)
    for i, Γ in enumerate(operator.interface):
        S = operator.multiply_many(i, np.eye(len(Γ)))
        rows = np.random.default_rng(i).permutation(len(Γ))[:5].astype(np.int32)
        expected = S[np.ix_(rows, rows)][np.tril_indices(len(rows))]
        agree(np.allclose(block(i, rows), expected, rtol=1e-12))
