# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Ids of parametrised tests; conftest.py refuses those that one cannot type."""

from __future__ import annotations

import pytest
from ids import MAX_LENGTH, id_of, typable

pytestmark = pytest.mark.serial


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("P2-P1", "P2-P1"),
        ("cross point", "cross-point"),
        ("{'feti_type': 'other'}", "feti_type-:-other"),
        ("g(1)/g(0) = −0.7", "g-1-/g-0-=-0.7"),
        ("", "empty"),
        ("−", "empty"),
    ],
    ids=["typable", "blank", "quotes", "signs", "empty", "nothing-left"],
)
def test_ids_have_hyphens_for_what_a_shell_interprets(text, expected):
    """A text that can be typed stays as it is."""
    assert typable(text) == expected


def test_long_texts_are_cut():
    """Two ids of parameters fit on a line with the name of their test."""
    assert typable("x" * 100) == "x" * MAX_LENGTH


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ({"a": 1, "b": len}, "a=1,b=len"),
        ({3, 2, 1}, "1,2,3"),
        ((1.5, "two words"), "1.5,two-words"),
        (lambda: None, "argument"),
        (1.5, None),
    ],
    ids=["mapping", "set", "tuple", "lambda", "number"],
)
def test_ids_of_collections_name_their_entries(value, expected):
    """A function has its name; pytest's own ids of numbers are kept."""
    assert id_of(value, "argument") == expected
