# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A small renderer for matplotlib: tetrahedra seen from one side, lit, in vector colours.

Triangles and bars become polygons that are painted from the farthest to the nearest (painter's
algorithm) in an orthographic view, an orthonormal matrix with the rows right, up, towards the
viewer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba

import dolfinx

__all__ = ["Cells", "bars", "gather_cells", "paint", "principal_view", "shrunk", "skin", "surface"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

#: Direction to the light in the frame of the view.
LIGHT = np.array([-0.45, 0.55, 0.7]) / np.linalg.norm([-0.45, 0.55, 0.7])
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


@dataclass(frozen=True, slots=True)
class Cells:
    """All tetrahedra of a mesh on one process."""

    vertices: Indices  # global numbers, (cells, 4)
    X: Array  # reference coordinates, (cells, 4, 3)
    x: Array  # deformed coordinates, (cells, 4, 3)
    values: dict[str, Array]  # of the cells, by name, (cells, …)


def gather_cells(u: dolfinx.fem.Function, values: dict[str, Array]) -> Cells | None:
    """Return all cells, with the displacement u and values of the owned cells, on process 0.

    Collective; None on the other processes.
    """
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


def skin(cells: Cells, part: npt.NDArray[np.integer]) -> tuple[Indices, Indices]:
    """Return the faces of cells that no other cell of the same part, (cells,), has.

    These are the cell of each face, (faces, 1), and its corners among the cell's, (faces, 3),
    counter-clockwise seen from outside: together they index an array (cells, 4, …).
    """
    corners = np.sort(cells.vertices[:, FACES], axis=2).reshape(-1, 3)
    keys = np.column_stack([np.repeat(part, 4), corners])
    _, first, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
    cell, face = np.divmod(np.sort(first[count == 1]), 4)
    a, b, c, d = (cells.X[cell, k] for k in (0, 1, 2, 3))
    volume = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)[:, None]
    return cell[:, None], np.where(volume > 0, FACES[face], FACES[face][:, ::-1])


def shrunk(x: Array, part: npt.NDArray[np.integer], factor: float) -> Array:
    """Shrink each part towards its centroid c, c + factor (x − c); the gaps show the parts."""
    count = np.maximum(np.bincount(part), 1)
    c = np.stack([np.bincount(part, x[:, :, k].mean(axis=1)) / count for k in range(3)], axis=1)
    return c[part][:, None] + factor * (x - c[part][:, None])


def principal_view(points: Array, tilt: float) -> Array:
    """Return a view with the longest axis of points (n, 3) upright and the shortest in front.

    The viewer looks from above by ``tilt`` degrees.
    """
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    up, right = (v * np.sign(v[np.argmax(np.abs(v))]) for v in axes[:2])
    t, front = np.deg2rad(tilt), np.cross(right, up)
    return np.array([right, np.cos(t) * up - np.sin(t) * front, np.cos(t) * front + np.sin(t) * up])


class Polygons(NamedTuple):
    """Quadrilaterals in a view, (n, 4, 2), their depths (n,) and colours (n, 4)."""

    corners: Array
    depths: Array
    colours: Array


def surface(view: Array, x: Array, colours: Array) -> Polygons:
    """Return the triangles x, (n, 3, 3), that face the viewer, in colours (n, 4) under light."""
    x = x @ view.T
    n = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)
    front = n[:, 2] > 0
    x, n, colours = x[front], n[front], np.array(colours)[front]
    light = np.clip(n @ LIGHT, 0, 1)[:, None]
    gloss = 0.18 * np.clip(n[:, 2:] * 0.35 + light * 0.75, 0, 1) ** 24
    colours[:, :3] = np.clip(colours[:, :3] * (0.5 + 0.55 * light) + gloss, 0, 1)
    return Polygons(x[:, [0, 1, 2, 2], :2], x[:, :, 2].mean(axis=1), colours)


def bars(view: Array, x: Array, direction: Array, length: float, colour: str) -> Polygons:
    """Return flat bars of a length on the triangles x, (n, 3, 3), along unit vectors (n, 3)."""
    n = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    seen = (n @ view[2] > 0.1) & (np.abs(np.einsum("ij,ij->i", direction, n)) < 0.5)
    along = 0.5 * length * direction[seen]
    across = 0.1 * np.cross(n[seen], along)
    quad = np.stack([-along - across, along - across, along + across, across - along], axis=1)
    quad = (x[seen].mean(axis=1)[:, None] + quad) @ view.T
    lifted = quad[:, :, 2].mean(axis=1) + 0.6 * length  # above the triangles nearby
    return Polygons(quad[:, :, :2], lifted, np.tile(to_rgba(colour), (len(quad), 1)))


def paint(ax: Axes, *layers: Polygons) -> None:
    """Paint polygons on axes without frame and with equal scales."""
    corners, depths, colours = map(np.concatenate, zip(*layers, strict=True))
    order = np.argsort(depths, kind="stable")
    corners, colours = corners[order], colours[order]
    ax.add_collection(
        PolyCollection(corners, facecolors=colours, edgecolors=colours, linewidths=0.15)
    )
    ax.autoscale()
    ax.margins(0.01)
    ax.set_aspect("equal")
    ax.set_axis_off()
