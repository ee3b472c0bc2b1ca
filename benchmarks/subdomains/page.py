# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the sweep: processor time over the best of its body, over dofs of a subdomain.

python3 -m benchmarks.subdomains.page build/subdomains.json --output build/results
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from benchmarks.common.pages import Fields, groups, write_page
from benchmarks.common.records import Record
from benchmarks.subdomains.run import CASES, ratio
from dolfinx_feti.fem.decomposition import DOFS

__all__ = ["main"]


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each body, size and number of processes."""
    rows = []
    for (case, processes, wanted), mine in groups(records, "case", "processes", "wanted_dofs"):
        steps = {int(r["per"]): r for r in mine}
        its = [r["iterations"] for r in mine if r["subdomains"] > 1]
        place = (processes, list(CASES).index(case), wanted)
        rows.append(
            {"place": place, "case": case, "processes": processes, "dofs": steps[DOFS]["dofs"]}
            | {"at": {per: f"{ratio(r, records):.2f}" for per, r in steps.items()}}
            | {"fewest": min(its), "most": max(its)}
        )
    return {"rows": sorted(rows, key=lambda row: row["place"])}


main = partial(
    write_page,
    __file__,
    "subdomains",
    known=lambda record: record.get("case") in CASES,
    fields=_fields,
)

if __name__ == "__main__":
    main()
