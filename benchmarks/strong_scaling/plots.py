# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's figure of strong scaling, Augustin_fig:scaling: seconds over the processes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from benchmarks.common.records import Record
from benchmarks.strong_scaling import paper
from benchmarks.strong_scaling.groups import ARTERIES, TYPES, Series, series
from benchmarks.strong_scaling.model import create_model

__all__ = ["draw_scaling"]

COLOURS = {"local": "#c9962b", "krylov": "#1f5a8a", "total": "#1c1c1c"}
NAMES = {"local": "local", "krylov": "global Krylov method", "total": "total"}


def draw_scaling(path: Path, records: Sequence[Record]) -> bool:
    """Draw measured points, the model's curves, and the paper's points as open circles.

    Args:
        path: The file.
        records: All records; those with the paper's choices are drawn.

    Returns:
        Whether there was anything to draw.
    """
    of_layers = {of_one.layers: of_one for of_one in series(records) if of_one.choices == "paper"}
    if not any(of_one.measured for of_one in of_layers.values()):
        return False
    fig, axes = plt.subplots(1, 2, figsize=(9, 4.4), sharex=True)
    for ax, layers in zip(axes, TYPES, strict=True):
        if layers in of_layers:
            _draw(ax, of_layers[layers])
        theirs = paper.TIMES[layers]
        for part, colour in COLOURS.items():
            seconds = [getattr(times, part) for times in theirs.values()]
            ax.plot(list(theirs), seconds, "o", color=colour, mfc="none", ms=6)
        kind = TYPES[layers].replace("_", "-")
        ax.set_title(f"{kind}; the paper's {ARTERIES[layers]}")
        ax.set_xscale("log", base=2)
        ax.set_yscale("log")
        ax.set_xlabel("processes")
        ax.grid(which="both", color="0.92")
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("seconds of a load step")
    handles = [plt.Line2D([0], [0], color=colour) for colour in COLOURS.values()]
    styles = (("s", "none", "0.4"), ("", "-", "0.4"), ("o", "none", "none"))
    handles += [
        plt.Line2D([0], [0], color="0.4", marker=marker, ls=line, mfc=face)
        for marker, line, face in styles
    ]
    names = [*NAMES.values(), "measured", "model", "the paper's"]
    fig.legend(handles, names, loc="lower center", ncols=3, frameon=False)
    fig.tight_layout(rect=(0, 0.13, 1, 1))
    fig.savefig(path, dpi=120)
    plt.close(fig)
    return True


def _draw(ax: Axes, of_one: Series) -> None:
    model = create_model(of_one.measured, of_one.counted)
    processes = [2**k for k in range(10)]
    foreseen = [model.predict(P) for P in processes] if model is not None else []
    for part, colour in COLOURS.items():
        points = [(r["processes"], r[f"seconds_{part}"]) for r in of_one.measured]
        if points:
            ax.plot(*zip(*points, strict=True), "s", color=colour, ms=5)
        if foreseen:
            ax.plot(processes, [getattr(each, part) for each in foreseen], color=colour)
