# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The rooms of the package, read off its folders: the one list of what is where.

The docstring of each folder's ``__init__.py`` names its modules and folders in the order of the
data, and the first line of a module's docstring says what it does. A number of the paper, with the
label in its source if there is one, ``eq. 44, Augustin_eq:projection`` or ``eq. 48``, says which
equation the module holds; files of benchmarks/ may name numbers, too. From these and from
``paper_index.py`` the tables of docs/equations.md are written, and for the site docs/modules.md:

    python3 scripts/rooms.py            write the tables
    python3 scripts/rooms.py --check    exit status 1 if they are out of date
    python3 scripts/rooms.py --modules  write docs/modules.md

``tests/test_rooms.py`` holds the imports against the same order.
"""

from __future__ import annotations

import ast
import itertools
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from paper_index import EQUATIONS, FIGURES, NOWHERE, TABLES

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "dolfinx_feti"

ORDER = re.compile(r"In the order of the data:\s+(.*?)\.$", re.S | re.M)
NUMBER = re.compile(r"\beq\. (\d+)(?:, (Augustin_eq:\w+|eq:\w+|stressmag)\b)?")


@dataclass(frozen=True, slots=True)
class Module:
    """A file of the package.

    Attributes:
        name: Its dotted name below the package, such as ``feti.coarse.coarse``.
        path: The file.
    """

    name: str
    path: Path

    @property
    def room(self) -> str:
        """Path of its folder below the package."""
        return self.name.rpartition(".")[0].replace(".", "/")

    @property
    def summary(self) -> str:
        """The first line of the docstring, without its full stop."""
        return docstring(self.path).splitlines()[0].rstrip(".")


def docstring(path: Path) -> str:
    """Return the docstring of a file."""
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""


def order(folder: Path) -> list[str]:
    """Return the names in a folder in the order that its docstring gives.

    Raises:
        ValueError: The docstring gives none.
    """
    found = ORDER.search(docstring(folder / "__init__.py"))
    if found is None:
        raise ValueError(f"{folder}/__init__.py does not give the order of its modules")
    return re.split(r",\s+", found[1])


def modules(folder: Path = PACKAGE) -> Iterator[Module]:
    """Yield the modules of a folder and of those in it, in the order of the data."""
    for name in order(folder):
        path = folder / f"{name}.py"
        if (folder / name).is_dir():
            yield from modules(folder / name)
        else:
            parts = path.relative_to(PACKAGE).with_suffix("").parts
            yield Module(".".join(parts), path)


def rooms() -> Iterator[tuple[str, str, list[Module]]]:
    """Yield runs of modules in one folder: its path below the package, its summary, the modules.

    A folder with files before and after a subfolder comes twice.
    """
    for room, inside in itertools.groupby(modules(), key=lambda module: module.room):
        yield room, docstring(PACKAGE / room / "__init__.py").splitlines()[0], list(inside)


def overview() -> str:
    """Format the table of all files."""
    rows = ["| folder | file | what it does |", "|---|---|---|"]
    for room, _, inside in rooms():
        for i, module in enumerate(inside):
            first = f"`{room or 'dolfinx_feti'}/`" if i == 0 else ""
            rows.append(f"| {first} | `{module.path.name}` | {module.summary} |")
    return "\n".join(rows)


def modules_page() -> str:
    """Format docs/modules.md."""
    page = [
        "# Modules",
        "",
        "The files of the package in the order of the data: a file imports only from files above "
        "it. The texts are the modules' own.",
        "",
        overview(),
    ]
    for room, summary, inside in rooms():
        page += ["", f"## {room or 'dolfinx_feti'}/", "", summary if room else "Used everywhere."]
        for module in inside:
            page += ["", f"### {module.name.rpartition('.')[2]}", "", "```{eval-rst}"]
            page += [
                f".. automodule:: dolfinx_feti.{module.name}",
                "   :no-members:",
                "   :noindex:",
                "```",
            ]
    return "\n".join(page)


def equations_in(path: Path) -> set[int]:
    """Return the numbers of the paper's equations that a file names.

    Raises:
        ValueError: There is no such equation, or its label is another one.
    """
    found = set()
    for digits, label in NUMBER.findall(" ".join(path.read_text(encoding="utf-8").split())):
        number = int(digits)
        if not 1 <= number <= len(EQUATIONS):
            raise ValueError(f"{path} names eq. {number}; the paper has {len(EQUATIONS)} equations")
        if label and label != EQUATIONS[number - 1].label:
            theirs = EQUATIONS[number - 1].label or "no label"
            raise ValueError(f"{path} calls eq. {number} {label}; the paper has {theirs}")
        found.add(number)
    return found


def equations() -> dict[int, list[Path]]:
    """Return the files that name each equation in a docstring."""
    files = [module.path for module in modules()]
    files += sorted((ROOT / "benchmarks").rglob("*.py"))
    named = {path: equations_in(path) for path in files}
    numbers = range(1, len(EQUATIONS) + 1)
    return {n: [path for path in files if n in named[path]] for n in numbers}


def equations_page() -> str:
    """Format the tables of docs/equations.md: equations, tables and figures of the paper."""
    rows = ["| eq. | what it states | label in the source | file |", "|---|---|---|---|"]
    for number, paths in equations().items():
        entry = EQUATIONS[number - 1]
        names = ", ".join(f"`{path.relative_to(ROOT)}`" for path in paths) or NOWHERE[number]
        label = f"`{entry.label}`" if entry.label else ""
        rows.append(f"| {number} | {entry.subject} | {label} | {names} |")
    rows += ["", "## Tables and figures", ""]
    rows += ["| in print | what it shows | label in the source | here |", "|---|---|---|---|"]
    for kind, results in (("table", TABLES), ("figure", FIGURES)):
        for number, result in enumerate(results, start=1):
            rows.append(
                f"| {kind} {number} | {result.subject} | `{result.label}` | {result.here} |"
            )
    return "\n".join(rows)


def pages() -> dict[Path, str]:
    """Return what the generated pages have to hold."""
    equations = ROOT / "docs" / "equations.md"
    return {equations: between(equations, equations_page())}


def between(path: Path, table: str) -> str:
    """Return a page with the table between its marks."""
    begin = "<!-- rooms: begin -->"
    end = "<!-- rooms: end -->"
    head, found, rest = path.read_text(encoding="utf-8").partition(begin)
    tail = rest.partition(end)[2]
    if not found or not tail:
        raise ValueError(f"{path} lacks the marks {begin} and {end}")
    return f"{head}{begin}\n\n{table}\n\n{end}{tail}"


def main(arguments: list[str]) -> int:
    """Write the pages, or say which of them are out of date."""
    if not set(arguments) <= {"--check", "--modules"}:
        print("rooms: write no option, --check or --modules", file=sys.stderr)
        return 2
    if "--modules" in arguments:
        (ROOT / "docs" / "modules.md").write_text(modules_page() + "\n", encoding="utf-8")
        return 0
    stale = {
        path: text for path, text in pages().items() if path.read_text(encoding="utf-8") != text
    }
    if "--check" in arguments:
        for path in stale:
            print(f"{path.relative_to(ROOT)} is out of date: run python3 scripts/rooms.py")
        return int(bool(stale))
    for path, text in stale.items():
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
