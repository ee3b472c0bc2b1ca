# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pages of studies: templates in Markdown, filled with values from records.

Fields are those of :meth:`str.format`, such as ``{kappa:g}`` or ``{times[local]:.2f}``. In addition
to its formats there are those of :data:`FORMS`. A value that is unknown is shown as a dash, and so
is a field whose name is misspelt: :func:`missing_fields` finds those.

A line that ends in ``<!-- rows -->`` is written once for each entry of the field ``rows``. The
values of an entry take precedence over those of the page. A heading that ends so repeats its whole
section, up to the next heading of its level::

    ## Solvers on the {body} <!-- bodies -->

    | solver | seconds |
    | --: | --: |
    | {solver} | {seconds:.2f} | <!-- rows -->

Below each table is a line with the days, commits and processors of its records. The records of an
entry are its field ``sources``; without it, the entry itself if it has the machine or the date of a
record; else the page's field ``records``. A table of more than :data:`MAX_ROWS` rows, or
:data:`MAX_CELLS` cells, is folded: the page shows a line that opens it. Each number on a page comes
from a record.
"""

from __future__ import annotations

import re
import string
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from benchmarks.common.records import Record

#: Values by the names of a template's fields.
Fields = Mapping[str, Any]

#: End of a line or heading that is repeated for the entries of a field.
MARK = re.compile(r" *<!-- (\w+) -->$")
#: A table, with the line of its records.
TABLE = re.compile(r"((?:^\|.*\n)+)(\n\*Records? of .*\*\n)?", re.M)

#: Most commits that are named below a table; more are counted.
MAX_COMMITS = 3

#: Line that stands for the end of a section.
END = "<!-- end -->"

#: Largest numbers of rows and of cells of a table that is shown open: about half a screen.
MAX_ROWS = 8
MAX_CELLS = 30

#: Formats of values by name, in addition to those of Python.
FORMS: dict[str, Callable[[Any], str]] = {
    "count": lambda value: f"{value:,.0f}".replace(",", " "),  # 12 345
    "number": lambda value: f"{value:.4g}",  # four digits
    "percent": lambda value: f"{100 * value:.2g} %",  # 0.123 as 12 %
    "off": lambda value: f"{100 * (value - 1):+.1f} %".replace(
        "-", "−"
    ),  # a quotient: 0.95 as −5.0 %
    "share": lambda value: f"{100 * value:.1f} %",  # 0.123 as 12.3 %
    "short": lambda value: f"{value:.0e}".replace("e-0", "e-"),  # order of magnitude: 1e-8
    "yes": lambda value: "yes" if value else "**no**",
}


def fill(template: str, fields: Fields) -> str:
    """Return a template filled with values.

    Args:
        template: Text with fields and marks, as above.
        fields: Values of the page; a marked line or section is repeated for the Fields in a list.
    """
    filled: list[str] = []
    for text, repeated in _sections(template):
        entries = [{}] if repeated is None else fields[repeated]
        filled += [_lines(text, {**fields, **each}) for each in entries]
    return "".join(filled)


def missing_fields(template: str, fields: Fields) -> set[str]:
    """Return the fields of a template that neither the page nor any of its entries has.

    They are misspelt, or the records have none of their values.
    """
    missing: set[str] = set()
    for text, repeated in _sections(template):
        sections = [fields] if repeated is None else [fields | each for each in fields[repeated]]
        for line in text.splitlines():
            line, mark = _split_mark(line)
            names = {re.split(r"[.\[]", name)[0] for _, name, *_ in _FORMATTER.parse(line) if name}
            known = {
                name
                for of_section in sections
                for each in ([{}] if mark is None else of_section[mark])
                for name in of_section | each
            }
            missing |= names - known if sections else set()
    return missing


def section(rows: Iterable[Fields], **fields: object) -> list[dict[str, object]]:
    """Return the entries of a section with a table: one, or none if the table has no rows.

    Without an entry the page leaves the section out.

    Args:
        rows: Entries of the table.
        fields: Further values of the section.
    """
    entries = list(rows)
    return [{"rows": entries} | fields] if entries else []


def groups(
    records: Iterable[Record], *names: str
) -> Iterator[tuple[tuple[Any, ...], list[Record]]]:
    """Yield each combination of values of some parameters, and the records that have it.

    Args:
        records: Records; the combinations come in their order.
        names: Keys of the parameters.
    """
    by_values: dict[tuple[Any, ...], list[Record]] = {}
    for record in records:
        by_values.setdefault(tuple(record[name] for name in names), []).append(record)
    yield from by_values.items()


def fold_tables(text: str) -> str:
    """Return a page whose long tables are folded into lines that open them.

    The tags are HTML, which a site and a viewer of Markdown both show; the empty lines inside them
    begin and end the Markdown.
    """

    def fold(match: re.Match[str]) -> str:
        table, origin_line = match.groups("")
        lines = table.splitlines()
        columns = len(lines[0].strip("| ").split(" | "))
        rows = len(lines) - 2  # without the heading and the line below it
        if rows <= MAX_ROWS and rows * columns <= MAX_CELLS:
            return match[0]
        number = f"{rows} row{'s' if rows > 1 else ''}"
        return (
            f"<details>\n<summary>Table of {number}</summary>\n\n{table}{origin_line}\n</details>\n"
        )

    return TABLE.sub(fold, text)


def origin(records: Sequence[Record]) -> str:
    """Return a line with days, commits and processors of the records of a table; empty for none.

    If the records are of different days, the line has the number of records of each.
    """
    if not records:
        return ""
    days = Counter(str(record["date"])[:10] if "date" in record else "" for record in records)
    named = [f"{day or 'unknown date'} ({number})" for day, number in sorted(days.items())]
    if len(days) == 1:
        (day,) = days
        named = [day or "unknown date"]
    parts = [f"different days: {', '.join(named)}" if len(days) > 1 else named[0]]
    commits = list(dict.fromkeys(r["commit"] for r in records if r.get("commit")))
    if not commits:
        parts.append("commit not recorded")
    elif len(commits) > MAX_COMMITS:
        parts.append(f"{len(commits)} commits, {commits[0]} to {commits[-1]}")
    else:
        parts.append(f"commit{'s' if len(commits) > 1 else ''} {', '.join(commits)}")
    if any(commit.endswith("+") for commit in commits):
        parts[-1] += " (+ with uncommitted changes)"
    if commits and not all(record.get("commit") for record in records):
        parts.append("commit of some not recorded")
    machines = (record["machine"] for record in records if "machine" in record)
    processors = list(dict.fromkeys(machine["processor"] for machine in machines))
    parts.append(" and ".join(processors) or "machine not recorded")
    return f"*Record{'s' if len(records) > 1 else ''} of {'; '.join(parts)}.*"


def _sources(entry: Fields, fields: Fields) -> Sequence[Record]:
    """Return the records that an entry of a table comes from."""
    if "sources" in entry:
        return entry["sources"]
    if "machine" in entry or "date" in entry:
        return [entry]
    return fields.get("records", [])


def provenance(records: Sequence[Record]) -> dict[str, object]:
    """Return the fields of a page that all studies have: machines, number of cases, dates."""
    machines = dict.fromkeys(
        ", ".join(f"{key} {value}" for key, value in record["machine"].items())
        for record in records
        if "machine" in record
    )
    dates = sorted(str(record["date"])[:10] for record in records if "date" in record)
    return {
        "records": records,
        "machines": [{"machine": machine} for machine in machines],
        "cases": len(records),
        "first": dates[0] if dates else None,
        "last": dates[-1] if dates else None,
    }


def _sections(template: str) -> Iterator[tuple[str, str | None]]:
    """Yield each section, and the name of the field for whose entries it is repeated, or None."""
    for text in re.split(r"^(?=## )", template, flags=re.M):
        head, _, rest = text.partition("\n")
        head, mark = _split_mark(head) if head.startswith("## ") else (head, None)
        yield (text, None) if mark is None else (f"{head}\n{rest}", mark)


def _split_mark(line: str) -> tuple[str, str | None]:
    """Return a line without its mark, and the name of the field that the mark repeats it for."""
    mark = MARK.search(line)
    return (line, None) if mark is None else (line[: mark.start()], mark[1])


def _lines(text: str, fields: Fields) -> str:
    """Return a section with its lines filled, and a line of origin below each table."""
    lines: list[str] = []
    of_table: dict[int, Record] = {}  # the records of the present table, by their identity
    for line in (*text.splitlines(), END):
        if not line.startswith("|") and of_table:
            lines += ["", origin(list(of_table.values()))]
            of_table = {}
        if line == END:
            break
        line, mark = _split_mark(line)
        entries = [{}] if mark is None else fields[mark]
        lines += [_FORMATTER.vformat(line, (), {**fields, **each}) for each in entries]
        if line.startswith("|") and mark is not None:
            sources = [record for each in entries for record in _sources(each, fields)]
            of_table |= {id(record): record for record in sources}
    return "\n".join(lines) + "\n"


class _Formatter(string.Formatter):
    """Fills in fields by FORMS; unknown values and NaN are dashes."""

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
