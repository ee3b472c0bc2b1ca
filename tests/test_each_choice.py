# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""On several processes a few combinations of parameters run, which have every value."""

from __future__ import annotations

import itertools

import pytest
from collective import COMM, agree

COMBINATIONS: list[tuple[str, tuple[int, int]]] = []
LETTERS = "abc"
PAIRS = [(1, 1), (1, 2), (2, 2), (2, 1)]


@pytest.mark.parametrize("letter", LETTERS)
@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_combination_is_recorded(letter, one, other):
    """Record the combinations that run; the next test checks them."""
    COMBINATIONS.append((letter, (one, other)))


def test_chosen_combinations_have_every_value():
    """One process runs all combinations; several run four, with every letter and every pair."""
    if not COMBINATIONS:
        pytest.skip("test_combination_is_recorded, whose choice is checked here, is not selected")
    if COMM.size == 1:
        agree(sorted(COMBINATIONS) == sorted(itertools.product(LETTERS, PAIRS)), COMBINATIONS)
    else:
        agree(len(COMBINATIONS) == 4, COMBINATIONS)
        agree({letter for letter, _ in COMBINATIONS} == set(LETTERS), COMBINATIONS)
        agree({pair for _, pair in COMBINATIONS} == set(PAIRS), COMBINATIONS)
