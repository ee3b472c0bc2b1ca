# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""From the records of the nonlinear study to its page and picture.

    python3 -m benchmarks.nonlinear_page build/nonlinear.json --output build/results

writes ``nonlinear.md``, with the paper's tables beside ours and what of the paper's text holds
here, and for each mesh a picture such as ``nonlinear_vessel_1.19.png``: iterations over κ. The
files are those of ``benchmarks.nonlinear``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.common.pages import by_mesh, provenance, run_command
from benchmarks.common.records import Record
from benchmarks.nonlinear_tables.groups import is_known
from benchmarks.nonlinear_tables.plots import draw_iterations
from benchmarks.nonlinear_tables.statements import statement_table
from benchmarks.nonlinear_tables.tables import (
    contact_table,
    failure_table,
    newton_tables,
    volume_table,
)

__all__ = ["main", "write"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page that the command line asks for, see :func:`pages.run_command`."""
    return run_command(
        "nonlinear_page",
        __doc__,
        arguments,
        known=is_known,
        writer="benchmarks.nonlinear",
        write=write,
    )


def write(folder: Path, records: Sequence[Record], remark: str = "") -> None:
    """Write the page and its pictures.

    Args:
        folder: Where they go.
        records: Of all cases.
        remark: Remark about the runs.
    """
    parts = [_introduction(records, remark), statement_table(records).markdown()]
    for mesh in by_mesh(records):
        picture = f"nonlinear_{mesh.name}.png"
        if draw_iterations(folder / picture, mesh.records):
            parts.append(f"![Iterations of a Newton step over κ, {mesh.about}]({picture})\n")
    tables = [*newton_tables(records), volume_table(records), contact_table(records)]
    tables.append(failure_table(records))
    parts += [table.markdown() for table in tables if table.rows]
    (folder / "nonlinear.md").write_text("\n".join(parts))


def _introduction(records: Sequence[Record], remark: str) -> str:
    lines = [
        "# The nonlinear study",
        "",
        "A first load step from rest, as in the paper's section *Arterial model on a realistic",
        "mesh geometry*: iterations and seconds of a Newton step with classical and all-floating",
        "FETI, three preconditioners and κ from 10 to 1000 kPa. A wall with the fibre angle of the",
        "media everywhere stands for the paper's aorta, one with media and adventitia for its",
        "carotid artery. The paper's load is 1 mmHg; the vessel is a thin wall, whose pieces would",
        "buckle under it, and takes 0.2 mmHg.",
        "",
        "*The paper's choices* are multiplicity scaling, Q = I, no soft modes, the dual form, and",
        "absolute errors of 1e-8 for the dual system and of 1e-6 for Newton's method. Both are",
        "norms of the residual of the assembled system here, in mN: as a norm of the jump, 1e-8 mm",
        "would leave more than 1e-6 mN at κ = 1000 kPa, and Newton's method would stall. The",
        "paper's tangent leaves out that of the follower pressure, so that CG solves all systems;",
        "Newton's method then takes dozens of steps on a thin wall, the first four of which are",
        "shown. *The package's defaults* are those of docs/options.md: the symmetric part of the",
        "pressure's tangent, relative tolerances of 1e-8, and the primal form where the",
        "preconditioner is Dirichlet's.",
        "Newton's method knows no potential in either, so that it takes plain steps. All cases of",
        "a wall share one decomposition. Seconds of one process are its processor time, which",
        "other work on the machine hardly disturbs.",
        "",
        *provenance("nonlinear", records, remark),
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
