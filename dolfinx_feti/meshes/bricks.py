# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The two-layer tube of bricks, whole or cut into tetrahedra, without a file.

Node (i, j, k) of a lattice is the i-th through the wall, the j-th around and the k-th along; all
nodes lie on circles. Layers, surfaces and lengths are those of :mod:`dolfinx_feti.meshes.tube`.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from dolfinx_feti.meshes.lattice import lattice_cells
from dolfinx_feti.meshes.layers import create_sheets
from dolfinx_feti.meshes.tags import SURFACE_TAGS, tags_of
from dolfinx_feti.meshes.tube import (
    ADVENTITIA,
    INNER_RADIUS,
    MEDIA,
    ZERO_ATOL,
    Counts,
    element_counts,
)
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.wall.wall import Wall
from dolfinx_feti.wall.wall_arrays import WallArrays, create_on_root, distribute

__all__ = ["create_brick_tube"]


def create_brick_tube(
    comm: MPI.Comm,
    *,
    length: float,
    size: float,
    quarter: bool = False,
    around: int | None = None,
    along: int | None = None,
    through: tuple[int, int] | None = None,
    growth: float = 1.0,
    order: int = 2,
    tetrahedra: bool = False,
) -> Wall:
    """Create the two-layer tube of hexahedra, or of tetrahedra, on all processes.

    Args:
        comm: Communicator of the mesh.
        length: Length [mm].
        size: Wanted length of the edges [mm].
        quarter: Only the part with x ≥ 0 and y ≥ 0.
        around: Elements around the circumference (of the quarter if ``quarter``); if not given, it
            follows from ``size``.
        along: Elements along the axis; if not given, it follows from ``size``.
        through: Elements through media and adventitia; if not given, they follow from ``size``.
        growth: Thickness of the media's outermost element over that of the one at the lumen, where
            stresses are steep.
        order: Order of the geometry: 1 for straight edges, 2 for curved ones.
        tetrahedra: Whether each hexahedron is cut into six tetrahedra.

    Returns:
        The wall, with the layers and surfaces of :mod:`dolfinx_feti.meshes.tube`.

    Raises:
        ValueError: A length or the growth is not positive, the order is not 1 or 2, or a number of
            elements is too small. On all processes.

    Note:
        Collective.
    """
    if not (length > 0 and size > 0 and growth > 0) or order not in (1, 2):
        raise ValueError(
            f"length={length}, size={size}, growth={growth}, order={order}: give lengths and a "
            "growth above zero, and order 1 or 2."
        )
    counts = element_counts(
        length, size, quarter=quarter, through=through, around=around, along=along
    )

    def create() -> WallArrays:
        return _create_arrays(
            length, counts, growth=growth, quarter=quarter, order=order, tetrahedra=tetrahedra
        )

    return distribute(create_on_root(create, comm), comm)


def _create_arrays(
    length: float, counts: Counts, *, growth: float, quarter: bool, order: int, tetrahedra: bool
) -> WallArrays:
    """Return points, cells and surfaces of the whole tube.

    Args:
        length: Length [mm].
        counts: Numbers of elements.
        growth: See :func:`create_brick_tube`.
        quarter: Only the part with x ≥ 0 and y ≥ 0.
        order: Order of the geometry.
        tetrahedra: Whether each hexahedron is cut into six tetrahedra.
    """
    sheets = create_sheets({"media": MEDIA, "adventitia": ADVENTITIA}, counts.through)
    heights = _grade(sheets.heights, counts.through[0], growth)
    points = _lattice_points(length, counts, heights, quarter=quarter, order=order)
    numbers = np.arange(points[..., 0].size).reshape(points.shape[:3])
    if not quarter:  # a whole tube ends where it begins
        numbers = np.concatenate([numbers, numbers[:, :1]], axis=1)
    cells = lattice_cells(numbers, order, simplices=tetrahedra)
    facets = {
        name: lattice_cells(side, order, simplices=tetrahedra)
        for name, side in _sides(numbers, quarter=quarter).items()
    }
    return WallArrays(
        points=points.reshape(-1, 3),
        cells=cells,
        cell_tags=np.repeat(sheets.tags, len(cells) // len(sheets.tags)),
        facets=np.concatenate(list(facets.values())),
        facet_tags=tags_of(facets, SURFACE_TAGS),
        layer_names=sheets.layer_names,
        surface_names={name: SURFACE_TAGS[name] for name in facets},
    )


def _grade(heights: Array, n_media: int, growth: float) -> Array:
    """Return the heights of sheets whose elements grow through the media, (n + 1,).

    Args:
        heights: Evenly spaced heights of the sheets from the lumen on, (n + 1,).
        n_media: Elements through the media.
        growth: Thickness of the media's last element over that of the first one.
    """
    graded = heights.copy()
    if growth != 1.0:
        end = heights[n_media]
        ξ = heights[: n_media + 1] / end
        graded[: n_media + 1] = end * (growth**ξ - 1.0) / (growth - 1.0)
    return graded


def _lattice_points(
    length: float, counts: Counts, heights: Array, *, quarter: bool, order: int
) -> Array:
    """Return the nodes of the lattice, (through, around, along, 3) [mm].

    Args:
        length: Length [mm].
        counts: Numbers of elements.
        heights: Heights of the sheets between elements, from 0 to 1.
        quarter: Only the part with x ≥ 0 and y ≥ 0.
        order: Order of the geometry: there are order − 1 nodes inside an edge.
    """
    n_sheets = order * (len(heights) - 1) + 1
    s = np.interp(np.arange(n_sheets) / order, np.arange(len(heights)), heights)
    radii = INNER_RADIUS + (MEDIA + ADVENTITIA) * s
    steps = order * counts.around
    whole_angle = np.pi / 2 if quarter else 2 * np.pi
    angles = np.arange(steps + 1 if quarter else steps) * whole_angle / steps
    positions = np.linspace(0.0, length, order * counts.along + 1)
    r, θ, z = np.meshgrid(radii, angles, positions, indexing="ij")
    x = np.stack([r * np.cos(θ), r * np.sin(θ), z], axis=-1)
    x[np.abs(x) < ZERO_ATOL] = 0.0
    return np.asarray(x)


def _sides(numbers: Numbers, *, quarter: bool) -> dict[str, Numbers]:
    """Return the sides of the lattice by name, each with two axes.

    Args:
        numbers: Number of each node, (through, around, along).
        quarter: Whether the lattice is that of a quarter.
    """
    sides = {
        "lumen": numbers[0],
        "outer": numbers[-1],
        "opening_1": numbers[:, :, 0],
        "opening_2": numbers[:, :, -1],
    }
    if quarter:
        sides["symmetry_y"] = numbers[:, 0]
        sides["symmetry_x"] = numbers[:, -1]
    return sides
