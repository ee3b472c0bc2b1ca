# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What of a test with several parameters is tried on several processes, see ``conftest.py``."""

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
    """All combinations on one process; else four, with all letters and all of the pairs."""
    if not TRIED:
        pytest.skip("test_combination, whose choice this looks at, is not selected")
    if COMM.size == 1:
        agree(sorted(TRIED) == sorted(itertools.product(LETTERS, PAIRS)), TRIED)
    else:
        agree(len(TRIED) == 4, TRIED)
        agree({letter for letter, _ in TRIED} == set(LETTERS), TRIED)
        agree({pair for _, pair in TRIED} == set(PAIRS), TRIED)
