# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pictures of a wall that was imaged under load, as PNG files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from common.render import Cells, paint, principal_view, skin, surface

__all__ = ["draw_profiles", "draw_stress", "draw_unloaded"]

#: Slices of the wall in each layer.
SLICES = 4


def draw_unloaded(path: Path, cells: Cells) -> None:
    """Draw the image, x, beside the unloaded wall, X, coloured by the way between them [mm]."""
    moved = np.linalg.norm(cells.x - cells.X, axis=2)
    scale = Normalize(0.0, float(np.percentile(moved, 99.5)))
    view = principal_view(cells.x.reshape(-1, 3), tilt=15)
    face = skin(cells, np.zeros(len(cells.X), dtype=int))
    colours = plt.get_cmap("viridis")(scale(moved[face].mean(axis=1)))
    fig, axes = plt.subplots(1, 2, figsize=(11, 6), sharex=True, sharey=True)
    for ax, x, title in zip(axes, (cells.x, cells.X), ("image", "without load"), strict=True):
        paint(ax, surface(view, x[face], colours))
        ax.set_title(title)
    bar = fig.colorbar(ScalarMappable(scale, "viridis"), ax=axes, shrink=0.6, extend="max")
    bar.set_label("displacement |u|  [mm]")
    _save(fig, path)


def draw_stress(path: Path, walls: Mapping[str, Cells]) -> None:
    """Draw walls with the magnitude of their stress [kPa]."""
    every = np.concatenate([cells.values["stress"] for cells in walls.values()])
    scale = Normalize(*np.round(np.percentile(every, [1, 99]), 1))
    fig, axes = plt.subplots(1, len(walls), figsize=(5.5 * len(walls), 6), squeeze=False)
    for ax, (name, cells) in zip(axes[0], walls.items(), strict=True):
        face = skin(cells, np.zeros(len(cells.X), dtype=int))
        colours = plt.get_cmap("viridis")(scale(cells.values["stress"][face[0][:, 0]]))
        paint(ax, surface(principal_view(cells.X.reshape(-1, 3), tilt=15), cells.x[face], colours))
        ax.set_title(f"at {name}")
    bar = fig.colorbar(ScalarMappable(scale, "viridis"), ax=axes, shrink=0.6, extend="both")
    bar.set_label("stress magnitude  [kPa]")
    _save(fig, path)


def draw_profiles(path: Path, walls: Mapping[str, Cells], layers: Sequence[str]) -> None:
    """Draw the mean circumferential stress of slices of each layer, from the lumen outwards."""
    fig, ax = plt.subplots(figsize=(8, 5))
    for number, (name, cells) in enumerate(walls.items()):
        colour = f"C{number % 2}"
        style = "--" if "," in name else "-"
        depth, hoop, layer = (cells.values[key] for key in ("depth", "hoop", "layer"))
        volume = np.abs(np.linalg.det(cells.x[:, 1:] - cells.x[:, :1]))
        for i in range(len(layers)):
            here = np.flatnonzero(layer == i)
            parts = np.array_split(here[np.argsort(depth[here])], SLICES)
            x, y = (
                [np.average(values[part], weights=volume[part]) for part in parts]
                for values in (depth, hoop)
            )
            ax.plot(x, y, f"o{style}", color=colour, ms=4, label=name if i == 0 else None)
    ax.set_xlabel("place in the wall, 0 at the lumen, 1 outside; " + ", ".join(layers))
    ax.set_ylabel("circumferential stress  [kPa]")
    ax.grid(color="0.9")
    ax.legend(frameon=False)
    _save(fig, path)


def _save(fig: plt.Figure, path: Path) -> None:
    fig.savefig(path, dpi=150, bbox_inches="tight")
    plt.close(fig)
