# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The letters of docs/notation.md are those of the code, and the other way round."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
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
    """Names in the columns headed "code"."""
    cells = [row["code"] for row in rows(page) if "code" in row]
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


def names(path: Path) -> Iterator[str]:
    """Yield the names of variables, arguments, attributes, functions and classes."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                yield name
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                yield name


def variables(path: Path) -> Iterator[str]:
    """Yield the names of variables and arguments."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.Name(id=name) | ast.arg(arg=name):
                yield name


def is_letter(name: str) -> bool:
    """Whether a name is a capital, or a Greek letter of either case."""
    return len(name) == 1 and (name.isupper() or not name.isascii())


def test_every_documented_name_is_in_the_code():
    code = {name for path in PACKAGE.rglob("*.py") for name in names(path)}
    documented_names = documented(PAGE.read_text(encoding="utf-8"))
    parts = {part for name in documented_names for part in name.split(".")}
    assert len(parts) > 60
    assert not parts - code


@pytest.mark.parametrize("room", ["feti", "problems", "fem", "mechanics", "workshop", "wall"])
def test_every_letter_of_the_code_is_documented(room):
    letters = {
        name.strip("_")
        for path in (PACKAGE / room).rglob("*.py")
        for name in variables(path)
        if is_letter(name.strip("_"))
    }
    assert letters
    assert not letters - documented(PAGE.read_text(encoding="utf-8"))


def test_tables_are_read():
    """A row that is cut in other columns than its head would go unread."""
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
    assert all(map(is_letter, "KΓρ"))
    assert not any(map(is_letter, ["k", "", "KR", "B_D"]))
