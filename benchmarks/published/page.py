# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the published numbers: a section for each case, a row for each mesh.

python3 -m benchmarks.published.page build/published.json --output build/results
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from benchmarks.common.pages import Fields, groups, write_page
from benchmarks.common.records import Record
from benchmarks.published.cases import CASES

__all__ = ["main"]


def _fields(records: Sequence[Record]) -> Fields:
    """Return the cases in their order, with their meshes; the finest one is judged."""
    sections = []
    for (name,), mine in groups(records, "case"):
        case = CASES[name]
        rows = [
            row | {"apart": abs(row["mumps"] / row["value"] - 1)}
            for row in sorted(mine, key=lambda row: int(row["mesh"]))
        ]
        value = rows[-1]["value"]
        holds = case.low <= value <= case.high
        section = {field: getattr(case, field) for field in ("name", "source", "quantity")}
        spread = {"published": case.published, "low": case.low, "high": case.high}
        ours = {"case": name, "rows": rows, "value": value, "holds": holds}
        sections.append(ours | section | spread)
    return {"cases": sorted(sections, key=lambda each: list(CASES).index(each["case"]))}


main = partial(
    write_page,
    __file__,
    "published",
    known=lambda record: record.get("case") in CASES,
    fields=_fields,
)

if __name__ == "__main__":
    main()
