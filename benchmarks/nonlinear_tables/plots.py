# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The picture of the nonlinear study: iterations of a Newton step over κ."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from benchmarks.common.records import Record
from benchmarks.nonlinear_tables import paper
from benchmarks.nonlinear_tables.groups import CHOICES, PRECONDITIONERS, TYPES, usual
from benchmarks.nonlinear_tables.statements import mean_iterations

__all__ = ["draw_iterations"]

COLOURS = dict(zip(PRECONDITIONERS, ("#b5443a", "#c9962b", "#1f5a8a"), strict=True))
LINES = dict(zip(CHOICES, ("-", "--"), strict=True))


def draw_iterations(path: Path, records: Sequence[Record]) -> bool:
    """Draw a curve for each preconditioner and choice, and the paper's as open circles.

    Args:
        path: The file.
        records: Of one mesh.

    Returns:
        Whether there was anything to draw.
    """
    mine = [r for r in usual(records) if r["layers"] == 1]
    degrees = sorted({int(r["degree"]) for r in mine})
    if not degrees:
        return False
    shape = {"nrows": len(degrees), "ncols": 2, "figsize": (8, 0.6 + 3.4 * len(degrees))}
    fig, axes = plt.subplots(**shape, sharex=True, sharey=True, squeeze=False)
    for row, degree in zip(axes, degrees, strict=True):
        for ax, kind in zip(row, TYPES, strict=True):
            _draw(ax, [r for r in mine if (r["degree"], r["type"]) == (degree, kind)])
            _draw_papers(ax, degree, kind)
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.set_title(f"P{degree}–P0, {TYPES[kind]}")
            ax.grid(which="both", color="0.92")
            ax.spines[["top", "right"]].set_visible(False)
        row[0].set_ylabel("iterations of a Newton step")
    for ax in axes[-1]:
        ax.set_xlabel("κ [kPa]")
    handles = [plt.Line2D([0], [0], color=colour) for colour in COLOURS.values()]
    handles += [plt.Line2D([0], [0], color="0.4", ls=line) for line in LINES.values()]
    handles.append(plt.Line2D([0], [0], color="0.4", marker="o", mfc="none", ls="none"))
    names = [*PRECONDITIONERS, *CHOICES.values(), "the paper's aorta"]
    fig.legend(handles, names, loc="lower center", ncols=3, frameon=False)
    fig.tight_layout(rect=(0, 0.6 / shape["figsize"][1], 1, 1))
    fig.savefig(path, dpi=120)
    plt.close(fig)
    return True


def _draw(ax: Axes, records: Sequence[Record]) -> None:
    for pc, colour in COLOURS.items():
        for choices, line in LINES.items():
            mine = [r for r in records if (r["pc"], r["choices"]) == (pc, choices)]
            points = sorted((r["kappa"], mean_iterations(r)) for r in mine)
            points = [(kappa, its) for kappa, its in points if math.isfinite(its)]
            if points:
                ax.plot(*zip(*points, strict=True), line, color=colour, marker=".")


def _draw_papers(ax: Axes, degree: int, kind: str) -> None:
    for pc, colour in COLOURS.items():
        points = [
            (kappa, solve.iterations)
            for (layers, k, of, kappa, by), solve in paper.SOLVES.items()
            if (layers, k, of, by) == (1, degree, kind, pc) and solve.iterations is not None
        ]
        ax.plot(*zip(*points, strict=True), "o", color=colour, mfc="none", ms=7)
