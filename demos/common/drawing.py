# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pictures of walls of tetrahedra by matplotlib: surfaces with a colour bar, subdomains, fibres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

import dolfinx

__all__ = ["Cells", "draw_fibres", "draw_values", "draw_wall", "gather_cells"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
LAYERS = plt.get_cmap("Pastel1")
VIEWER = np.array([0.40, -0.85, 0.34])  # of elev = 20, azim = -65
FAMILIES = {"fibres_1": "#16325c", "fibres_2": "#b5443a"}


@dataclass(frozen=True, slots=True)
class Cells:
    """All tetrahedra of a mesh on one process."""

    vertices: Indices  # global numbers, (cells, 4)
    X: Array  # reference coordinates, (cells, 4, 3)
    x: Array  # deformed coordinates, (cells, 4, 3)
    values: dict[str, Array]  # of the cells, by name, (cells, …)

    def skin(self, part: Indices | None = None) -> tuple[Indices, Indices]:
        """Return the faces of one cell of a part alone: (faces, 1), and its corners, (faces, 3)."""
        part = np.zeros(len(self.X), dtype=np.int64) if part is None else part
        corners = np.sort(self.vertices[:, FACES], axis=2).reshape(-1, 3)
        keys = np.column_stack([np.repeat(part, 4), corners])
        _, first, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
        cell, face = np.divmod(np.sort(first[count == 1]), 4)
        return cell[:, None], FACES[face]


def gather_cells(u: dolfinx.fem.Function, values: dict[str, Array]) -> Cells | None:
    """Return all cells, with u and values of the owned ones, on process 0, or None. Collective."""
    mesh = u.function_space.mesh
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    vertex = dolfinx.fem.Function(V)
    vertex.interpolate(u)
    dofs = V.dofmap.list[: mesh.topology.index_map(3).size_local]
    X = V.tabulate_dof_coordinates()
    vertices = V.dofmap.index_map.local_to_global(dofs.ravel()).reshape(dofs.shape)
    local = (vertices, X[dofs], (X + vertex.x.array.reshape(-1, 3))[dofs], *values.values())
    parts = mesh.comm.gather(local)
    if mesh.comm.rank != 0:
        return None
    vertices, X, x, *arrays = map(np.concatenate, zip(*parts, strict=True))
    return Cells(vertices, X, x, dict(zip(values, arrays, strict=True)))


def paint(ax: Axes3D, x: Array, colours: Array, axes: Array, lines: dict[str, Array]) -> None:
    """Paint triangles, (n, 3, 3), and lines by colour, (n, 2, 3)."""
    x = x @ axes.T
    ax.add_collection3d(
        Poly3DCollection(x, facecolors=colours, edgecolors="0.35", lw=0.1, clip_on=False)
    )
    for colour, ends in lines.items():
        ax.add_collection3d(Line3DCollection(ends @ axes.T, colors=colour, lw=0.8))
    ax.computed_zorder = False  # lines in front
    low, high = x.min(axis=(0, 1)), x.max(axis=(0, 1))
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(high - low, zoom=1.2)
    ax.view_init(elev=20, azim=-65)
    ax.set_axis_off()


def principal(x: Array) -> Array:
    """Return axes, the longest one to the right and the next upwards, as rows."""
    points = x.reshape(-1, 3) - x.reshape(-1, 3).mean(axis=0)
    _, _, (right, up, depth) = np.linalg.svd(points, full_matrices=False)
    right, up = (v * np.sign(v[np.argmax(np.abs(v))]) for v in (right, up))
    return np.array([right, depth * np.sign(np.linalg.det([right, depth, up])), up])


def _panels(number: int) -> tuple[plt.Figure, npt.NDArray[np.object_]]:
    """Return a figure and its axes, beside each other."""
    size = {"figsize": (5 * number, 4.3), "layout": "constrained", "squeeze": False}
    return plt.subplots(1, number, **size, subplot_kw={"projection": "3d"})


def draw_values(path: Path, panels: dict[str, tuple[Array, Array]], label: str) -> None:
    """Draw surfaces by title: triangles (n, 3, 3) with values (n,), or colours (n, 4)."""
    shown = np.concatenate([values for _, values in panels.values() if values.ndim == 1])
    scale = Normalize(*np.percentile(shown, [1, 99]))
    fig, axes = _panels(len(panels))
    view = principal(next(iter(panels.values()))[0])
    for ax, (title, (x, values)) in zip(axes[0], panels.items(), strict=True):
        colours = plt.get_cmap("viridis")(scale(values)) if values.ndim == 1 else values
        paint(ax, x, colours, view, {})
        ax.set_title(title, fontsize=14)
    bar = fig.colorbar(ScalarMappable(scale, "viridis"), ax=axes, shrink=0.7, extend="both")
    bar.set_label(label, fontsize=13)
    fig.savefig(path, dpi=130)
    plt.close(fig)


def draw_wall(path: Path, cells: Cells, *, pressure: float) -> None:
    """Draw the subdomains apart, at rest, and the wall with its stress at a pressure."""
    part = cells.values["subdomain"].astype(np.int64)
    sums = np.stack([np.bincount(part, x) for x in cells.X.mean(axis=1).T], axis=1)
    centre = (sums / np.maximum(np.bincount(part), 1)[:, None])[part][:, None]
    torn, skin = cells.skin(part), cells.skin()
    apart = (centre + 0.92 * (cells.X - centre))[torn]
    panels = {
        "at rest, torn": (apart, LAYERS(part[torn[0][:, 0]] % 9)),
        f"at {pressure:g} mmHg": (cells.x[skin], cells.values["stress"][skin[0][:, 0]]),
    }
    draw_values(path, panels, "stress magnitude  √(σ : σ)  [kPa]")


def draw_fibres(path: Path, cells: Cells, layers: Sequence[str], most: int = 3000) -> None:
    """Draw both families of fibres, `fibres_1` and `fibres_2`, on the near side of each layer."""
    fig, axes = _panels(len(layers))
    layer, view = cells.values["layer"].astype(np.int64), principal(cells.X)
    for i, (ax, name) in enumerate(zip(axes[0], layers, strict=True)):
        cell, corner = cells.skin(np.where(layer == i, 0, 1 + np.arange(len(layer))))
        own = layer[cell[:, 0]] == i
        x, cell = cells.X[cell, corner][own], cell[own, 0]
        edges, middle = x[:, 1:] - x[:, :1], x.mean(axis=1)
        normal, outwards = np.cross(edges[:, 0], edges[:, 1]), middle - cells.X[cell].mean(axis=1)
        normal *= np.sign(np.einsum("ij,ij->i", normal, outwards))[:, None]
        near = np.flatnonzero(normal @ view.T @ VIEWER > 0.2 * np.linalg.norm(normal, axis=1))
        some = np.random.default_rng(0).permutation(near)[:most]
        half = np.linalg.norm(edges[:, 0], axis=1).mean() / 3
        a = {colour: half * cells.values[key][cell[some]] for key, colour in FAMILIES.items()}
        lines = {c: np.stack([middle[some] - b, middle[some] + b], axis=1) for c, b in a.items()}
        paint(ax, x, np.tile(LAYERS(6), (len(x), 1)), view, lines)
        ax.set_title(name, fontsize=14)
    handles = [plt.Line2D([], [], color=colour) for colour in FAMILIES.values()]
    fig.legend(handles, ["first family", "second family"], loc="lower center", ncols=2)
    fig.savefig(path, dpi=130)
    plt.close(fig)
