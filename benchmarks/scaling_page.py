# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From the records of the scaling study to its page and the paper's figure.

    python3 -m benchmarks.scaling_page build/scaling.json --output build/results

writes ``scaling.md``: seconds and efficiencies, counts of messages and reductions, a model that
carries them to 512 and 10 000 processes, and what limits it; and ``scaling.png``. The files are
those of ``benchmarks.scaling``.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.common.pages import provenance, run_command
from benchmarks.common.records import Record
from benchmarks.strong_scaling.checks import check_table
from benchmarks.strong_scaling.groups import is_known
from benchmarks.strong_scaling.model import Machine
from benchmarks.strong_scaling.plots import draw_scaling
from benchmarks.strong_scaling.tables import (
    balance_table,
    count_tables,
    limit_table,
    model_tables,
    time_tables,
)

__all__ = ["main", "write"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page that the command line asks for, see :func:`pages.run_command`."""
    return run_command(
        "scaling_page",
        __doc__,
        arguments,
        known=is_known,
        writer="benchmarks.scaling",
        write=write,
    )


def write(folder: Path, records: Sequence[Record], remark: str = "") -> None:
    """Write the page and the picture.

    Args:
        folder: Where they go.
        records: Of all cases.
        remark: Remark about the runs.
    """
    parts = [_introduction(records, remark)]
    if draw_scaling(folder / "scaling.png", records):
        parts.append("![Seconds of a load step over the processes](scaling.png)\n")
    tables = [*time_tables(records), *model_tables(records), limit_table(records)]
    tables += [check_table(records), *count_tables(records), balance_table(records)]
    parts += [table.markdown() for table in tables if table.rows]
    (folder / "scaling.md").write_text("\n".join(parts))


def _introduction(records: Sequence[Record], remark: str) -> str:
    m = asdict(Machine())
    paragraphs = [
        "The load step of the paper's section *Strong scaling for nonlinear elasticity* (to 0.2 "
        "mmHg: under its 1 mmHg a thin wall at rest would buckle): "
        "P1–P0, κ = 100 kPa, lumped preconditioner, all-floating FETI on a wall of one layer and "
        "classical FETI on one of two; and the same with the package's defaults (Dirichlet "
        "preconditioner). With the paper's choices these are five Newton steps with its tangent, "
        "which leaves out that of the pressure, so that CG solves their systems. *Local* are "
        "assembly and the factorisations of the subdomains, *Krylov* are all solutions of linear "
        "systems after their set-up, *total* is the program from the mesh file to the "
        "displacement, without Python's imports. The slowest process counts.",
        "What the machine has no cores for is counted and modelled. The counts are those of MPI's "
        "own calls, PETSc's and mpi4py's alike (`benchmarks/common/traffic.c`), with the tangent "
        "of the wall at rest; they do not depend on how many processes share a core. The model "
        "(`benchmarks/strong_scaling/model.py`) shares out the seconds of the fewest processes "
        "and adds what does not shrink, for a cluster with a latency of "
        f"{1e6 * m['latency']:g} µs, {1e-9 * m['bandwidth']:g} GB/s into the network, "
        f"{1e-9 * m['stream']:g} GB/s from memory and {1e-9 * m['rate']:g} Gflop/s in "
        "factorisations; these are assumptions. It is held against what was measured in the first "
        "tables; beyond that it is an estimate.",
    ]
    lines = ["# Strong scaling", ""]
    for paragraph in paragraphs:
        lines += [textwrap.fill(paragraph, 100), ""]
    lines += [
        *provenance("scaling", records, remark),
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
