# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Triangulated surfaces with rims: STL files, edges, normals, and projection onto a surface.

In this file and those that use it, x are points, (n, 3) [mm], and t triangles, (m, 3): the numbers
of their corners.
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.spatial

from dolfinx_feti.runtime.arrays import Array, Mask, Numbers

__all__ = ["Edges", "SurfaceProjection", "find_edges", "read_stl", "vertex_normals"]

#: Bytes before the triangles of a binary STL file: a comment of 80, and the number of triangles.
STL_HEADER_BYTES = 84

#: Triangles on which the nearest point is searched. 24 are two rings around a vertex of a regular
#: triangulation.
CANDIDATES = 24

#: Square of the sine of the angle at the first corner of a triangle below which it counts as a
#: segment: an angle of 1e-6, a rounding margin.
FLAT_SINE_SQUARED = 1e-12


@dataclass(frozen=True, slots=True)
class Edges:
    """The edges of a surface, with the triangles on both sides.

    Attributes:
        ends: The two vertices of each edge, lower number first, (k, 2).
        triangles: The triangles of each edge, −1 if there is no second one, (k, 2).
        opposite: The vertex of each of these triangles that is not on the edge, −1 if there is no
            triangle, (k, 2).
        of_triangle: The edge opposite to each vertex of each triangle, (m, 3).
    """

    ends: Numbers
    triangles: Numbers
    opposite: Numbers
    of_triangle: Numbers

    @property
    def is_interior(self) -> Mask:
        """Mask of the edges with two triangles, (k,)."""
        return self.triangles[:, 1] >= 0

    @property
    def rim(self) -> Numbers:
        """Ends of the edges with one triangle, lower number first, (r, 2)."""
        return self.ends[~self.is_interior]

    def on_rim(self, n: int) -> Mask:
        """Return a mask of those of the n vertices that are on a rim, (n,)."""
        mask = np.zeros(n, dtype=bool)
        mask[self.rim] = True
        return mask


class SurfaceProjection:
    """Projection onto a surface: nearest points on its triangles and on its rims."""

    def __init__(self, x: Array, t: Numbers) -> None:
        """Sort the triangles into a search tree by their centroids.

        Args:
            x: Points, (n, 3).
            t: Triangles, (m, 3).
        """
        self._corners = x[t]
        self._rim = x[find_edges(t).rim]
        self._tree = scipy.spatial.cKDTree(self._corners.mean(axis=1))

    def project(self, p: Array, *, candidates: int = CANDIDATES) -> Array:
        """Return the nearest points on the surface, (n, 3).

        Args:
            p: Points, (n, 3).
            candidates: Number of triangles that are searched for each point, those with the nearest
                centroids.
        """
        _, near = self._tree.query(p, k=min(candidates, len(self._corners)))
        a, b, c = np.moveaxis(self._corners[near], 2, 0)
        return _nearest(p, _nearest_on_triangles(p[:, None], a, b, c))

    def project_on_rim(self, p: Array) -> Array:
        """Return the nearest points on the rims, (n, 3)."""
        return _nearest(p, _nearest_on_segments(p[:, None], self._rim[:, 0], self._rim[:, 1]))


def read_stl(path: Path) -> tuple[Array, Numbers]:
    """Read an STL file, text or binary, gzipped or not, and join its corners.

    Args:
        path: The file; a gzipped one ends in `.gz`.

    Returns:
        Points, (n, 3), in the file's unit, and triangles, (m, 3).

    Raises:
        ValueError: The file holds no triangle.
    """
    with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
        data = file.read()
    if data[:5] == b"solid" and b"vertex" in data:
        corners = _corners_in_text(data)
    else:
        corners = _corners_in_binary(data)
    if not len(corners):
        raise ValueError(f"{path} holds no triangle: give an STL file of the lumen's surface")
    x, number = np.unique(corners, axis=0, return_inverse=True)
    return x, without_collapsed(number.reshape(-1, 3).astype(np.int64))


def _corners_in_text(data: bytes) -> Array:
    """Return the corners of the triangles in an STL text, (3 triangles, 3)."""
    words = np.array(data.split())
    at = np.flatnonzero(words == b"vertex")
    return words[at[:, None] + [1, 2, 3]].astype(np.float64).reshape(-1, 3)


def _corners_in_binary(data: bytes) -> Array:
    """Return the corners of the triangles in a binary STL file, (3 triangles, 3).

    An incomplete triangle at the end is left out.
    """
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
    body = data[STL_HEADER_BYTES:]
    complete = body[: len(body) // record.itemsize * record.itemsize]
    return np.frombuffer(complete, record)["corners"].astype(np.float64).reshape(-1, 3)


def without_collapsed(t: Numbers) -> Numbers:
    """Return the triangles with three different corners, (k, 3)."""
    return t[(t[:, 0] != t[:, 1]) & (t[:, 1] != t[:, 2]) & (t[:, 2] != t[:, 0])]


def find_edges(t: Numbers) -> Edges:
    """Return the edges of the triangles.

    Args:
        t: Triangles, (m, 3).

    Raises:
        ValueError: More than two triangles meet in an edge.
    """
    n = int(t.max()) + 1
    # three sides of each triangle, opposite to its corners; an edge (a, b) has the key a n + b
    sides = np.sort(t[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
    key, first, edge_of_side, count = np.unique(
        sides[:, 0] * n + sides[:, 1], return_index=True, return_inverse=True, return_counts=True
    )
    if count.max() > 2:
        raise ValueError(
            f"{np.sum(count > 2)} edges of the surface belong to more than two triangles: "
            "repair the surface"
        )
    second = np.full(len(key), -1)
    others = np.setdiff1d(np.arange(len(sides)), first)
    second[edge_of_side[others]] = others
    sides_of_edge = np.column_stack([first, second])  # −1: there is no second side
    return Edges(
        ends=np.column_stack([key // n, key % n]),
        triangles=np.where(sides_of_edge < 0, -1, sides_of_edge // 3),
        opposite=np.where(sides_of_edge < 0, -1, t.ravel()[sides_of_edge]),
        of_triangle=edge_of_side.reshape(-1, 3),
    )


def triangle_normals(x: Array, t: Numbers) -> Array:
    """Return the unit normals of the triangles, (m, 3)."""
    return unit(np.asarray(np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]])))


def vertex_normals(x: Array, t: Numbers) -> Array:
    """Return the unit normals at the vertices, triangles weighted with their angles, (n, 3)."""
    n = np.zeros_like(x)
    weighted = triangle_angles(x, t)[:, :, None] * triangle_normals(x, t)[:, None]
    np.add.at(n, t, weighted)
    return unit(n)


def triangle_angles(x: Array, t: Numbers) -> Array:
    """Return the angles of the triangles at their vertices [rad], (m, 3)."""
    p = x[t]
    u = unit(np.roll(p, -1, axis=1) - p)
    v = unit(np.roll(p, -2, axis=1) - p)
    return np.asarray(np.arccos(np.clip(np.sum(u * v, axis=2), -1, 1)))


def edge_lengths(x: Array, ends: Numbers) -> Array:
    """Return the lengths of edges, (k,)."""
    return np.asarray(np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1))


def unit(v: Array) -> Array:
    """Return vectors (…, 3) of length one, zero for zero."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(v / np.maximum(length, np.finfo(float).tiny))


def _nearest(p: Array, feet: Array) -> Array:
    """Return the nearest of several candidates to each point, (n, 3).

    Args:
        p: Points, (n, 3).
        feet: Candidates of each point, (n, k, 3).
    """
    best = np.argmin(np.linalg.norm(feet - p[:, None], axis=2), axis=1)
    return np.asarray(feet[np.arange(len(p)), best])


def _nearest_on_segments(p: Array, a: Array, b: Array) -> Array:
    """Return the nearest points to p on the segments from a to b, (…, 3)."""
    d = b - a
    dd = np.maximum(np.sum(d * d, axis=-1), np.finfo(float).tiny)
    s = np.clip(np.sum((p - a) * d, axis=-1) / dd, 0, 1)
    return np.asarray(a + s[..., None] * d)


def _nearest_on_triangles(p: Array, a: Array, b: Array, c: Array) -> Array:
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
    is_flat = det <= FLAT_SINE_SQUARED * uu * vv
    det = np.where(is_flat, 1, det)
    r = (vv * wu - uv * wv) / det
    s = (uu * wv - uv * wu) / det
    foot = a + r[..., None] * u + s[..., None] * v
    is_inside = ~is_flat & (r >= 0) & (s >= 0) & (r + s <= 1)
    square_distance = np.where(is_inside, np.sum((foot - p) ** 2, axis=-1), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        on_edge = _nearest_on_segments(p, start, end)
        to_edge = np.sum((on_edge - p) ** 2, axis=-1)
        foot = np.where((to_edge < square_distance)[..., None], on_edge, foot)
        square_distance = np.minimum(square_distance, to_edge)
    return np.asarray(foot)
