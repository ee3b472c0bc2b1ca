# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The pictures of `demo_artery.py`."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgba
from matplotlib.ticker import MaxNLocator

from dolfinx_feti.loading import LoadStep
from drawing.render import Cells, Scene, principal_view, skin

__all__ = ["draw_convergence", "draw_fibres", "draw_wall"]

Array = npt.NDArray[np.float64]

DPI = 150
#: Size of a subdomain in the picture; the rest is the gap that shows where the wall is torn.
SHRINK = 0.94
LAYERS = ("#d9776b", "#efd9a7", "#a9c3d9", "#c9b3d6", "#b5cfa5")
FAMILIES = ("#16325c", "#0f7a5a")


def draw_wall(path: Path, cells: Cells, *, pressure: float) -> None:
    """Draw the deformed wall coloured by the stress, its subdomains a little apart.

    Args:
        path: The file.
        cells: The wall with the values `stress` [kPa] and `subdomain`.
        pressure: [mmHg].
    """
    stress = _at_vertices(cells, cells.values["stress"])
    colours = Normalize(*np.round(np.percentile(stress, [1, 99]), 1))
    view = principal_view(cells.X.reshape(-1, 3), tilt=15)
    fig, axes = plt.subplots(1, 2, figsize=(11, 7.2), width_ratios=(1, 1))
    torn = _torn(cells, cells.X, view, np.full(stress.shape, np.nan), colours)
    deformed = _torn(cells, cells.x, view, stress, colours)
    for ax, scene, title in zip(
        axes, (torn, deformed), ("at rest", f"at {pressure:g} mmHg"), strict=False
    ):
        scene.draw(ax)
        ax.set_title(title)
    _same_scale(axes)
    bar = fig.colorbar(ScalarMappable(colours, "viridis"), ax=axes, shrink=0.6, extend="both")
    bar.set_label("stress magnitude  σ_mag = √(σ : σ)  [kPa]")
    fig.savefig(path, dpi=DPI, bbox_inches="tight")
    plt.close(fig)


def _torn(cells: Cells, x: Array, view: Array, stress: Array, colours: Normalize) -> Scene:
    """Return the subdomains, each shrunk towards its centroid."""
    part = cells.values["subdomain"]
    centroid = np.stack(
        [np.bincount(part, x[:, :, k].mean(axis=1)) / np.bincount(part) for k in range(3)], axis=1
    )
    x = centroid[part][:, None] + SHRINK * (x - centroid[part][:, None])
    cell, corner = skin(cells, part)
    if np.isnan(stress).all():
        rgba = plt.get_cmap("Pastel1")(part[cell] * 5 % 9)
    else:
        rgba = plt.get_cmap("viridis")(colours(stress[cell[:, None], corner].mean(axis=1)))
    scene = Scene(view)
    scene.add_surface(x[cell[:, None], corner], rgba)
    return scene


def draw_fibres(path: Path, cells: Cells, layers: Sequence[str]) -> None:
    """Draw the layers in their colours and the fibre families on them, with a zoom.

    In half of the zoom all layers but the first are taken away to show the fibres of that.

    Args:
        path: The file.
        cells: The wall with the values `layer` (its number), `fibres_1`, `fibres_2`.
        layers: The names of the layers.
    """
    view = principal_view(cells.X.reshape(-1, 3), tilt=15)
    fig, axes = plt.subplots(1, 2, figsize=(11, 6.5))
    everything = np.ones(len(cells.X), dtype=bool)
    _fibre_scene(cells, everything, view).draw(axes[0])
    middle, half = _spot(cells, view)
    right = (cells.X.mean(axis=1) - middle) @ view[0]
    kept = (cells.values["layer"] == 0) | (right > 0)
    _fibre_scene(cells, kept, view).draw(axes[1], (middle, half))
    if len(layers) > 1:
        axes[1].set_title(f"left half: {' and '.join(layers[1:])} taken away")
    low, high = (view[:2] @ middle - half), (view[:2] @ middle + half)
    axes[0].plot(
        *zip(low, (high[0], low[1]), high, (low[0], high[1]), low, strict=False), "k", lw=1
    )
    handles = [plt.Rectangle((0, 0), 1, 1, color=c) for _, c in _colours(layers)]
    handles += [plt.Line2D([0], [0], color=c, lw=2) for c in FAMILIES]
    labels = [*layers, "fibres, first family", "second family"]
    fig.legend(handles, labels, loc="lower center", ncols=4, frameon=False)
    fig.savefig(path, dpi=DPI, bbox_inches="tight")
    plt.close(fig)


def _fibre_scene(cells: Cells, kept: npt.NDArray[np.bool_], view: Array) -> Scene:
    """Return some of the cells, with bars along their fibres."""
    cell, corner = skin(cells, np.where(kept, 0, 1 + np.arange(len(kept))))
    shown = kept[cell]
    cell, corner = cell[shown], corner[shown]
    x = cells.X[cell[:, None], corner]
    scene = Scene(view)
    colour = np.array([to_rgba(c) for c in LAYERS])
    scene.add_surface(x, colour[cells.values["layer"][cell].astype(int) % len(LAYERS)])
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    length = 0.75 * np.sqrt(np.median(np.linalg.norm(normal, axis=1)))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    for family, paint in zip(("fibres_1", "fibres_2"), FAMILIES, strict=False):
        a = cells.values[family][cell]
        flat = np.abs(np.einsum("ij,ij->i", a, normal)) < 0.5  # not on the cut faces
        scene.add_segments(
            x[flat].mean(axis=1), a[flat], normal[flat], np.array(to_rgba(paint)), length=length
        )
    return scene


def _colours(layers: Sequence[str]) -> list[tuple[str, str]]:
    """Pair the layers with their colours, which come again after the last one."""
    return list(zip(layers, itertools.cycle(LAYERS), strict=False))


def _spot(cells: Cells, view: Array) -> tuple[Array, float]:
    """Find a window that the nearest part of the wall fills; return its middle and half width."""
    cell, corner = skin(cells, np.zeros(len(cells.X), dtype=int))
    x = cells.X[cell[:, None], corner]
    area = 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) @ view[2]
    flat = x[area > 0].mean(axis=1) @ view.T
    area = area[area > 0]
    half = 0.13 * float(np.min(np.ptp(flat, axis=0)[:2]))
    candidates = flat[:: max(1, len(flat) // 400)]
    shift = flat[None] - candidates[:, None]
    seen = np.all(np.abs(shift[:, :, :2]) < half, axis=2)
    hidden = seen & (shift[:, :, 2] > half)
    seen &= np.abs(shift[:, :, 2]) < half
    score = np.where(seen, area, 0.0).sum(axis=1) - 10 * np.where(hidden, area, 0.0).sum(axis=1)
    return view.T @ candidates[np.argmax(score)], half


def draw_convergence(path: Path, steps: Sequence[LoadStep]) -> None:
    """Draw Newton's residuals and the linear iterations of all load steps.

    Args:
        path: The file.
        steps: The accepted load steps.
    """
    fig, (above, below) = plt.subplots(2, 1, figsize=(8, 5.5), sharex=True)
    first = 0
    for i, step in enumerate(steps):
        number = first + np.arange(len(step.history))
        colour = plt.get_cmap("viridis")(0.85 * i / max(1, len(steps) - 1))
        above.semilogy(number, [s.residual for s in step.history], "o-", color=colour, ms=4)
        below.bar(number, [s.linear_iterations for s in step.history], color=colour)
        middle = number.mean()
        above.text(
            middle,
            1.02,
            f"{step.load:.3g}",
            transform=above.get_xaxis_transform(),
            ha="center",
            fontsize=8,
        )
        first += len(step.history)
    above.set_ylabel("residual ‖r‖ [mN]")
    above.set_title("pressure [mmHg]", fontsize=9, pad=16)
    below.set_ylabel("FETI iterations")
    below.set_xlabel("Newton step")
    below.xaxis.set_major_locator(MaxNLocator(integer=True))
    for ax in (above, below):
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(axis="y", color="0.9")
        ax.set_axisbelow(True)
    fig.savefig(path, dpi=DPI, bbox_inches="tight")
    plt.close(fig)


def _at_vertices(cells: Cells, values: Array) -> Array:
    """Return the mean over all cells at each vertex, (cells, 4), of values of cells, (cells,)."""
    vertices = cells.vertices.ravel()
    count = np.bincount(vertices)
    total = np.bincount(vertices, np.repeat(values, 4))
    return (total / np.maximum(count, 1))[cells.vertices]


def _same_scale(axes: npt.NDArray[np.object_]) -> None:
    """Give all axes the extent of the largest, each around its own middle."""
    for get, put in (("get_xlim", "set_xlim"), ("get_ylim", "set_ylim")):
        limits = np.array([getattr(ax, get)() for ax in axes])
        half = np.diff(limits).max() / 2
        for ax, middle in zip(axes, limits.mean(axis=1), strict=False):
            getattr(ax, put)(middle - half, middle + half)
