# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Columns of tetrahedra that degenerate in the crotches of a lumen, and how they are improved.

In a crotch the normals converge, and the tetrahedra between them are flat or inverted. There the
tops of the columns, their points on the outer wall, are moved.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from dolfinx_feti.meshes.layers import PRISM_ORIENTATIONS, PRISM_TETRAHEDRA, sort_corners
from dolfinx_feti.meshes.quality import tetrahedron_quality
from dolfinx_feti.meshes.surface import SurfaceProjection, find_edges, unit
from dolfinx_feti.runtime.arrays import Array, Numbers

__all__ = ["improve_tops"]

#: The 26 directions to the neighbours in a cubic lattice, unit vectors, (26, 3).
DIRECTIONS = unit(np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0)

#: Lower bound of the distance of a moved top from the lumen, over the thickness: the wall stays
#: about as thick as it is elsewhere. A choice that was not measured.
MIN_DISTANCE = 0.95

#: Upper bound of the same distance, over the thickness. A choice that was not measured.
MAX_DISTANCE = 1.2

#: First step of a top, over the thickness. A choice that was not measured.
FIRST_STEP = 0.2

#: Factor by which steps become shorter if none of them improves the quality. A choice that was not
#: measured.
STEP_FACTOR = 0.6

#: Wanted quality of a column, over the median of all columns. A choice that was not measured.
WANTED_QUALITY = 0.6

#: Upper bound of the rounds. A step that never succeeds is 1e-14 thicknesses in the last one.
MAX_ROUNDS = 60


def improve_tops(x: Array, y: Array, t: Numbers, *, heights: Array) -> Array:
    """Return tops that are moved until the worst tetrahedra of their columns are good enough.

    For each top of a bad column, steps in 26 directions are tried, at nearly the same distance from
    the lumen. The worst quality of the columns at the top is compared. The best step is chosen; if
    no step improves this quality, the steps of this top become shorter. Neighbouring tops share
    columns, so in a round a top moves only if no neighbour improves more. Tops on the rims do not
    move.

    Args:
        x: Points of the lumen, (n, 3) [mm].
        y: Their tops, (n, 3) [mm].
        t: Triangles of the lumen, (m, 3).
        heights: Heights of the sheets, see :class:`~dolfinx_feti.meshes.layers.Sheets`.
    """
    columns = Columns.over(x, t, heights)
    is_on_rim = find_edges(t).on_rim(len(x))
    lumen = SurfaceProjection(x, t)
    thickness = float(np.median(np.linalg.norm(y - x, axis=1)))
    step = np.full(len(x), FIRST_STEP * thickness)
    wanted = WANTED_QUALITY * float(np.median(columns.quality(y)))
    for _ in range(MAX_ROUNDS):
        worst = columns.worst_at_vertices(columns.quality(y))
        bad = np.flatnonzero((worst < wanted) & ~is_on_rim)
        if not len(bad):
            break
        best_quality = worst[bad]
        best_place = y[bad]
        for direction in DIRECTIONS:
            moved = y[bad] + step[bad, None] * direction
            trial = _limit_distance(
                moved, lumen, MIN_DISTANCE * thickness, MAX_DISTANCE * thickness
            )
            quality = columns.quality_if_moved(y, bad, trial)
            best_place[quality > best_quality] = trial[quality > best_quality]
            best_quality = np.maximum(best_quality, quality)
        gain = np.zeros(len(x))
        gain[bad] = best_quality - worst[bad]
        gains_most = (gain[bad] > 0) & (gain[bad] == columns.largest_around(gain)[bad])
        y = y.copy()
        y[bad[gains_most]] = best_place[gains_most]
        step[bad[gain[bad] <= 0]] *= STEP_FACTOR
    return y


def _limit_distance(p: Array, surface: SurfaceProjection, low: float, high: float) -> Array:
    """Return points moved so that their distance from a surface is between two bounds, (n, 3).

    Args:
        p: Points, (n, 3). They move along the line through their nearest point on the surface.
        surface: The surface.
        low: Smallest distance.
        high: Largest distance.
    """
    foot = surface.project(p)
    distance = np.linalg.norm(p - foot, axis=1, keepdims=True)
    return np.asarray(foot + unit(p - foot) * np.clip(distance, low, high))


@dataclass(frozen=True, slots=True)
class Columns:
    """The columns over the triangles of a lumen, for any tops.

    Attributes:
        x: Points of the lumen, (n, 3).
        corners: Its triangles with sorted corners, (m, 3).
        parities: Parities ±1 of these permutations, (m,).
        heights: Heights of the sheets.
    """

    x: Array
    corners: Numbers
    parities: Array
    heights: Array

    @classmethod
    def over(cls, x: Array, t: Numbers, heights: Array) -> Columns:
        """Create the columns over a surface.

        Args:
            x: Points of the lumen, (n, 3).
            t: Its triangles, (m, 3).
            heights: Heights of the sheets.
        """
        corners, parities = sort_corners(t)
        return cls(x, corners, parities, heights)

    def quality(self, y: Array) -> Array:
        """Return the worst quality in each column, (m,), under tops y, (n, 3)."""
        return self._worst_quality(np.arange(len(self.corners)), y[self.corners])

    def quality_if_moved(self, y: Array, moved: Numbers, places: Array) -> Array:
        """Return the worst quality around each of k tops if only this one moves, (k,).

        Args:
            y: The tops, (n, 3).
            moved: Numbers of the k tops, (k,).
            places: Their new positions, (k, 3).
        """
        index = np.full(len(y), -1)  # of each top in `moved`
        index[moved] = np.arange(len(moved))
        column, corner = np.nonzero(index[self.corners] >= 0)
        moved_top = index[self.corners[column, corner]]
        tops = y[self.corners[column]]
        tops[np.arange(len(column)), corner] = places[moved_top]
        worst = np.full(len(moved), np.inf)
        np.minimum.at(worst, moved_top, self._worst_quality(column, tops))
        return worst

    def worst_at_vertices(self, quality: Array) -> Array:
        """Return the worst quality of the columns at each vertex, (n,)."""
        worst = np.full(len(self.x), np.inf)
        np.minimum.at(worst, self.corners, quality[:, None])
        return worst

    def largest_around(self, values: Array) -> Array:
        """Return the largest of the values at each vertex and at its neighbours, (n,)."""
        largest = values.copy()
        np.maximum.at(largest, self.corners, values[self.corners].max(axis=1, keepdims=True))
        return largest

    def _worst_quality(self, column: Numbers, tops: Array) -> Array:
        """Return the worst quality in some columns, (k,).

        Args:
            column: Numbers of the columns, (k,).
            tops: Tops of each column, (k, 3, 3).
        """
        bottom = self.x[self.corners[column]]
        worst = np.full(len(column), np.inf)
        for low, high in itertools.pairwise(self.heights):
            prism = np.hstack([bottom + s * (tops - bottom) for s in (low, high)])
            for corners, orientation in zip(PRISM_TETRAHEDRA, PRISM_ORIENTATIONS, strict=True):
                edges = np.moveaxis(prism[:, corners[1:]] - prism[:, corners[:1]], 1, 2)
                sign = orientation * self.parities[column]
                worst = np.minimum(worst, sign * tetrahedron_quality(edges))
        return worst
