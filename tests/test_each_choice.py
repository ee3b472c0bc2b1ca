# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which combinations of parameters run on several processes; see ``each_choice`` in conftest.py."""

from __future__ import annotations

import itertools

import pytest
from collective import COMM, agree

TRIED: list[tuple[str, tuple[int, int]]] = []
LETTERS = "abc"
PAIRS = [(1, 1), (1, 2), (2, 2), (2, 1)]


@pytest.mark.parametrize("letter", LETTERS)
@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_combination(letter, one, other):
    TRIED.append((letter, (one, other)))


def test_each_choice():
    """One process runs all combinations; several run four, with every letter and every pair."""
    if not TRIED:
        pytest.skip("test_combination, whose choice this looks at, is not selected")
    if COMM.size == 1:
        agree(sorted(TRIED) == sorted(itertools.product(LETTERS, PAIRS)), TRIED)
    else:
        agree(len(TRIED) == 4, TRIED)
        agree({letter for letter, _ in TRIED} == set(LETTERS), TRIED)
        agree({pair for _, pair in TRIED} == set(PAIRS), TRIED)
