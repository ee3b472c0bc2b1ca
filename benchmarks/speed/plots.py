# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The pictures of the comparison: time and memory over dofs, a curve for each solver."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from benchmarks.common.records import Record
from benchmarks.speed.groups import NAMES, Group, groups, seconds

__all__ = ["draw_speed"]

COLOURS = dict(zip(NAMES, ("#1f5a8a", "#b5443a", "#c9962b", "#5b8c4a", "#7d5a8a"), strict=True))
MARKERS = dict(zip(NAMES, "osD^v", strict=True))


def draw_speed(path: Path, records: Sequence[Record], geometry: str) -> bool:
    """Draw a row for each κ: seconds and memory of the first Newton step, log–log.

    Args:
        path: The file.
        records: All records; of a solver the better layout is drawn.
        geometry: Of the body.

    Returns:
        Whether there was anything to draw.
    """
    mine = [g for g in groups(records) if (g.geometry, g.path_mmhg) == (geometry, None)]
    mine = [group for group in mine if any(map(group.best, NAMES))]
    kappas = list(dict.fromkeys(group.kappa for group in mine))
    if not kappas:
        return False
    height = 0.6 + 3.2 * len(kappas)
    fig, axes = plt.subplots(len(kappas), 2, figsize=(8, height), sharex=True, squeeze=False)
    for row, kappa in zip(axes, kappas, strict=True):
        of_kappa = [group for group in mine if group.kappa == kappa]
        _draw(row[0], of_kappa, "seconds")
        _draw(row[1], of_kappa, "peak_mib")
        row[0].set_ylabel("set-up and solution [s]")
        row[1].set_ylabel("peak memory [MiB]")
        for ax in row:
            ax.set_title(f"{geometry}, κ = {kappa:g} kPa")
    for ax in axes[-1]:
        ax.set_xlabel("dofs in thousands")
    drawn = [name for name in NAMES if any(group.best(name) for group in mine)]
    handles = [plt.Line2D([0], [0], color=COLOURS[n], marker=MARKERS[n]) for n in drawn]
    fig.legend(handles, [NAMES[n] for n in drawn], loc="lower center", ncols=5, frameon=False)
    fig.tight_layout(rect=(0, 0.4 / height, 1, 1))
    fig.savefig(path, dpi=120)
    plt.close(fig)
    return True


def _draw(ax: Axes, mine: Sequence[Group], what: str) -> None:
    for name in NAMES:
        best = [(group.dofs, record) for group in mine if (record := group.best(name))]
        values = [(dofs, seconds(r) if what == "seconds" else r[what]) for dofs, r in best]
        known = [(dofs, value) for dofs, value in values if value]
        if known:
            ax.plot(*zip(*known, strict=True), color=COLOURS[name], marker=MARKERS[name])
    ax.set_xscale("log")
    ax.set_yscale("log")
    sizes = [group.dofs for group in mine]
    ax.set_xticks(sizes, [f"{dofs / 1000:.0f}" for dofs in sizes])
    ax.xaxis.minorticks_off()
    ax.grid(which="both", color="0.92")
    ax.spines[["top", "right"]].set_visible(False)
