# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pictures of a wall and of a load path, as PNG files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgba_array

from common.render import Array, Cells, bars, paint, principal_view, shrunk, skin, surface
from dolfinx_feti.loading import LoadStep

__all__ = ["draw_convergence", "draw_fibres", "draw_wall"]

#: Size of a subdomain in the picture; the rest is the gap that shows where the wall is torn.
SHRINK = 0.94
LAYERS = to_rgba_array(["#d9776b", "#efd9a7", "#a9c3d9", "#c9b3d6", "#b5cfa5"])
FAMILIES = {"fibres_1": "#16325c", "fibres_2": "#0f7a5a"}
#: Bars of a family of fibres in a picture, at most, and their length relative to their distance.
BARS, LENGTH = 3000, 0.8


def draw_wall(path: Path, cells: Cells, *, pressure: float) -> None:
    """Draw the torn wall at rest, and deformed with the stress at a pressure [mmHg].

    The values of the cells are `stress` [kPa] and `subdomain`.
    """
    stress = _at_vertices(cells, cells.values["stress"])
    scale = Normalize(*np.round(np.percentile(stress, [1, 99]), 1))
    part = cells.values["subdomain"]
    face = skin(cells, part)
    colours = (
        plt.get_cmap("Pastel1")(part[face[0][:, 0]] * 5 % 9),
        plt.get_cmap("viridis")(scale(stress[face].mean(axis=1))),
    )
    view = principal_view(cells.X.reshape(-1, 3), tilt=15)
    fig, axes = plt.subplots(1, 2, figsize=(11, 7.2), sharex=True, sharey=True)
    titles = ("at rest", f"at {pressure:g} mmHg")
    for ax, x, colour, title in zip(axes, (cells.X, cells.x), colours, titles, strict=True):
        paint(ax, surface(view, shrunk(x, part, SHRINK)[face], colour))
        ax.set_title(title)
    bar = fig.colorbar(ScalarMappable(scale, "viridis"), ax=axes, shrink=0.6, extend="both")
    bar.set_label("stress magnitude  σ_mag = √(σ : σ)  [kPa]")
    _save(fig, path)


def draw_fibres(path: Path, cells: Cells, layers: Sequence[str]) -> None:
    """Draw the fibres on the whole wall, and on its first layer alone.

    The values of the cells are `layer` (its number), `fibres_1` and `fibres_2`.
    """
    view = principal_view(cells.X.reshape(-1, 3), tilt=15)
    fig, axes = plt.subplots(1, 2, figsize=(11, 7.2), sharex=True, sharey=True)
    layer = cells.values["layer"].astype(int)
    for ax, title, shown in zip(
        axes, (" and ".join(layers), layers[0]), (layer >= 0, layer == 0), strict=True
    ):
        cell, corner = skin(cells, np.where(shown, 0, 1 + np.arange(len(layer))))
        cell, corner = cell[shown[cell[:, 0]]], corner[shown[cell[:, 0]]]
        x, tissue = cells.X[cell, corner], layer[cell[:, 0]]
        drawn = np.random.default_rng(0).permutation(len(x))[:BARS]
        area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum() / 2
        length = LENGTH * np.sqrt(area / len(x[drawn]))
        families = [
            bars(view, x[drawn], cells.values[name][cell[drawn, 0]], length, colour)
            for name, colour in FAMILIES.items()
        ]
        paint(ax, surface(view, x, LAYERS[tissue % len(LAYERS)]), *families)
        ax.set_title(title)
    _save(fig, path)


def draw_convergence(path: Path, steps: Sequence[LoadStep]) -> None:
    """Draw Newton's residuals and the linear iterations of load steps."""
    fig, (above, below) = plt.subplots(2, 1, figsize=(8, 5.5), sharex=True)
    first = 1
    for step in steps:
        number = np.arange(first, first + len(step.history))
        (line,) = above.semilogy(number, [s.residual for s in step.history], "o-", ms=4)
        below.bar(number, [s.linear_iterations for s in step.history], color=line.get_color())
        middle, top = (number.mean(), 1.02), above.get_xaxis_transform()
        above.text(*middle, f"{step.load:.3g}", transform=top, ha="center", fontsize=8)
        first += len(step.history)
    above.set_title("pressure [mmHg]", fontsize=9, pad=16)
    above.set_ylabel("residual ‖r‖ [mN]")
    below.set_ylabel("FETI iterations")
    below.set_xlabel("Newton step")
    for ax in (above, below):
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(axis="y", color="0.9")
        ax.set_axisbelow(True)
    _save(fig, path)


def _at_vertices(cells: Cells, values: Array) -> Array:
    """Return the mean over all cells at each vertex, (cells, 4), of values of cells, (cells,)."""
    vertices = cells.vertices.ravel()
    total = np.bincount(vertices, np.repeat(values, 4))
    return (total / np.maximum(np.bincount(vertices), 1))[cells.vertices]


def _save(fig: plt.Figure, path: Path) -> None:
    fig.savefig(path, dpi=150, bbox_inches="tight")
    plt.close(fig)
