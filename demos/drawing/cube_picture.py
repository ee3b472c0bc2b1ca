# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The picture of `demo_classical_vs_all_floating.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba

from drawing.render import Cells, Scene, skin

__all__ = ["draw_cube"]

#: Size of a subcube in the picture; the rest is the gap that shows where the cube is torn.
SHRINK = 0.88
FIXED, FLOATING = "#c9ced6", "#c9962b"
COLOURS = {"identity": "#b5443a", "lumped": "#c9962b", "dirichlet": "#1f5a8a"}
LINES = {"all_floating": "-", "classical": "--"}


def draw_cube(path: Path, cells: Cells, condition: dict[tuple[str, str, int], float]) -> None:
    """Draw the torn cube and the condition numbers.

    Args:
        path: The file.
        cells: The cube with the values `subcube` and `floating`.
        condition: Condition number by type, preconditioner and cells on the edge of a subcube.
    """
    fig, (left, right) = plt.subplots(1, 2, figsize=(11, 5), width_ratios=(1, 1.1))
    _scene(cells).draw(left)
    left.set_title("floating in classical FETI: 8 of 64")
    _draw_conditions(right, condition)
    fig.savefig(path, dpi=150, bbox_inches="tight")
    plt.close(fig)


def _scene(cells: Cells) -> Scene:
    """Return the subcubes, each shrunk towards its centre, without those of the nearest corner."""
    part = cells.values["subcube"]
    count = np.bincount(part)
    centre = np.stack(
        [np.bincount(part, cells.X[:, :, k].mean(axis=1)) / count for k in range(3)], axis=1
    )[part]
    x = centre[:, None] + SHRINK * (cells.X - centre[:, None])
    shown = ~np.all((centre - 0.5) * (1, -1, 1) > 0, axis=1)
    cell, corner = skin(cells, part)
    kept = shown[cell]
    cell, corner = cell[kept], corner[kept]
    colours = np.array([to_rgba(FIXED), to_rgba(FLOATING)])
    scene = Scene(_view())
    scene.add_surface(x[cell[:, None], corner], colours[cells.values["floating"][cell].astype(int)])
    return scene


def _view() -> np.ndarray:
    """Look from the corner (1, 0, 1), the third axis upright."""
    front = np.array([0.8, -1.0, 0.75])
    front /= np.linalg.norm(front)
    right = np.cross((0.0, 0.0, 1.0), front)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(front, right), front])


def _draw_conditions(ax: Axes, condition: dict[tuple[str, str, int], float]) -> None:
    for kind, line in LINES.items():
        for pc_type, colour in COLOURS.items():
            points = sorted((n, κ) for (*of, n), κ in condition.items() if of == [kind, pc_type])
            label = f"{pc_type}, {kind.replace('_', '-')}"
            ax.plot(*zip(*points, strict=True), line, color=colour, marker="o", ms=4, label=label)
    ax.set_yscale("log")
    ax.set_xticks(sorted({n for _, _, n in condition}))
    ax.set_xlabel("cells along the edge of a subcube, H/h")
    ax.set_ylabel("condition number κ")
    ax.grid(axis="y", which="both", color="0.92")
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False)
