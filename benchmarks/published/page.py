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
from benchmarks.published.result_file import PUBLISHED
from benchmarks.published.run import LIMIT

__all__ = ["main"]


def _fields(records: Sequence[Record]) -> Fields:
    """Return the cases in their order, with their meshes, and what is judged."""
    sections, summary, files = [], [], []
    for (name,), mine in sorted(groups(records, "case"), key=lambda each: _place(*each[0])):
        case = CASES[name]
        limits = [record["values"] for record in mine if record["mesh"] == LIMIT]
        files += [{"name": case.name} | r["values"] for r in mine if r["mesh"] == PUBLISHED]
        meshes = sorted((r for r in mine if r["mesh"] > LIMIT), key=lambda r: int(r["mesh"]))
        rows = []
        for record in meshes:
            cost = dict(record)  # on the first line of a mesh alone
            for key, quantity in case.quantities.items():
                value, mumps = (record[by][key] for by in ("values", "mumps"))
                row = {"mesh": record["mesh"], "quantity": quantity.name, "value": value}
                rows.append(cost | row | {"mumps": mumps, "apart": abs(mumps / value - 1)})
                cost = {}
        sections.append({"name": case.name, "source": case.source, "rows": rows})
        for key, quantity in case.quantities.items():
            judged = next((r for r in meshes if r["mesh"] == case.judged), meshes[-1])
            value = judged["values"][key]
            spread = {field: getattr(quantity, field) for field in ("published", "low", "high")}
            ours = {"value": value, "holds": quantity.low <= value <= quantity.high}
            words = {"name": case.name, "source": case.source, "quantity": quantity.name}
            summary.append(words | spread | ours | {"limit": limits[0][key] if limits else None})
    return {"cases": sections, "quantities": summary, "files": files}


def _place(name: str) -> int:
    """Return the place of a case in their order."""
    return list(CASES).index(name)


main = partial(
    write_page,
    __file__,
    "published",
    known=lambda record: record.get("case") in CASES,
    fields=_fields,
)

if __name__ == "__main__":
    main()
