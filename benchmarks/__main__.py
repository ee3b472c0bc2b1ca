# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""``python3 -m benchmarks``: list the studies, their commands, and the time of their records."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
RESULTS = HERE.parent / "docs/results"

#: ``page`` of a study, which names its file of records; studies are not imported, as this is slow.
PAGE = re.compile(r'^    page="(\w+)",$', re.M)


def studies() -> Iterator[tuple[str, str, str]]:
    """Yield the name of each study, the first line of its docstring, and its recorded cost."""
    for path in sorted(HERE.glob("[a-z]*.py")):
        source = path.read_text(encoding="utf-8")
        about = ast.get_docstring(ast.parse(source)) or ""
        page = PAGE.search(source)
        if page is None:
            raise ValueError(f'{path} has no line page="…", in its Study: write the name as text')
        records = RESULTS / f"{page[1]}.json"
        cost = _cost(json.loads(records.read_text(encoding="utf-8"))) if records.is_file() else ""
        yield path.stem, about.split("\n")[0], cost


def _cost(records: list[dict[str, object]]) -> str:
    """Return the number of cases, and the sum of their recorded seconds, as text."""
    names = ("seconds", "seconds_setup", "seconds_solve", "seconds_end_to_end", "seconds_total")
    values = (record.get(name) for record in records for name in names)
    seconds = sum(value for value in values if isinstance(value, int | float))
    if seconds == 0:
        return f" ({len(records)} cases)"
    return f" ({len(records)} cases, at least {seconds / 60:.0f} min)"


if __name__ == "__main__":
    for name, about, cost in studies():
        print(f"python3 -m benchmarks.{name:14s} {about}{cost}")
