# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The pictures of the linear study: iterations and condition numbers over the levels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from benchmarks.common.records import Record
from benchmarks.unit_cube import paper
from benchmarks.unit_cube.groups import PRECONDITIONERS, TYPES, is_papers

__all__ = ["draw_levels"]

COLOURS = dict(zip(PRECONDITIONERS, ("#b5443a", "#c9962b", "#1f5a8a"), strict=True))
QUANTITIES = {"iterations": "iterations", "condition_number": "condition number κ"}


def draw_levels(path: Path, records: Sequence[Record], degree: int) -> bool:
    """Draw the solves with the paper's parameters, and the paper's own as open circles.

    Args:
        path: The file.
        records: All records.
        degree: Of the elements.

    Returns:
        Whether there was anything to draw.
    """
    mine = [r for r in records if is_papers(r) and r["degree"] == degree]
    if not mine:
        return False
    fig, axes = plt.subplots(2, 2, figsize=(8, 6), sharex=True, sharey="row")
    for row, (name, label) in zip(axes, QUANTITIES.items(), strict=True):
        for ax, kind in zip(row, TYPES, strict=True):
            _draw(ax, [r for r in mine if r["type"] == kind], name)
            if degree == 1:
                _draw_papers(ax, kind, name)
            ax.set_yscale("log")
            ax.grid(axis="y", which="both", color="0.92")
            ax.spines[["top", "right"]].set_visible(False)
        row[0].set_ylabel(label)
    for ax, title in zip(axes[0], TYPES.values(), strict=True):
        ax.set_title(title)
    for ax in axes[-1]:
        ax.set_xlabel("level")
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    handles = [plt.Line2D([0], [0], color=colour, marker=".") for colour in COLOURS.values()]
    names = list(PRECONDITIONERS)
    if degree == 1:
        handles.append(plt.Line2D([0], [0], color="0.4", marker="o", mfc="none", ls="none"))
        names.append("the paper's")
    fig.legend(handles, names, loc="lower center", ncols=4, frameon=False)
    fig.suptitle(f"P{degree}, 512 subdomains")
    fig.tight_layout(rect=(0, 0.05, 1, 1))
    fig.savefig(path, dpi=120)
    plt.close(fig)
    return True


def _draw(ax: Axes, records: Sequence[Record], name: str) -> None:
    for pc, colour in COLOURS.items():
        points = sorted((r["level"], r[name]) for r in records if r["pc"] == pc)
        if points:
            ax.plot(*zip(*points, strict=True), color=colour, marker=".")


def _draw_papers(ax: Axes, kind: str, name: str) -> None:
    for pc, colour in COLOURS.items():
        points = [
            (level, getattr(solve, name))
            for (of, by, level), solve in paper.SOLVES.items()
            if (of, by) == (kind, pc)
        ]
        ax.plot(*zip(*points, strict=True), "o", color=colour, mfc="none", ms=8)
