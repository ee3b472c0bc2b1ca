# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Random lumens with open ends, on which walls are grown: bent tubes and bifurcations."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dolfinx_feti.runtime.arrays import Array

__all__ = ["write_random_lumen"]

#: Quadrilaterals along a branch; ``write_vessel`` remeshes the surface, so only its shape counts.
ALONG = 16

#: Quadrilaterals around half of a branch.
HALF_AROUND = 10

#: Digits after the point of coordinates [mm]: points that branches share become equal.
STL_DIGITS = 5

#: Upwards, normal to the plane of the branches.
UP = np.array([0.0, 0.0, 1.0])


def write_random_lumen(
    path: Path, random: np.random.Generator, *, branches: int, has_sac: bool
) -> None:
    """Write an STL file of triangles [mm] that face outwards. Serial.

    The branches lie around the z axis and start in its neighbourhood. A branch begins at two half
    circles, in the vertical planes that halve the angles to its neighbours, so that branches fit
    together. It ends at a circle normal to its axis. The ranges of angles, radii, lengths and the
    sac were chosen, not measured.

    Args:
        path: The file.
        random: Generator of the angles, radii and lengths.
        branches: 2 for a bent tube, 3 for a bifurcation.
        has_sac: Whether there is a sac, halfway along the first branch.
    """
    turn = 2 * np.pi / branches
    angles = turn * (np.arange(branches) + random.uniform(-0.15, 0.15, branches))
    radii = random.uniform(1.6, 2.4, branches)
    lengths = random.uniform(5.0, 7.0, branches)
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)  # to the next branch
    grids = []
    for k, angle in enumerate(angles):
        grid = _branch(
            angle,
            left=angle + gaps[k] / 2,
            right=angle - gaps[k - 1] / 2,
            radii=(radii.mean(), radii[k]),
            length=lengths[k],
        )
        grids.append(grid)
    if has_sac:
        top = grids[0][ALONG // 2, random.integers(2 * HALF_AROUND)].copy()
        outwards = top - lengths[0] / 2 * _direction(angles[0])
        height = random.uniform(0.5, 0.8)
        for grid in grids:
            square_distance = np.sum((grid - top) ** 2, axis=-1, keepdims=True)
            grid += height * np.exp(-square_distance / radii[0] ** 2) * outwards
    _write_stl(path, [np.round(grid, STL_DIGITS) for grid in grids])


def _branch(
    angle: float, *, left: float, right: float, radii: tuple[float, float], length: float
) -> Array:
    """Return the points of a branch, (along, around, 3) [mm]; the last around it is the first one.

    Args:
        angle: Angle of the axis [rad].
        left: Angle of the vertical half plane where it begins, on the left [rad].
        right: Angle of that on the right [rad].
        radii: Radius at the beginning and at the end [mm].
        length: Length of the axis [mm].
    """
    φ = np.pi * np.arange(2 * HALF_AROUND + 1)[:, None] / HALF_AROUND  # down left, up right
    s = np.linspace(0.0, 1.0, ALONG + 1)[:, None, None]
    smooth = s**2 * (3 - 2 * s)  # from 0 to 1, with slope 0 at both ends
    side = np.where(φ <= np.pi, _direction(left), _direction(right))
    first = radii[0] * (np.abs(np.sin(φ)) * side + np.cos(φ) * UP)  # two half circles
    last = radii[1] * (np.sin(φ) * _direction(angle + np.pi / 2) + np.cos(φ) * UP)
    axis = length * s * _direction(angle)
    return np.asarray(axis + (1 - smooth) * first + smooth * last)


def _write_stl(path: Path, grids: list[Array]) -> None:
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
        triangles.append(np.stack((a, b, c), axis=-2).reshape(-1, 3, 3))
        triangles.append(np.stack((a, c, d), axis=-2).reshape(-1, 3, 3))
    corners = np.concatenate(triangles)
    record = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")]
    facets = np.zeros(len(corners), record)
    facets["corners"] = corners  # normals stay zero, which readers compute from the corners
    comment = bytes(80)
    path.write_bytes(comment + np.uint32(len(facets)).tobytes() + facets.tobytes())


def _direction(angle: float) -> Array:
    """Return the unit vector at an angle in the plane z = 0, (3,)."""
    return np.array([np.cos(angle), np.sin(angle), 0.0])
