# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Lines along a vector field on a surface, which show fibres.

Each line starts in its middle, at a point of the surface, and is followed to both sides in steps.
All lengths are shares of the extent of the surface.
"""

from __future__ import annotations

import numpy as np
import scipy.spatial

from dolfinx_feti.output.surfaces import BodySurface
from dolfinx_feti.runtime.arrays import Array

__all__ = ["fibre_lines"]

#: Length of a line, over the extent of the body: long enough to show curvature, and too short to
#: cover the next ones.
LENGTH = 0.1

#: Edge of the cubes of a grid with one line each, over the extent of the body. Lines are about half
#: their length apart.
DISTANCE = 0.055

#: Points of a line; an odd number, as one of them is in the middle.
N_POINTS = 17

#: A line has left the surface if its distance from the nearest point of the surface exceeds this
#: share of the median edge of a triangle. In the middle of an equilateral triangle it is 0.58.
RIM = 0.8


def fibre_lines(surface: BodySurface) -> Array:
    """Return lines along the unit vectors of a surface, (n, N_POINTS, 3).

    One line starts in each cube of a grid. Its steps follow the vector of the nearest point, in the
    tangential plane of the surface there. Lines that leave the surface at a rim are left out.

    Args:
        surface: A surface whose values are the vectors, (points, 3).
    """
    extent = float(np.ptp(surface.points, axis=0).max())
    start = _one_in_each_cube(surface.points, DISTANCE * extent)
    step = LENGTH * extent / (N_POINTS - 1)
    normals = _point_normals(surface)
    tree = scipy.spatial.cKDTree(surface.points)
    corners = surface.points[surface.triangles]
    edge = float(np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)))
    is_on_surface = np.ones(len(start), dtype=bool)
    halves = []
    for sign in (-1.0, 1.0):
        x = start
        half = [x]
        for _ in range(N_POINTS // 2):
            _, nearest = tree.query(x)
            n = normals[nearest]
            x = x + sign * step * surface.values[nearest]
            height = np.einsum("ij,ij->i", x - surface.points[nearest], n)
            x = x - height[:, None] * n
            distance, _ = tree.query(x)
            is_on_surface &= distance < RIM * edge
            half.append(x)
        halves.append(half)
    backward, forward = halves
    lines = np.stack([*backward[:0:-1], *forward], axis=1)
    return np.asarray(lines[is_on_surface])


def _one_in_each_cube(points: Array, edge: float) -> Array:
    """Return one of the points in each cube of a grid, chosen at random, (cubes, 3)."""
    cubes = np.floor(points / edge).astype(np.int64)
    shuffled = np.random.default_rng(0).permutation(len(points))
    _, first = np.unique(cubes[shuffled], axis=0, return_index=True)
    return points[shuffled[first]]


def _point_normals(surface: BodySurface) -> Array:
    """Return the unit normal of the surface at each point, (points, 3)."""
    x = surface.points[surface.triangles]
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    sums = np.zeros_like(surface.points)
    for corner in surface.triangles.T:
        np.add.at(sums, corner, normal)
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    return sums / np.maximum(length, np.finfo(float).tiny)
