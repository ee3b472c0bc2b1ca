# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the tube: displacement, thickness, volume and stress beside the truth.

python3 -m benchmarks.tube.page build/tube.json --output build/results
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from benchmarks.common.pages import Fields, groups, write_page
from benchmarks.common.records import Record

__all__ = ["main"]

CASE = ("quarter", "element", "size", "c", "kappa", "tangent", "subdomains", "processes")


def _fields(records: Sequence[Record]) -> Fields:
    """Sort the records by case; ratios are those to the truth."""
    names = ("u_r_inner", "thickness", "mean_J")
    runs = []
    for key, mine in groups(records, *CASE):
        rows = [
            r | {f"{name}_ratio": r[name] / r[f"{name}_exact"] for name in names if name in r}
            for r in sorted(mine, key=lambda r: r["pressure_mmhg"])
        ]
        lost = [r for r in rows if "error" in r]
        case = dict(zip(CASE, key, strict=True)) | {"body": "quarter" if key[0] else "whole tube"}
        runs.append(case | {"rows": [r for r in rows if "error" not in r], "lost": lost})
    return {"runs": runs, "machines": []}


main = partial(write_page, __file__, "tube", known=lambda r: "element" in r, fields=_fields)

if __name__ == "__main__":
    main()
