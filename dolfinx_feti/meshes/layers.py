# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A wall grown on the lumen: columns of prisms, each cut into three tetrahedra.

Each vertex x of the lumen has a top y on the outer wall. Sheets of points at fixed heights s divide
the way between them: x + s (y − x). A prism over the triangle a < b < c (by their numbers), with A,
B, C above a, b, c, is cut into abcC, abBC and aABC. The diagonals of its sides start at the lower
number, so neighbouring prisms cut their common side alike.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx_feti.meshes.tags import SURFACE_TAGS, layer_tags
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.wall.names import names_in_use
from dolfinx_feti.wall.wall_arrays import WallArrays

__all__ = ["Rim", "Sheets", "create_sheets", "grow_wall", "sort_corners"]

#: Corners of the three tetrahedra of a prism: 0 to 2 are below, in the order of their numbers, and
#: 3 to 5 above.
PRISM_TETRAHEDRA = np.array([[0, 1, 2, 5], [0, 1, 4, 5], [0, 3, 4, 5]])

#: Orientation of each of these tetrahedra, +1 or −1, if the normal of the triangle 0, 1, 2 points
#: to the triangle above.
PRISM_ORIENTATIONS = np.array([1, -1, 1])


@dataclass(frozen=True, slots=True)
class Sheets:
    """Sheets of points that divide a wall into elements, from the lumen to the outer wall.

    Attributes:
        heights: Height of each sheet over the lumen, from 0 to 1 [thickness], (n + 1,).
        tags: Tag of the layer between each sheet and the next one, (n,).
        layer_names: Tags of the layers by name.
    """

    heights: Array
    tags: Numbers
    layer_names: dict[str, int]


@dataclass(frozen=True, slots=True)
class Rim:
    """The edges of the lumen on its rims.

    Attributes:
        edges: Ends of each edge, (k, 2).
        tags: Tag of the surface over each edge, (k,).
    """

    edges: Numbers
    tags: Numbers


def create_sheets(shares: Mapping[str, float], counts: Sequence[int]) -> Sheets:
    """Return sheets that divide each layer evenly.

    Args:
        shares: Each layer's share of the thickness, from the inside out; their sum need not be 1.
        counts: Elements through each layer.
    """
    names = layer_tags(shares)
    thicknesses = list(shares.values())
    ends = np.concatenate([[0.0], np.cumsum(thicknesses) / np.sum(thicknesses)])
    heights: list[Array] = [np.zeros(1)]
    for (low, high), count in zip(itertools.pairwise(ends), counts, strict=True):
        heights.append(np.linspace(low, high, count + 1)[1:])
    return Sheets(np.concatenate(heights), np.repeat(list(names.values()), counts), names)


def grow_wall(x: Array, y: Array, t: Numbers, *, sheets: Sheets, rim: Rim) -> WallArrays:
    """Return the wall between lumen and outer wall, with all of its boundary tagged.

    Args:
        x: Points of the lumen, (n, 3) [mm].
        y: Their tops on the outer wall, (n, 3) [mm].
        t: Triangles of the lumen, facing the tops, (m, 3).
        sheets: Sheets through the wall.
        rim: All edges of the lumen with one triangle.
    """
    n = len(x)
    through = len(sheets.tags)
    first_points = n * np.arange(through)  # of the sheet below each row of elements

    # three tetrahedra of each prism; two nodes of an inverted one are exchanged
    corners, parities = sort_corners(t)
    prisms = np.concatenate([np.hstack([corners + p, corners + p + n]) for p in first_points])
    cells = prisms[:, PRISM_TETRAHEDRA]
    is_inverted = np.tile(parities, through)[:, None] * PRISM_ORIENTATIONS < 0
    cells[is_inverted] = cells[is_inverted][:, [0, 1, 3, 2]]

    # two triangles of the quadrilateral over each edge of the rim, cut from its lower number
    edges = np.sort(rim.edges, axis=1)
    quadrilaterals = np.concatenate([np.hstack([edges + p, edges + p + n]) for p in first_points])
    cut_faces = quadrilaterals[:, [[0, 1, 3], [0, 2, 3]]].reshape(-1, 3)

    facets = np.concatenate([t, t + n * through, cut_faces])
    facet_tags = np.concatenate(
        [
            np.full(len(t), SURFACE_TAGS["lumen"]),
            np.full(len(t), SURFACE_TAGS["outer"]),
            np.repeat(np.tile(rim.tags, through), 2),
        ]
    )
    return WallArrays(
        points=np.concatenate([x + s * (y - x) for s in sheets.heights]),
        cells=cells.reshape(-1, 4),
        cell_tags=np.repeat(sheets.tags, 3 * len(t)),
        facets=facets,
        facet_tags=facet_tags,
        layer_names=sheets.layer_names,
        surface_names=names_in_use(SURFACE_TAGS, facet_tags),
    )


def sort_corners(t: Numbers) -> tuple[Numbers, Array]:
    """Return triangles with sorted corners, and the parities ±1 of the permutations.

    Args:
        t: Triangles, (m, 3).

    Returns:
        The triangles, (m, 3), and the parities, (m,).
    """
    order = np.argsort(t, axis=1)
    return np.take_along_axis(t, order, axis=1), np.linalg.det(np.eye(3)[order]).round()
