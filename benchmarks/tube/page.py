# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of the tube: displacement, thickness, volume and stress beside the truth.

python3 -m benchmarks.tube.page build/tube.json --output build/results
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from benchmarks.common.pages import Fields, groups, write_page
from benchmarks.common.plots import COLOURS, curve, picture
from benchmarks.common.records import Record

__all__ = ["main"]

CASE = (
    "quarter",
    "element",
    "size",
    "c",
    "kappa",
    "augmented",
    "tangent",
    "subdomains",
    "processes",
)

#: Ways to solve one problem: element, multipliers, name and how it is drawn.
WAYS = (
    ("p2-p1", False, "P2–P1, MUMPS", {"color": COLOURS[0], "ls": "--", "marker": "^"}),
    ("q2-q1", False, "Q2–Q1, MUMPS", {"color": COLOURS[1], "ls": "--", "marker": "s"}),
    ("p2-p0", False, "P2–P0", {"color": COLOURS[2], "marker": "^"}),
    ("p2-p0", True, "P2–P0, λ", {"color": COLOURS[2], "ls": ":", "marker": "^"}),
    ("p2b-p1d", False, "P2⁺–P1disc", {"color": COLOURS[0], "marker": "^"}),
    ("p2b-p1d", True, "P2⁺–P1disc, λ", {"color": COLOURS[0], "ls": ":", "marker": "^"}),
    ("q2-p1d", False, "Q2–P1disc", {"color": COLOURS[1], "marker": "s"}),
    ("q2-p1d", True, "Q2–P1disc, λ", {"color": COLOURS[1], "ls": ":", "marker": "s"}),
)


def _fields(records: Sequence[Record]) -> Fields:
    """Sort the records by case; ratios are those to the truth."""
    names = ("u_r_inner", "thickness", "mean_J")
    runs = []
    for key, mine in groups(records, *CASE):
        rows = [
            r | {f"{name}_ratio": r[name] / r[f"{name}_exact"] for name in names if name in r}
            for r in sorted(mine, key=lambda r: r["pressure_mmhg"])
        ]
        case = dict(zip(CASE, key, strict=True)) | {"body": "quarter" if key[0] else "whole tube"}
        case["with_multipliers"] = ", multipliers" if case["augmented"] else ""
        runs += [case | row for row in rows]
    arrived = [run for run in runs if "error" not in run]
    lost = [run for run in runs if "error" in run]
    return {"runs": arrived, "lost": lost, "ways": [{"rows": _ways(records)}]}


def _ways(records: Sequence[Record]) -> list[Fields]:
    """Return each way at the highest pressure, coarse and fine."""
    reached = [r for r in records if "error" not in r]
    top = max((r["pressure_mmhg"] for r in reached), default=0.0)
    return [
        record | {"way": name, "style": style}
        for element, augmented, name, style in WAYS
        for record in sorted(reached, key=lambda r: -float(r["size"]))
        if (record["element"], record["augmented"]) == (element, augmented)
        and record["pressure_mmhg"] == top
    ]


def _draw(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw the errors of both stresses over dofs and over seconds."""
    rows = _ways(records)
    if not rows:
        return []
    with picture(folder / "tube.png", 2, 2, {r["way"]: r["style"] for r in rows}) as axes:
        for line, stress in zip(axes, ("tt", "rr"), strict=True):
            for ax, over in zip(line, ("dofs", "seconds"), strict=True):
                for _, mine in groups(rows, "way"):
                    points = [(r[over], r[f"recovered_{stress}_error"]) for r in mine]
                    curve(ax, points, **mine[0]["style"])
                ax.set(xscale="log", yscale="log", xlabel=over)
                ax.set_ylabel({"tt": "error of σ_θθ", "rr": "error of σ_rr"}[stress])
    return [{"picture": "tube.png"}]


main = partial(
    write_page, __file__, "tube", known=lambda r: "element" in r, fields=_fields, draw=_draw
)

if __name__ == "__main__":
    main()
