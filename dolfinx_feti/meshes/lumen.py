# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Random lumens with open ends, on which walls are grown: bent tubes and bifurcations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

__all__ = ["write_lumen"]

#: Quadrilaterals along a branch; ``create_vessel`` remeshes the surface, so only its shape counts.
ALONG = 16

#: Quadrilaterals in half of a branch's circumference.
ACROSS = 10


def write_lumen(path: Path, random: np.random.Generator, *, branches: int, sac: bool) -> None:
    """Write an STL file of triangles [mm] that face outwards.

    A branch begins at two half circles, in the vertical planes that halve the angles to its
    neighbours, so that branches fit together. It ends at a circle normal to its axis. The ranges of
    angles, radii, lengths and the sac were chosen, not measured.

    Args:
        path: The file.
        random: Draws angles and radii.
        branches: 2 for a bent tube, 3 for a bifurcation.
        sac: Whether there is a sac.
    """
    turn = 2 * np.pi / branches
    angles = turn * (np.arange(branches) + random.uniform(-0.15, 0.15, branches))
    radii = random.uniform(1.6, 2.4, branches)
    lengths = random.uniform(5.0, 7.0, branches)
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    φ = np.pi * np.arange(2 * ACROSS + 1)[:, None] / ACROSS  # down on the left, up on the right
    s = np.linspace(0.0, 1.0, ALONG + 1)[:, None, None]
    smooth = s**2 * (3 - 2 * s)  # from 0 to 1, with slope 0 at both ends
    up = np.array([0.0, 0.0, 1.0])
    grids = []
    for k, angle in enumerate(angles):
        left = _direction(angle + gaps[k] / 2)
        right = _direction(angle - gaps[k - 1] / 2)
        side = np.where(φ <= np.pi, left, right)
        arcs = radii.mean() * (np.abs(np.sin(φ)) * side + np.cos(φ) * up)
        circle = radii[k] * (np.sin(φ) * _direction(angle + np.pi / 2) + np.cos(φ) * up)
        axis = lengths[k] * s * _direction(angle)
        grids.append(axis + (1 - smooth) * arcs + smooth * circle)
    if sac:  # a bump around a random point halfway along the first branch
        top = grids[0][ALONG // 2, random.integers(2 * ACROSS)].copy()
        outwards = top - lengths[0] / 2 * _direction(angles[0])
        height = random.uniform(0.5, 0.8)
        for grid in grids:
            square_distance = np.sum((grid - top) ** 2, axis=-1, keepdims=True)
            grid += height * np.exp(-square_distance / radii[0] ** 2) * outwards
    _write_stl(path, [np.round(grid, 5) for grid in grids])  # shared points become equal


def _write_stl(path: Path, grids: list[npt.NDArray[np.float64]]) -> None:
    """Write the quadrilaterals of grids, closed around, as triangles in a binary STL file.

    Args:
        path: The file.
        grids: Points of each branch, (along, around, 3); the last column becomes the first one.
    """
    triangles = []
    for grid in grids:
        grid[:, -1] = grid[:, 0]
        a = grid[:-1, :-1]
        b = grid[1:, :-1]
        c = grid[1:, 1:]
        d = grid[:-1, 1:]
        triangles += [np.stack(t, axis=-2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))]
    x = np.concatenate(triangles)
    facets = np.zeros(len(x), [("normal", "<f4", 3), ("x", "<f4", (3, 3)), ("n", "<u2")])
    facets["x"] = x  # normals stay zero, which readers compute from the corners
    path.write_bytes(bytes(80) + np.uint32(len(x)).tobytes() + facets.tobytes())


def _direction(angle: float) -> npt.NDArray[np.float64]:
    """Return the unit vector at an angle in the plane z = 0, (3,)."""
    return np.array([np.cos(angle), np.sin(angle), 0.0])
