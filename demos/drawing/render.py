# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A small renderer for matplotlib: what a mesh looks like from one side, lit, in vector colours.

All polygons of a scene are triangles or quadrilaterals, drawn from the farthest to the nearest
(painter's algorithm) in an orthographic view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

import dolfinx

__all__ = ["Cells", "Scene", "gather_cells", "principal_view", "skin"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

#: Direction to the light in the frame of the view (right, up, towards the viewer).
LIGHT = np.array([-0.45, 0.55, 0.7]) / np.linalg.norm([-0.45, 0.55, 0.7])
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


@dataclass(frozen=True, slots=True)
class Cells:
    """All tetrahedra of a mesh on one process.

    Attributes:
        vertices: Global numbers of the vertices, (cells, 4).
        X: Their reference coordinates, (cells, 4, 3).
        u: Their displacements, (cells, 4, 3).
        values: Values of the cells, by name, (cells, …).
    """

    vertices: Indices
    X: Array
    u: Array
    values: dict[str, Array]

    @property
    def x(self) -> Array:
        """Deformed coordinates, (cells, 4, 3)."""
        return self.X + self.u


def gather_cells(u: dolfinx.fem.Function, values: dict[str, Array]) -> Cells | None:
    """Bring the cells of all processes to the first one.

    Args:
        u: Displacement.
        values: Values of the owned cells, by name, (owned cells, …).

    Returns:
        The cells on the first process, None on others.

    Note:
        Collective.
    """
    mesh = u.function_space.mesh
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    vertex = dolfinx.fem.Function(V)
    vertex.interpolate(u)
    dofs = V.dofmap.list[: mesh.topology.index_map(3).size_local]
    local = {
        "vertices": V.dofmap.index_map.local_to_global(dofs.ravel()).reshape(dofs.shape),
        "X": V.tabulate_dof_coordinates()[dofs],
        "u": vertex.x.array.reshape(-1, 3)[dofs],
        **values,
    }
    parts = mesh.comm.gather(local)
    if mesh.comm.rank != 0:
        return None
    whole = {name: np.concatenate([part[name] for part in parts]) for name in local}
    return Cells(vertices=whole.pop("vertices"), X=whole.pop("X"), u=whole.pop("u"), values=whole)


def skin(cells: Cells, part: npt.NDArray[np.integer]) -> tuple[Indices, Indices]:
    """Find the faces of cells that no other cell of the same part has.

    Args:
        cells: The cells.
        part: Part of each cell, such as its subdomain, (cells,).

    Returns:
        The cell of each such face, (faces,), and its corners among the cell's, (faces, 3), turned
        outwards.
    """
    corners = np.sort(cells.vertices[:, FACES], axis=2).reshape(-1, 3)
    keys = np.column_stack([np.repeat(part, 4), corners])
    _, first, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
    cell, face = np.divmod(np.sort(first[count == 1]), 4)
    turned = FACES[face]
    a, b, c = (cells.X[cell, turned[:, k]] for k in range(3))
    outwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a - cells.X[cell].mean(axis=1)) > 0
    turned = np.where(outwards[:, None], turned, turned[:, ::-1])
    return cell, turned


def principal_view(points: Array, tilt: float = 0.0) -> Array:
    """Return a view with the longest axis of a cloud of points upright and the shortest in front.

    Args:
        points: Coordinates, (n, 3).
        tilt: Degrees by which the viewer looks from above.

    Returns:
        Rows right, up, towards the viewer, (3, 3).
    """
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    up, right = axes[0], axes[1]
    up, right = (v * np.sign(v[np.argmax(np.abs(v))]) for v in (up, right))
    t = np.deg2rad(tilt)
    front = np.cross(right, up)
    return np.array([right, np.cos(t) * up - np.sin(t) * front, np.cos(t) * front + np.sin(t) * up])


class Scene:
    """Polygons to be drawn together.

    Attributes:
        view: Rows right, up, towards the viewer, (3, 3).
    """

    def __init__(self, view: Array) -> None:
        self.view = view
        self._polygons: list[Array] = []
        self._colours: list[Array] = []
        self._depths: list[Array] = []

    def add_surface(self, corners: Array, colours: Array, *, shade: bool = True) -> None:
        """Add triangles that face outwards; those seen from behind are left out.

        Args:
            corners: Corners, (n, 3, 3).
            colours: Red, green, blue, opacity, (n, 4).
            shade: Whether light falls on them.
        """
        corners = corners @ self.view.T
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        front = normal[:, 2] > 0
        colours = np.array(np.broadcast_to(colours, (len(corners), 4)))
        if shade:
            light = np.clip(normal @ LIGHT, 0, 1)[:, None]
            gloss = 0.18 * np.clip(normal[:, 2:] * 0.35 + light * 0.75, 0, 1) ** 24
            colours[:, :3] = np.clip(colours[:, :3] * (0.5 + 0.55 * light) + gloss, 0, 1)
        self._append(corners[front][:, [0, 1, 2, 2]], colours[front], 0.0)

    def add_segments(
        self, middle: Array, direction: Array, normal: Array, colours: Array, *, length: float
    ) -> None:
        """Add short flat bars that lie on a surface.

        Args:
            middle: Their middles, (n, 3).
            direction: Unit vectors along them, (n, 3).
            normal: Normals of the surface; bars seen from behind are left out, (n, 3).
            colours: (n, 4).
            length: Their length; they are a tenth as wide.
        """
        across = np.cross(normal, direction)
        along, across = 0.5 * length * direction, 0.05 * length * across
        corners = np.stack([-along - across, along - across, along + across, -along + across], 1)
        corners = (middle[:, None] + corners) @ self.view.T
        front = normal @ self.view[2] > 0.1
        colours = np.broadcast_to(colours, (len(middle), 4))
        self._append(corners[front], colours[front], 0.6 * length)

    def _append(self, corners: Array, colours: Array, lift: float) -> None:
        self._polygons.append(corners[:, :, :2])
        self._colours.append(colours)
        self._depths.append(corners[:, :, 2].mean(axis=1) + lift)

    def draw(self, axes: Axes, window: tuple[Array, float] | None = None) -> None:
        """Draw everything and fit the axes to it.

        Args:
            axes: Where to draw.
            window: Middle (in space) and half width of what is to be seen; None for all of it.
        """
        order = np.argsort(np.concatenate(self._depths), kind="stable")
        polygons = np.concatenate(self._polygons)[order]
        colours = np.concatenate(self._colours)[order]
        if window is not None:
            middle, half = self.view[:2] @ window[0], window[1]
            near = np.all(np.abs(polygons.mean(axis=1) - middle) < 1.5 * half, axis=1)
            polygons, colours = polygons[near], colours[near]
        axes.add_collection(
            PolyCollection(polygons, facecolors=colours, edgecolors=colours, linewidths=0.15)
        )
        if window is None:
            low, high = polygons.min(axis=(0, 1)), polygons.max(axis=(0, 1))
        else:
            low, high = middle - half, middle + half
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_aspect("equal")
        axes.set_axis_off()
