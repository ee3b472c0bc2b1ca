# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Triangulated surfaces with rims: STL files, edges, normals, and projection onto a surface.

Shapes: points `x` (n, 3) [mm], triangles `t` (m, 3), edges (k, 2).
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import scipy.spatial

__all__ = ["Edges", "Guide", "find_edges", "read_stl", "vertex_normals"]

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Edges:
    """The edges of a surface, with the triangles on both sides.

    Attributes:
        ends: The two vertices of each edge, lower number first, (k, 2).
        sides: Its triangles, -1 where there is no second one, (k, 2).
        across: The vertices of those triangles off the edge, -1 for none, (k, 2).
        of_triangle: The edge opposite to each vertex of each triangle, (m, 3).
    """

    ends: Indices
    sides: Indices
    across: Indices
    of_triangle: Indices

    @property
    def rim(self) -> Indices:
        """The edges with one triangle, lower number first, (r, 2)."""
        return self.ends[self.sides[:, 1] < 0]

    def on_rim(self, n: int) -> Mask:
        """Return a mask of the vertices on a rim, (n,)."""
        mask = np.zeros(n, dtype=bool)
        mask[self.rim] = True
        return mask


class Guide:
    """Projection onto a surface: nearest points on its triangles and on its rims."""

    def __init__(self, x: Points, t: Indices) -> None:
        """Sort the triangles into a search tree.

        Args:
            x: Points, (n, 3).
            t: Triangles, (m, 3).
        """
        self.corners = x[t]
        self.rim = x[find_edges(t).rim]
        self.tree = scipy.spatial.cKDTree(self.corners.mean(axis=1))

    def project(self, p: Points, *, candidates: int = 24) -> Points:
        """Return the nearest points on the triangles whose centroids are nearest, (n, 3).

        Args:
            p: Points, (n, 3).
            candidates: Number of these triangles. 24 are two rings around a vertex of a regular
                triangulation.
        """
        _, near = self.tree.query(p, k=min(candidates, len(self.corners)))
        a, b, c = np.moveaxis(self.corners[near], 2, 0)
        return _nearest(p, _nearest_on_triangles(p[:, None], a, b, c))

    def project_on_rim(self, p: Points) -> Points:
        """Return the nearest points on the rims, (n, 3)."""
        return _nearest(p, _nearest_on_segments(p[:, None], self.rim[:, 0], self.rim[:, 1]))


def read_stl(path: Path) -> tuple[Points, Indices]:
    """Read an STL file, text or binary, gzipped or not, and join its corners.

    Args:
        path: The file; a gzipped one ends in `.gz`.

    Returns:
        Points (n, 3), in the file's unit, and triangles (m, 3).

    Raises:
        ValueError: The file holds no triangle.
    """
    with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
        data = file.read()
    if data[:5] == b"solid" and b"vertex" in data:
        words = np.array(data.split())
        at = np.flatnonzero(words == b"vertex")
        corners = words[at[:, None] + [1, 2, 3]].astype(np.float64).reshape(-1, 3)
    else:
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
        body = data[84 : 84 + (len(data) - 84) // record.itemsize * record.itemsize]
        corners = np.frombuffer(body, record)["corners"].astype(np.float64).reshape(-1, 3)
    if not len(corners):
        raise ValueError(f"{path} holds no triangle: give an STL file of the lumen's surface")
    x, number = np.unique(corners, axis=0, return_inverse=True)
    t = number.reshape(-1, 3).astype(np.int64)
    return x, t[(t[:, 0] != t[:, 1]) & (t[:, 1] != t[:, 2]) & (t[:, 2] != t[:, 0])]


def find_edges(t: Indices) -> Edges:
    """Return the edges of the triangles.

    Args:
        t: Triangles, (m, 3).

    Raises:
        ValueError: More than two triangles meet in an edge.
    """
    n = int(t.max()) + 1
    half = np.sort(t[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
    key, first, inverse, count = np.unique(
        half[:, 0] * n + half[:, 1], return_index=True, return_inverse=True, return_counts=True
    )
    if count.max() > 2:
        raise ValueError(
            f"{np.sum(count > 2)} edges of the surface belong to more than two triangles: "
            "repair the surface"
        )
    second = np.full(len(key), -1)
    rest = np.setdiff1d(np.arange(len(half)), first)
    second[inverse[rest]] = rest
    halves = np.column_stack([first, second])
    return Edges(
        ends=np.column_stack([key // n, key % n]),
        sides=np.where(halves < 0, -1, halves // 3),
        across=np.where(halves < 0, -1, t.ravel()[halves]),
        of_triangle=inverse.reshape(-1, 3),
    )


def triangle_normals(x: Points, t: Indices) -> Points:
    """Return the unit normals of the triangles, (m, 3)."""
    return unit(np.asarray(np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]])))


def vertex_normals(x: Points, t: Indices) -> Points:
    """Return the unit normals at the vertices, triangles weighted with their angles, (n, 3)."""
    n = np.zeros_like(x)
    weighted = triangle_angles(x, t)[:, :, None] * triangle_normals(x, t)[:, None]
    np.add.at(n, t, weighted)
    return unit(n)


def triangle_angles(x: Points, t: Indices) -> Points:
    """Return the angles of the triangles at their vertices [rad], (m, 3)."""
    p = x[t]
    u = unit(np.roll(p, -1, axis=1) - p)
    v = unit(np.roll(p, -2, axis=1) - p)
    return np.asarray(np.arccos(np.clip(np.sum(u * v, axis=2), -1, 1)))


def edge_lengths(x: Points, ends: Indices) -> Points:
    """Return the lengths of edges, (k,)."""
    return np.asarray(np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1))


def unit(v: Points) -> Points:
    """Return vectors (…, 3) of length one, zero for zero."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(v / np.maximum(length, np.finfo(float).tiny))


def _nearest(p: Points, feet: Points) -> Points:
    """Return the nearest of several feet, (n, k, 3), of each point, (n, 3)."""
    best = np.argmin(np.linalg.norm(feet - p[:, None], axis=2), axis=1)
    return np.asarray(feet[np.arange(len(p)), best])


def _nearest_on_segments(p: Points, a: Points, b: Points) -> Points:
    """Return the nearest points to p on the segments from a to b, (…, 3)."""
    d = b - a
    dd = np.maximum(np.sum(d * d, axis=-1), np.finfo(float).tiny)
    s = np.clip(np.sum((p - a) * d, axis=-1) / dd, 0, 1)
    return np.asarray(a + s[..., None] * d)


def _nearest_on_triangles(p: Points, a: Points, b: Points, c: Points) -> Points:
    """Return the nearest points to p on triangles with corners a, b and c, (…, 3).

    It is the foot of the perpendicular if that is inside, else the nearest point of an edge.
    """
    u = b - a
    v = c - a
    w = p - a
    uu = np.sum(u * u, axis=-1)
    uv = np.sum(u * v, axis=-1)
    vv = np.sum(v * v, axis=-1)
    wu = np.sum(w * u, axis=-1)
    wv = np.sum(w * v, axis=-1)
    det = uu * vv - uv * uv
    flat = det <= 1e-12 * uu * vv  # an angle below 1e-6: a rounding margin
    det = np.where(flat, 1, det)
    r = (vv * wu - uv * wv) / det
    s = (uu * wv - uv * wu) / det
    foot = a + r[..., None] * u + s[..., None] * v
    inside = ~flat & (r >= 0) & (s >= 0) & (r + s <= 1)
    distance = np.where(inside, np.sum((foot - p) ** 2, axis=-1), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        on_edge = _nearest_on_segments(p, start, end)
        to_edge = np.sum((on_edge - p) ** 2, axis=-1)
        foot = np.where((to_edge < distance)[..., None], on_edge, foot)
        distance = np.minimum(distance, to_edge)
    return np.asarray(foot)
