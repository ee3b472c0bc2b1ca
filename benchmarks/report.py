# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From the records of the linear study to its tables and pictures.

    python3 -m benchmarks.report build/linear.json --output build/results

writes ``linear.md`` with all tables, ``linear.tex`` with the same in LaTeX, and ``linear_p1.png``
and ``linear_p2.png``: iterations and condition numbers over the levels.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.linear_plots import draw_levels
from benchmarks.linear_tables import deviations, error_scale, tables
from benchmarks.records import Record

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the report that the command line asks for; return the exit status.

    Raises:
        SystemExit: Bad input.
    """
    parser = argparse.ArgumentParser(
        "report", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("records", type=Path, nargs="+", metavar="JSON", help="files of records")
    parser.add_argument("--output", type=Path, required=True, metavar="FOLDER")
    args = parser.parse_args(arguments)
    try:
        records = [record for path in args.records for record in _read(path)]
        args.output.mkdir(parents=True, exist_ok=True)
        write(args.output, records)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    return 0


def write(folder: Path, records: Sequence[Record]) -> None:
    """Write the files of a report.

    Args:
        folder: Where they go.
        records: What they are about.
    """
    pictures = [
        f"linear_p{degree}.png"
        for degree in (1, 2)
        if draw_levels(folder / f"linear_p{degree}.png", records, degree)
    ]
    found = tables(records)
    parts = [_introduction(records), *(f"![Levels]({name})\n" for name in pictures)]
    parts += [table.markdown() for table in found]
    (folder / "linear.md").write_text("\n".join(parts))
    (folder / "linear.tex").write_text("\n".join(table.latex() for table in found))


def _read(path: Path) -> list[Record]:
    """Read a file of records.

    Raises:
        ValueError: It holds something else, or nothing.
    """
    try:
        records = json.loads(path.read_text())
    except json.JSONDecodeError as error:
        raise ValueError(
            f"{path} holds no JSON ({error}): give a file of benchmarks.cube."
        ) from error
    fine = isinstance(records, list) and all(isinstance(record, dict) for record in records)
    if not fine or not records or any("condition_number" not in record for record in records):
        raise ValueError(f"{path} holds no records: give a file that benchmarks.cube has written.")
    return records


def _introduction(records: Sequence[Record]) -> str:
    """Say what was run where, and how far it is from the paper."""
    condition, iterations = deviations(records)
    scale = error_scale(records)
    lines = [
        "# The linear study",
        "",
        "The unit cube in 8 × 8 × 8 subcubes, 2^(level − 1) cells along an edge of each,",
        "24 tetrahedra in a cell; E = 210, ν = 0.45; on the whole surface the displacements of the",
        f"fundamental solution with its source at {_points(records)}. If nothing else is said:",
        "multiplicity scaling, Q = I, full gluing, no soft modes, CG until the dual residual has",
        "fallen by 1e-8; condition numbers by Lanczos from the coefficients of CG. Made by",
        "`benchmarks/cube.py` and `benchmarks/report.py`.",
        "",
        *_machines(records),
    ]
    if not math.isnan(condition):
        lines += [
            "",
            f"From the paper's table the condition numbers differ by at most {100 * condition:.1f} "
            f"%, the iterations by at most {iterations}.",
            f"The paper does not name its source point; its L2 errors are {scale:.0f} times ours, "
            "and what is left after that factor is given below.",
        ]
    return "\n".join(lines) + "\n"


def _points(records: Sequence[Record]) -> str:
    points = {tuple(record["source"]) for record in records}
    return ", ".join("(" + ", ".join(f"{c:g}" for c in point) + ")" for point in sorted(points))


def _machines(records: Sequence[Record]) -> list[str]:
    """Name machines, versions and dates, a line each."""
    runs: dict[tuple[object, ...], list[Record]] = {}
    for record in records:
        machine = record["machine"]
        key = (*machine.values(), record["processes"])
        runs.setdefault(key, []).append(record)
    lines = []
    for of_one in runs.values():
        machine, dates = of_one[0]["machine"], sorted(str(r["date"])[:10] for r in of_one)
        speed = max(r["bandwidth_gb_s"] for r in of_one)
        when = dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
        lines.append(
            f"- {len(of_one)} cases, {when}: {machine['processor']}, {machine['memory_gib']} GiB, "
            f"{speed:.0f} GB/s, {of_one[0]['processes']} process(es); dolfinx "
            f"{machine['dolfinx']}, PETSc {machine['petsc']}, Python {machine['python']}."
        )
    return lines


if __name__ == "__main__":
    sys.exit(main())
