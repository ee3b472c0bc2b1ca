# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From the records of the linear study to its tables and pictures.

    python3 -m benchmarks.report build/linear.json build/solvers.json --output build/results

writes ``linear.md`` with all tables, ``linear.tex`` with the same in LaTeX, and ``linear_p1.png``
and ``linear_p2.png``: iterations and condition numbers over the levels. The files are those of
``benchmarks.linear`` or ``benchmarks.cube``, and of ``benchmarks.cube_solvers``.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.common.pages import run_command
from benchmarks.common.records import Record
from benchmarks.unit_cube.checks import check_table, error_scale
from benchmarks.unit_cube.plots import draw_levels
from benchmarks.unit_cube.tables import deviations, solver_table, tables

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the report that the command line asks for, see :func:`pages.run_command`."""
    return run_command(
        "report", __doc__, arguments, known=_is_known, writer="benchmarks.linear", write=write
    )


def write(folder: Path, records: Sequence[Record], remark: str = "") -> None:
    """Write the files of a report.

    Args:
        folder: Where they go.
        records: What they are about.
        remark: Remark about the runs.
    """
    solvers = [record for record in records if "solver" in record]
    cases = [record for record in records if "solver" not in record]
    pictures = [
        f"linear_p{degree}.png"
        for degree in (1, 2)
        if draw_levels(folder / f"linear_p{degree}.png", cases, degree)
    ]
    extra = [table for table in (check_table(cases, solvers), solver_table(solvers)) if table.rows]
    found = [*extra, *tables(cases)]
    parts = [_introduction(cases, solvers, remark)]
    parts += [f"![Iterations and condition numbers over the levels]({name})\n" for name in pictures]
    parts += [table.markdown() for table in found]
    (folder / "linear.md").write_text("\n".join(parts))
    (folder / "linear.tex").write_text("\n".join(table.latex() for table in found))


def _is_known(record: Record) -> bool:
    """Tell whether a record is one of a case, of a refused case, or of a solver."""
    names = ("condition_number", "estimated_mib", "failure", "solver")
    return "machine" in record and any(name in record for name in names)


def _introduction(cases: Sequence[Record], solvers: Sequence[Record], remark: str) -> str:
    """Say what was run where, and how far it is from the paper."""
    condition, iterations = deviations(cases)
    lines = [
        "# The linear study",
        "",
        "The unit cube in 8 × 8 × 8 subcubes, 2^(level − 1) cells along an edge of each, 24",
        "tetrahedra in a cell; E = 210, ν = 0.45; on the whole surface the displacements of the",
        f"fundamental solution with its source at {_points(cases)}. If nothing else is said:",
        "multiplicity scaling, Q = I, full gluing, no soft modes, CG until the dual residual has",
        "fallen by 1e-8. Condition numbers are Lanczos', from the coefficients of CG.",
        "",
        "`make bench` runs all of it again, and goes on where it was ended; this page is made by",
        "`python3 -m benchmarks.report docs/results/linear.json docs/results/solvers.json --output",
        "docs/results`, which writes the tables in LaTeX, too.",
        "",
        *_machines([*cases, *solvers]),
    ]
    lines += ["", remark] if remark else []
    if not math.isnan(condition):
        lines += [
            "",
            f"From the paper's table the condition numbers differ by at most {100 * condition:.1f} "
            f"%, the iterations by at most {iterations}. The paper does not name its source point; "
            f"its L2 errors are {error_scale(cases):.0f} times ours, and what is left after that "
            "factor is given below. Its counts of dofs (9981 all-floating, 6621 classical on level "
            "1) do not follow from its mesh either, which has 8907; its multipliers and its "
            "largest subdomains do.",
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
        speed = max(r.get("bandwidth_gb_s", 0.0) for r in of_one)
        when = dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
        lines.append(
            f"- {len(of_one)} cases, {when}: {machine['processor']}, {machine['memory_gib']} GiB, "
            f"{speed:.0f} GB/s, {of_one[0]['processes']} process(es); dolfinx "
            f"{machine['dolfinx']}, PETSc {machine['petsc']}, Python {machine['python']}."
        )
    return lines


if __name__ == "__main__":
    sys.exit(main())
