# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From the records of the comparison of solvers to its page and pictures.

    python3 -m benchmarks.speed_page build/speed.json --output build/results

writes ``speed.md``, time and memory of FETI, MUMPS, GAMG and others on the same matrices, and
``speed_tube.png`` and so on, the same over the dofs. The files are those of ``benchmarks.compare``.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path

from benchmarks.common.pages import provenance, run_command
from benchmarks.common.records import Record
from benchmarks.speed.groups import GEOMETRIES, is_known
from benchmarks.speed.plots import draw_speed
from benchmarks.speed.statements import statements
from benchmarks.speed.tables import (
    failure_table,
    growth_table,
    path_table,
    phase_table,
    solver_tables,
)

__all__ = ["main", "write"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page that the command line asks for, see :func:`pages.run_command`."""
    return run_command(
        "speed_page",
        __doc__,
        arguments,
        known=is_known,
        writer="benchmarks.compare",
        write=write,
    )


def write(folder: Path, records: Sequence[Record], remark: str = "") -> None:
    """Write the page and its pictures.

    Args:
        folder: Where they go.
        records: Of all cases.
        remark: Remark about the runs.
    """
    parts = [_introduction(records, remark)]
    for geometry in GEOMETRIES:
        picture = f"speed_{geometry}.png"
        if draw_speed(folder / picture, records, geometry):
            parts.append(f"![Time and memory over dofs, {geometry}]({picture})\n")
    tables = [*solver_tables(records), path_table(records), phase_table(records)]
    tables += [growth_table(records), failure_table(records)]
    parts += [table.markdown() for table in tables if table.rows]
    (folder / "speed.md").write_text("\n".join(parts))


def _introduction(records: Sequence[Record], remark: str) -> str:
    paragraphs = [
        "FETI and other solvers on the same matrices: the first Newton step of a body at rest, and "
        "whole load paths. All bodies are P2–P0 with a condensed pressure: the two-layer *tube*, "
        "clamped at its ends, at 1 mmHg; the two-layer *vessel* of the demo, a wall of 1 mm, "
        "clamped at its openings, at 0.01 mmHg; and a neo-Hookean *block* (shear modulus 1 kPa), "
        "clamped on five faces, under a dead load of 1 mmHg on the sixth one.",
        "FETI has the package's defaults. MUMPS factors the assembled matrix (Cholesky in the "
        "first steps, LDLᵀ on the paths), GAMG runs CG with the six rigid body modes, BDDC is "
        "PETSc's on FETI's subdomains. All iterative ones lower the residual of the assembled "
        "system by 1e8. *Set-up* is what needs no right-hand side. The memory is the peak of a "
        "solver above matrix and mesh, all processes together. A solver may be at its best on "
        "several processes or on one with threads: of several layouts the faster one is in bold. "
        "Ratios are those of FETI's faster layout to each of the others, below and in the picture "
        "to the faster one.",
    ]
    lines = ["# Speed and memory beside other solvers", ""]
    for paragraph in paragraphs:
        lines += [textwrap.fill(paragraph, 100), ""]
    for statement in statements(records):
        lines += [textwrap.fill(f"- {statement}", 100, subsequent_indent="  ")]
    lines += ["", *provenance("speed", records, remark, writer="compare")]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
