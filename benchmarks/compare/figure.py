# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The figure of measured speed: seconds of one linear solve over dofs, of FETI and other solvers.

    python3 -m benchmarks.compare.figure docs/results/speed.json docs/images/speed.png

It shows first Newton steps with P2–P0 and κ = 1000 kPa; each solver in its faster layout.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.common.pages import groups
from benchmarks.common.plots import COLOURS, Style, curve, picture
from benchmarks.common.records import Record, read_records
from benchmarks.compare.run import is_known, seconds

__all__ = ["draw", "points"]

KAPPA = 1000.0

#: What a plain first step of the package's own choice has none of.
SPECIAL = ("cost", "loaded_mmhg", "path_mmhg", "wanted_subdomains")
BODIES = {"tube": "thin wall (tube)", "vessel": "branched vessel", "block": "compact block"}

#: The curves: their solvers, the fastest of which counts, and how they look.
CURVES: dict[str, tuple[tuple[str, ...], Style]] = {
    "FETI": (("feti",), {"color": COLOURS[0], "marker": "o", "lw": 2}),
    "direct: MUMPS, CHOLMOD or PARDISO": (
        ("mumps", "cholmod", "pardiso"),
        {"color": COLOURS[1], "marker": "s"},
    ),
    "multigrid: GAMG or BoomerAMG": (
        ("gamg", "gamg-elasticity", "hypre", "hypre-elasticity"),
        {"color": COLOURS[2], "marker": "^"},
    ),
}


def points(
    records: Sequence[Record], geometry: str, solvers: Sequence[str]
) -> list[tuple[float, float]]:
    """Return dofs and seconds of the fastest of some solvers on a body, by size."""
    first_steps = [
        record
        for record in records
        if (record["geometry"], record["kappa"], record["degree"]) == (geometry, KAPPA, 2)
        and record["solver"] in solvers
        and record["converged"]
        and not any(record[name] for name in SPECIAL)
    ]
    found = groups(first_steps, "dofs")
    return sorted((dofs, min(map(seconds, mine))) for (dofs,), mine in found)


def draw(records: Sequence[Record], path: Path) -> None:
    """Draw the panels of all bodies into a file."""
    legend = {name: style for name, (_, style) in CURVES.items()}
    with picture(path, 1, len(BODIES), legend, sharey=True) as axes:
        for ax, (geometry, title) in zip(axes[0], BODIES.items(), strict=True):
            for solvers, style in CURVES.values():
                curve(ax, points(records, geometry, solvers), **style)
            ax.set(title=title, xlabel="dofs", xscale="log", yscale="log")
        axes[0, 0].set_ylabel("set-up and solve [s], two cores")


if __name__ == "__main__":
    draw(read_records(Path(sys.argv[1]), is_known, "benchmarks.compare"), Path(sys.argv[2]))
