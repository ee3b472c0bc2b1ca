# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From the numbers of the paper's equations to files: complete, and no number is another's."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

import paper_index  # noqa: E402
import rooms  # noqa: E402

sys.path.pop(0)

pytestmark = pytest.mark.serial


def test_numbers_of_print():
    """Counted in the paper: 58 equations, 41 with labels of their own, 9 tables, 9 figures."""
    labels = [entry.label for entry in paper_index.EQUATIONS if entry.label]
    assert (len(paper_index.EQUATIONS), len(labels), len(set(labels))) == (58, 41, 41)
    assert (len(paper_index.TABLES), len(paper_index.FIGURES)) == (9, 9)


def test_every_equation_has_a_file_or_a_reason():
    without = {number for number, files in rooms.equations().items() if not files}
    assert without == set(paper_index.NOWHERE)


def test_page_has_every_equation_table_and_figure():
    page = (ROOT / "docs/equations.md").read_text(encoding="utf-8")
    first = re.findall(r"^\| (\d+|table \d+|figure \d+) \|", page, re.M)
    expected = [str(n) for n in range(1, 59)]
    assert first == expected + [f"{kind} {n}" for kind in ("table", "figure") for n in range(1, 10)]


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("(eq. 44, Augustin_eq:projection has Q = I)", {44}),
        ("eq. 16, Augustin_eq:aniso_1, eq. 17,\n    Augustin_eq:aniso_2).", {16, 17}),
        ("(eq. 48) and eq. 56, stressmag", {48, 56}),
        ("L2 error, eq. 53, eq:L2Error.", {53}),
        ("a sequel. 3 equations, eq 4", set()),
    ],
)
def test_numbers_in_a_file(tmp_path, text, numbers):
    (tmp_path / "a.py").write_text(f'"""{text}"""')
    assert rooms.equations_in(tmp_path / "a.py") == numbers


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("eq. 45, Augustin_eq:projection", "calls eq. 45 Augustin_eq:projection"),
        ("eq. 48, Augustin_eq:gamma", "the paper has no label"),
        ("eq. 59", "the paper has 58 equations"),
        ("eq. 0", "the paper has 58 equations"),
    ],
)
def test_wrong_number_or_label(tmp_path, text, message):
    (tmp_path / "a.py").write_text(f'"""{text}"""')
    with pytest.raises(ValueError, match=message):
        rooms.equations_in(tmp_path / "a.py")
