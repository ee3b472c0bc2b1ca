# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the random walls: a row for each seed, and what those say that did not arrive.

python3 -m benchmarks.random_walls.page build/random_walls.json --output build/results
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from benchmarks.common.pages import Fields, section, write_page
from benchmarks.common.records import Record
from benchmarks.random_walls.run import MMHG, MOST

__all__ = ["main"]


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each seed, in their order."""
    rows = sorted(records, key=lambda record: int(record["seed"]))
    failed = [row for row in rows if row["error"]]
    return {
        "rows": rows,
        "arrived": len(rows) - len(failed),
        "within": sum(not row["error"] and row["newton"] <= MOST for row in rows),
        "failures": section(failed),
        "mmhg": MMHG,
        "most": MOST,
    }


main = partial(
    write_page,
    __file__,
    "random_walls",
    known=lambda record: "seed" in record and "wall" in record,
    fields=_fields,
)

if __name__ == "__main__":
    main()
