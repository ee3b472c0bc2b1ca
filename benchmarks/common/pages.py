# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pages of studies: templates in Markdown, filled with values from records.

Fields are those of :meth:`str.format`, ``{kappa:g}`` or ``{times[local]:.2f}``; in addition
to its formats there are those of :data:`FORMS`, and unknown values are shown as a dash. A line that
ends in ``<!-- rows -->`` is written once for each entry of the field ``rows``, whose values take
precedence over the page's. A heading that ends so marks its section, up to the next heading of its
level::

    ## Solvers on the {body} <!-- bodies -->

    | solver | seconds |
    | --: | --: |
    | {solver} | {seconds:.2f} | <!-- rows -->

A table of more than :data:`MAX_ROWS` rows, or :data:`MAX_CELLS` cells, is folded: the page shows a
line that opens it. Each number on a page comes from a record.
"""

from __future__ import annotations

import re
import string
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from benchmarks.common.records import Record

Fields = Mapping[str, Any]

MARK = re.compile(r" *<!-- (\w+) -->$")
TABLE = re.compile(r"(?:^\|.*\n)+", re.M)

#: Largest numbers of rows and of cells of a table that is shown open: about half a screen.
MAX_ROWS = 8
MAX_CELLS = 30

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


def fold_tables(text: str) -> str:
    """Return a page whose long tables are folded into lines that open them.

    The tags are HTML, which a site and a viewer of Markdown both show; the empty lines inside them
    begin and end the Markdown.
    """

    def fold(found: re.Match[str]) -> str:
        table = found[0]
        lines = table.splitlines()
        columns = len(lines[0].strip("| ").split(" | "))
        rows = len(lines) - 2  # without the heading and the line below it
        if rows <= MAX_ROWS and rows * columns <= MAX_CELLS:
            return table
        number = f"{rows} row{'s' if rows > 1 else ''}"
        return f"<details>\n<summary>Table of {number}</summary>\n\n{table}\n</details>\n"

    return TABLE.sub(fold, text)


def provenance(records: Sequence[Record]) -> dict[str, object]:
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
