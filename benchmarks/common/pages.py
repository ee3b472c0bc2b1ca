# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of a study: a template in Markdown, filled with values from records.

Fields are those of :meth:`str.format`, ``{kappa:g}`` or ``{times[local]:.2f}``; beside its formats
there are those of :data:`FORMS`, and what is not known is shown as a dash. A line that ends in
``<!-- rows -->`` is written once for each entry of the field ``rows``, whose own values come before
the page's. A heading that ends so stands for its section, up to the next heading of its level::

    ## Solvers on the {body} <!-- bodies -->

    | solver | seconds |
    | --: | --: |
    | {solver} | {seconds:.2f} | <!-- rows -->

A table of more than :data:`LONGEST` rows, or :data:`LARGEST` cells, goes into a file beside the
page, as CSV, and the page has a link. Each number on a page comes from a record.
"""

from __future__ import annotations

import argparse
import csv
import re
import string
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.common.records import Record, read_records

__all__ = ["FORMS", "Fields", "fill", "groups", "section", "set_aside", "write_page"]

Fields = Mapping[str, Any]

MARK = re.compile(r" *<!-- (\w+) -->$")
TABLE = re.compile(r"(?:^\|.*\n)+", re.M)

#: Rows and cells of a table that a page shows.
LONGEST, LARGEST = 8, 30

#: Formats of values: a whole number in groups of three digits, four digits, a share in two digits,
#: the deviation of a quotient from one, a share, an order of magnitude, and a verdict.
FORMS: dict[str, Callable[[Any], str]] = {
    "count": lambda value: f"{value:,.0f}".replace(",", " "),
    "number": lambda value: f"{value:.4g}",
    "percent": lambda value: f"{100 * value:.2g} %",
    "off": lambda value: f"{100 * (value - 1):+.1f} %".replace("-", "−"),
    "share": lambda value: f"{100 * value:.1f} %",
    "short": lambda value: f"{value:.0e}".replace("e-0", "e-"),
    "yes": lambda value: "yes" if value else "**no**",
}


def fill(template: str, fields: Fields) -> str:
    """Fill a template with values."""
    return "".join(
        _lines(text, {**fields, **each})
        for text, several in _sections(template)
        for each in ([{}] if several is None else fields[several])
    )


def section(rows: Iterable[Fields], **fields: object) -> list[dict[str, object]]:
    """Return the field of a section with a table, which is left out if there are no rows."""
    found = list(rows)
    return [{"rows": found} | fields] if found else []


def groups(
    records: Iterable[Record], *names: str
) -> Iterator[tuple[tuple[Any, ...], list[Record]]]:
    """Yield the values of some parameters, in the order of the records, and who has them."""
    found: dict[tuple[Any, ...], list[Record]] = {}
    for record in records:
        found.setdefault(tuple(record[name] for name in names), []).append(record)
    yield from found.items()


def write_page(
    module: str,
    name: str,
    arguments: Sequence[str] | None = None,
    *,
    known: Callable[[Record], bool],
    fields: Callable[[Sequence[Record]], Fields],
    draw: Callable[[Sequence[Record], Path], Sequence[Fields]] = lambda _records, _folder: (),
) -> str:
    """Write the page that a command line asks for; return it with all of its tables.

    Args:
        module: The study's ``page.py``, beside its template ``page.md``.
        name: Of the page.
        arguments: The command line without the program's name; None for that of the process.
        known: Tells whether a record is one of the study.
        fields: Makes the values of the template.
        draw: Draws pictures into a folder, and returns the field ``pictures``.
    """
    template = Path(module).with_suffix(".md")
    study = f"benchmarks.{template.parent.name}"
    parser = argparse.ArgumentParser(f"{study}.page", description=f"Write the page {name}.md.")
    parser.add_argument("records", type=Path, nargs="+", metavar="JSON", help=f"files of {study}")
    parser.add_argument("--output", type=Path, required=True, metavar="FOLDER")
    args = parser.parse_args(arguments)
    page = args.output / f"{name}.md"
    try:
        records = [r for path in args.records for r in read_records(path, known, study)]
        args.output.mkdir(parents=True, exist_ok=True)
        values = {**_provenance(records), **fields(records)}
        values["pictures"] = draw(records, args.output)
        filled = fill(template.read_text(encoding="utf-8"), values)
        text, tables = set_aside(filled, name)
        page.write_text(text, encoding="utf-8")
        _write_tables(args.output / "tables", name, tables)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    return filled


def set_aside(text: str, name: str) -> tuple[str, list[list[list[str]]]]:
    """Replace long tables by links to files; return the text, and the cells of each table."""
    tables: list[list[list[str]]] = []

    def link(found: re.Match[str]) -> str:
        rows = [line.strip("| ").split(" | ") for line in found[0].splitlines()]
        if len(rows) - 2 <= LONGEST and (len(rows) - 2) * len(rows[0]) <= LARGEST:
            return found[0]
        tables.append([[_plain(cell) for cell in row] for row in [rows[0], *rows[2:]]])
        number = f"{len(rows) - 2} row{'s' if len(rows) > 3 else ''}"
        return f"[Table of {number}](tables/{name}_{len(tables)}.csv)\n"

    return TABLE.sub(link, text), tables


def _plain(cell: str) -> str:
    """Return a cell without marks of Markdown, and its numbers without groups of digits."""
    return re.sub(r"(?<=\d) (?=\d{3}\b)", "", cell.strip().replace("**", ""))


def _write_tables(folder: Path, name: str, tables: Sequence[Sequence[Sequence[str]]]) -> None:
    """Write the tables of a page in the place of its earlier ones."""
    for old in folder.glob(f"{name}_*.csv"):
        old.unlink()
    for number, rows in enumerate(tables, start=1):
        folder.mkdir(exist_ok=True)
        with (folder / f"{name}_{number}.csv").open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)


def _provenance(records: Sequence[Record]) -> dict[str, object]:
    """Return machines, number of cases and dates."""
    machines = dict.fromkeys(
        ", ".join(f"{key} {value}" for key, value in record["machine"].items())
        for record in records
        if "machine" in record
    )
    dates = sorted(str(record["date"])[:10] for record in records if "date" in record)
    return {
        "machines": [{"machine": machine} for machine in machines],
        "cases": len(records),
        "first": dates[0] if dates else None,
        "last": dates[-1] if dates else None,
    }


def _sections(template: str) -> Iterator[tuple[str, str | None]]:
    """Yield the sections, and the name of the field for whose entries one is written."""
    for text in re.split(r"^(?=## )", template, flags=re.M):
        head, _, rest = text.partition("\n")
        mark = MARK.search(head) if head.startswith("## ") else None
        yield (text, None) if mark is None else (f"{head[: mark.start()]}\n{rest}", mark[1])


def _lines(text: str, fields: Fields) -> str:
    """Fill the lines of a section."""
    lines = []
    for line in text.splitlines():
        mark = MARK.search(line)
        entries = [{}] if mark is None else fields[mark[1]]
        line = line if mark is None else line[: mark.start()]
        lines += [_FORMATTER.vformat(line, (), {**fields, **each}) for each in entries]
    return "\n".join(lines) + "\n"


class _Formatter(string.Formatter):
    def get_field(self, name: str, args: Sequence[Any], kwargs: Fields) -> tuple[Any, Any]:
        try:
            return super().get_field(name, args, kwargs)
        except (KeyError, IndexError, TypeError):
            return None, name

    def format_field(self, value: Any, form: str) -> str:
        if value is None or value != value:  # nan
            return "–"
        return FORMS[form](value) if form in FORMS else format(value, form)


_FORMATTER = _Formatter()
