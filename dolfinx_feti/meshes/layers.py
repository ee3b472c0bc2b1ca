# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall grown on the lumen: columns of prisms, each cut into three tetrahedra.

Each vertex x of the lumen has a top y on the outer wall; the sheets between them lie at fixed
fractions s of the way, x + s (y − x). A prism over the triangle a < b < c (by their numbers, with
A, B, C above them) is cut into abcC, abBC and aABC: the diagonals of its sides start at the lower
number, so that neighbours agree.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx_feti.meshes.surface import Guide, Indices, Points, find_edges, unit
from dolfinx_feti.meshes.wall_mesh import TAGS, WallMesh, tetrahedron_quality

__all__ = ["grow", "improve_tops", "sheets"]

#: Corners of the three tetrahedra of a prism: 0 to 2 below, 3 to 5 above.
PRISM = np.array([[0, 1, 2, 5], [0, 1, 4, 5], [0, 3, 4, 5]])

#: Orientation of each of them if the prism's triangle below faces the one above.
SIGN = np.array([1, -1, 1])

#: The 26 directions to the neighbours in a cubic lattice.
DIRECTIONS = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)

#: Bounds of the distance of a moved top from the lumen, over the thickness: the wall stays about as
#: thick as it is elsewhere. Choices that were not measured.
MIN_DISTANCE = 0.95
MAX_DISTANCE = 1.2

#: First step of a top, over the thickness, and the factor by which steps become shorter. Choices
#: that were not measured.
FIRST_STEP = 0.2
STEP_FACTOR = 0.6


def sheets(
    shares: Sequence[float], through: Sequence[int], tags: Sequence[int]
) -> tuple[Points, Indices]:
    """Return the heights of the sheets and the layers between them.

    Args:
        shares: Each layer's share of the thickness, from the inside out.
        through: Elements through each layer.
        tags: Tag of each layer.

    Returns:
        Heights s from 0 to 1, (l + 1,), and the tag of the layer below each but the first, (l,).
    """
    ends = np.concatenate([[0.0], np.cumsum(shares) / np.sum(shares)])
    heights = [
        np.linspace(low, high, n + 1)[1:]
        for (low, high), n in zip(itertools.pairwise(ends), through, strict=True)
    ]
    return np.concatenate([[0.0], *heights]), np.repeat(tags, through)


def grow(
    x: Points,
    y: Points,
    t: Indices,
    *,
    through: tuple[Points, Indices],
    rim: tuple[Indices, Indices],
) -> WallMesh:
    """Return the wall between lumen and outer wall, with all of its boundary tagged.

    Args:
        x: Points of the lumen, (n, 3) [mm].
        y: Their tops on the outer wall, (n, 3) [mm].
        t: Triangles of the lumen, facing the tops, (m, 3).
        through: Heights and layers from :func:`sheets`.
        rim: All edges of the rim (k, 2), and the tag of the cut face above each, (k,).
    """
    heights, layers = through
    n = len(x)
    edges = np.sort(rim[0], axis=1)
    tags = rim[1]
    s, parity = _sorted(t)
    base = n * np.arange(len(layers))  # number of the first point below each layer

    # three tetrahedra of each prism; two nodes of an inverted one are exchanged
    prisms = np.concatenate([np.hstack([s + b, s + b + n]) for b in base])
    cells = prisms[:, PRISM]
    inverted = np.tile(parity, len(layers))[:, None] * SIGN < 0
    cells[inverted] = cells[inverted][:, [0, 1, 3, 2]]

    # the quadrilateral over each edge of the rim, cut from its lower number
    sides = np.concatenate([np.hstack([edges + b, edges + b + n]) for b in base])
    sides = sides[:, [[0, 1, 3], [0, 2, 3]]].reshape(-1, 3)
    boundary = [
        (t, np.full(len(t), TAGS["lumen"])),
        (t + n * len(layers), np.full(len(t), TAGS["outer"])),
        (sides, np.repeat(np.tile(tags, len(layers)), 2)),
    ]
    return WallMesh(
        points=np.concatenate([x + h * (y - x) for h in heights]),
        cells=cells.reshape(-1, 4),
        layers=np.repeat(layers, 3 * len(t)),
        facets=np.concatenate([f for f, _ in boundary]),
        surfaces=np.concatenate([g for _, g in boundary]),
    )


def improve_tops(
    x: Points, y: Points, t: Indices, *, heights: Points, share: float = 0.6, rounds: int = 60
) -> Points:
    """Move the tops of bad columns until their worst tetrahedron is good enough.

    In a crotch the normals converge, and the tetrahedra between them are flat or inside out. For
    each top there, steps in 26 directions are evaluated, at nearly the same distance from the
    lumen. The step with the best worst quality is used; if none improves it, steps become shorter.
    In a round a top moves only if it gains most among its neighbours, whose qualities it changes.
    Tops on the rims do not move.

    Args:
        x: Points of the lumen, (n, 3) [mm].
        y: Their tops, (n, 3) [mm].
        t: Triangles of the lumen, (m, 3).
        heights: Heights of the sheets from :func:`sheets`.
        share: Wanted quality of a column, as a share of the median of all columns: a choice.
        rounds: Upper bound of the rounds; a step that never succeeds is then 1e-14 thicknesses.

    Returns:
        The new tops.
    """
    columns = Columns.of(x, t, heights)
    rim = find_edges(t).on_rim(len(x))
    guide = Guide(x, t)
    thickness = float(np.median(np.linalg.norm(y - x, axis=1)))
    step = np.full(len(x), FIRST_STEP * thickness)
    wanted = share * float(np.median(columns.quality(y)))
    for _ in range(rounds):
        worst = columns.worst_around(columns.quality(y))
        active = np.flatnonzero((worst < wanted) & ~rim)
        if not len(active):
            break
        best = worst[active]
        place = y[active]
        for direction in DIRECTIONS:
            trial = y[active] + step[active, None] * direction
            trial = _keep_away(trial, guide, MIN_DISTANCE * thickness, MAX_DISTANCE * thickness)
            reached = columns.quality_if_moved(y, active, trial)
            place[reached > best] = trial[reached > best]
            best = np.maximum(best, reached)
        gain = np.zeros(len(x))
        gain[active] = best - worst[active]
        gains_most = (gain[active] > 0) & (gain[active] == columns.most_around(gain)[active])
        y = y.copy()
        y[active[gains_most]] = place[gains_most]
        step[active[gain[active] <= 0]] *= STEP_FACTOR
    return y


def _keep_away(p: Points, guide: Guide, low: float, high: float) -> Points:
    """Return points moved so that their distance from a surface is between two bounds."""
    foot = guide.project(p)
    distance = np.linalg.norm(p - foot, axis=1, keepdims=True)
    return np.asarray(foot + unit(p - foot) * np.clip(distance, low, high))


def _sorted(t: Indices) -> tuple[Indices, Points]:
    """Return triangles with sorted corners, (m, 3), and the signs of the permutations, (m,)."""
    order = np.argsort(t, axis=1)
    return np.take_along_axis(t, order, axis=1), np.linalg.det(np.eye(3)[order]).round()


@dataclass(frozen=True, slots=True)
class Columns:
    """The columns over the triangles of the lumen, while the tops move.

    Attributes:
        x: Points of the lumen, (n, 3).
        s: Its triangles, their corners sorted, (m, 3).
        sign: The signs of these permutations, (m,).
        heights: Heights of the sheets.
    """

    x: Points
    s: Indices
    sign: Points
    heights: Points

    @classmethod
    def of(cls, x: Points, t: Indices, heights: Points) -> Columns:
        """Create the columns over a surface.

        Args:
            x: Points of the lumen, (n, 3).
            t: Its triangles, (m, 3).
            heights: Heights of the sheets.
        """
        s, sign = _sorted(t)
        return cls(x=x, s=s, sign=sign, heights=heights)

    def quality(self, y: Points) -> Points:
        """Return the worst quality in each column under tops y (n, 3), (m,)."""
        return self._quality(np.arange(len(self.s)), y[self.s])

    def quality_if_moved(self, y: Points, moved: Indices, place: Points) -> Points:
        """Return the worst quality around each of k tops if only that one moves, (k,).

        Args:
            y: The tops, (n, 3).
            moved: Numbers of the k tops, (k,).
            place: Their new positions, (k, 3).
        """
        number = np.full(len(y), -1)
        number[moved] = np.arange(len(moved))
        which, corner = np.nonzero(number[self.s] >= 0)
        owner = number[self.s[which, corner]]
        top = y[self.s[which]]
        top[np.arange(len(which)), corner] = place[owner]
        worst = np.full(len(moved), np.inf)
        np.minimum.at(worst, owner, self._quality(which, top))
        return worst

    def worst_around(self, quality: Points) -> Points:
        """Return at each vertex the worst quality of its columns, (n,)."""
        worst = np.full(len(self.x), np.inf)
        np.minimum.at(worst, self.s, quality[:, None])
        return worst

    def most_around(self, value: Points) -> Points:
        """Return the largest of the values at each vertex and at its neighbours, (n,)."""
        largest = value.copy()
        np.maximum.at(largest, self.s, value[self.s].max(axis=1, keepdims=True))
        return largest

    def _quality(self, which: Indices, top: Points) -> Points:
        """Return the worst quality in columns with tops at their three corners, (k, 3, 3)."""
        bottom = self.x[self.s[which]]
        worst = np.full(len(which), np.inf)
        for low, high in itertools.pairwise(self.heights):
            prism = np.hstack([bottom + h * (top - bottom) for h in (low, high)])
            for corners, sign in zip(PRISM, SIGN, strict=True):
                edges = np.moveaxis(prism[:, corners[1:]] - prism[:, corners[:1]], 1, 2)
                worst = np.minimum(worst, sign * self.sign[which] * tetrahedron_quality(edges))
        return worst
