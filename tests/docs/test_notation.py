# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Letters of the code and numbers of the paper's equations are those of their pages."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import paper_index
import pytest
import rooms
from wall_files import ROOT

PACKAGE = ROOT / "dolfinx_feti"
PAGE = ROOT / "docs/notation.md"

pytestmark = pytest.mark.serial


def rows(page: str) -> Iterator[dict[str, str]]:
    """Yield the rows of all tables, cell by column head."""
    head: list[str] = []
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split(" | ")]
        if not line.startswith("|"):
            head = []
        elif not head:
            head = [cell.strip("| ") for cell in cells]
        elif not set(line) <= set("|- "):
            yield dict(zip(head, cells, strict=True))


def documented(page: str) -> set[str]:
    """Return the names in the columns headed "code"."""
    cells = [row["code"] for row in rows(page) if "code" in row]
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


#: Where nodes of a source have a name: variables, attributes, arguments, functions, classes.
NAMES = {ast.Name: "id", ast.Attribute: "attr", ast.arg: "arg"}
NAMES |= dict.fromkeys((ast.FunctionDef, ast.ClassDef), "name")


def names(path: Path, *kinds: type) -> Iterator[str]:
    """Yield the names in a file, of some kinds of nodes or of all."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if type(node) in (kinds or NAMES):
            yield getattr(node, NAMES[type(node)])


def is_letter(name: str) -> bool:
    """Return True if a name is a capital, or a Greek letter of either case."""
    return len(name) == 1 and (name.isupper() or not name.isascii())


def test_every_documented_name_is_in_the_code():
    code = {name for path in PACKAGE.rglob("*.py") for name in names(path)}
    documented_names = documented(PAGE.read_text(encoding="utf-8"))
    parts = {part for name in documented_names for part in name.split(".")}
    assert len(parts) > 60
    missing = sorted(parts - code)
    assert not missing, missing


ROOMS = ["feti", "problems", "fem", "contact", "mechanics", "workshop", "wall"]


@pytest.mark.parametrize("room", ROOMS)
def test_every_letter_of_the_code_is_documented(room):
    letters = {
        name.strip("_")
        for path in (PACKAGE / room).rglob("*.py")
        for name in names(path, ast.Name, ast.arg)
        if is_letter(name.strip("_"))
    }
    assert letters
    assert not letters - documented(PAGE.read_text(encoding="utf-8"))


def test_tables_are_read():
    """A row with another number of columns than its head is an error."""
    page = "| symbol | code |\n|---|---|\n| $K$ | `K`, `Torn.K` |\n\n| code |\n|---|\n| `a` |\n"
    assert next(rows(page)) == {"symbol": "$K$", "code": "`K`, `Torn.K`"}
    assert documented(page) == {"K", "Torn.K", "a"}
    with pytest.raises(ValueError, match="zip"):
        list(rows("| symbol | code |\n|---|---|\n| K |\n"))


def test_words_are_told_once():
    """One word, one line."""
    words = [word for row in rows(PAGE.read_text(encoding="utf-8")) if (word := row.get("word"))]
    assert len(words) > 60
    assert len(words) == len(set(words))


def test_letters():
    names = ["K", "Γ", "ρ", "k", "", "KR", "B_D"]
    assert list(filter(is_letter, names)) == ["K", "Γ", "ρ"]


# -- equations


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
    ("text", "expected"),
    [
        ("(eq. 44, Augustin_eq:projection has Q = I)", {44}),
        ("eq. 16, Augustin_eq:aniso_1, eq. 17,\n    Augustin_eq:aniso_2).", {16, 17}),
        ("(eq. 48) and eq. 56, stressmag", {48, 56}),
        ("L2 error, eq. 53, eq:L2Error.", {53}),
        ("a sequel. 3 equations, eq 4", set()),
        ("eq. 45, Augustin_eq:projection", "calls eq. 45 Augustin_eq:projection"),
        ("eq. 48, Augustin_eq:gamma", "the paper has no label"),
        ("eq. 59", "the paper has 58 equations"),
        ("eq. 0", "the paper has 58 equations"),
    ],
)
def test_numbers_in_a_file(tmp_path, text, expected):
    """Wrong numbers are errors, and so are numbers with the label of another equation."""
    (tmp_path / "a.py").write_text(f'"""{text}"""')
    if isinstance(expected, set):
        assert rooms.equations_in(tmp_path / "a.py") == expected
        return
    with pytest.raises(ValueError, match=expected):
        rooms.equations_in(tmp_path / "a.py")
