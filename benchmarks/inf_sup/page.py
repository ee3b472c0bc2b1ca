# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the inf-sup constants: a row for each pair, a column for each mesh.

python3 -m benchmarks.inf_sup.page build/inf_sup.json --output build/results
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from benchmarks.common.pages import Fields, groups, write_page
from benchmarks.common.records import Record
from benchmarks.inf_sup.run import PAIRS

__all__ = ["main"]


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each pair, in their order."""
    rows = []
    for (pair,), mine in groups(records, "pair"):
        at = {int(r["cells"]): r for r in mine}
        rows.append(
            {"pair": pair, "name": PAIRS[pair].name, "most": max(r["spurious"] for r in mine)}
            | {"at": {cells: f"{r['beta']:.3f}" for cells, r in at.items()}}
        )
    return {"rows": sorted(rows, key=lambda row: list(PAIRS).index(str(row["pair"])))}


main = partial(
    write_page,
    __file__,
    "inf_sup",
    known=lambda record: record.get("pair") in PAIRS,
    fields=_fields,
)

if __name__ == "__main__":
    main()
