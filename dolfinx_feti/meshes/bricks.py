# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The two-layer tube of bricks, with straight edges or with curved ones, on all processes.

Node (i, j, k) of a lattice is the i-th through the wall, the j-th around and the k-th along. A
brick has (order + 1)³ nodes, which lie on circles. It is a hexahedron, or is cut into six
tetrahedra along the paths of edges from its first corner to the last. Layers, surfaces and lengths
are those of :mod:`dolfinx_feti.meshes.tube`.
"""

from __future__ import annotations

import itertools

from mpi4py import MPI

import numpy as np

import basix

from dolfinx_feti.meshes.layers import sheets
from dolfinx_feti.meshes.surface import Indices, Points
from dolfinx_feti.meshes.tube import ADVENTITIA, INNER_RADIUS, MEDIA, count_around
from dolfinx_feti.meshes.wall_mesh import TAGS
from dolfinx_feti.runtime.collective import on_root_only
from dolfinx_feti.wall.wall import Wall
from dolfinx_feti.wall.wall_arrays import WallArrays, distribute

__all__ = ["create_brick_tube", "lattice_cells"]


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
    """Mesh the tube with hexahedra, or with tetrahedra.

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

    Raises:
        ValueError: A length or the growth is not positive, or the order is not 1 or 2. On all
            processes.

    Note:
        Collective.
    """
    if not (length > 0 and size > 0 and growth > 0) or order not in (1, 2):
        raise ValueError(
            f"length={length}, size={size}, growth={growth}, order={order}: give lengths and a "
            "growth above zero, and order 1 or 2."
        )
    if through is None:
        through = max(1, round(MEDIA / size)), max(1, round(ADVENTITIA / size))
    if around is None:
        around = count_around(size, quarter=quarter)
    if along is None:
        along = max(1, round(length / size))
    arrays = on_root_only(
        lambda: _create(
            length,
            through,
            around,
            along,
            growth=growth,
            quarter=quarter,
            order=order,
            simplex=tetrahedra,
        ),
        comm,
    )
    return distribute(arrays, comm)


def _create(
    length: float,
    through: tuple[int, int],
    around: int,
    along: int,
    *,
    growth: float,
    quarter: bool,
    order: int,
    simplex: bool,
) -> WallArrays:
    """Return points, cells and surfaces of the whole tube.

    The arguments are those of :func:`create_brick_tube`; ``simplex`` is its ``tetrahedra``.
    """
    heights, layers = sheets((MEDIA, ADVENTITIA), through, (TAGS["media"], TAGS["adventitia"]))
    if growth != 1.0:
        media = heights[: through[0] + 1]  # a view: heights changes with it
        ξ = media / media[-1]
        media[:] = media[-1] * (growth**ξ - 1.0) / (growth - 1.0)

    # points: s through the wall, with order − 1 nodes inside each element
    columns = order * around + (1 if quarter else 0)
    s = np.interp(np.arange(order * len(layers) + 1) / order, np.arange(len(heights)), heights)
    angle = np.arange(columns) * (np.pi / 2 if quarter else 2 * np.pi) / (order * around)
    height = np.linspace(0.0, length, order * along + 1)
    r, θ, z = np.meshgrid(INNER_RADIUS + (MEDIA + ADVENTITIA) * s, angle, height, indexing="ij")
    x = np.stack([r * np.cos(θ), r * np.sin(θ), z], axis=-1)
    x[np.abs(x) < 1e-15] = 0.0  # without rounding, so that points lie in the symmetry planes

    # numbers of the lattice's nodes; a whole tube ends where it begins
    number = np.arange(r.size).reshape(r.shape)
    if not quarter:
        number = np.concatenate([number, number[:, :1]], axis=1)
    faces = {
        "lumen": number[:1],
        "outer": number[-1:],
        "opening_1": number[..., :1],
        "opening_2": number[..., -1:],
    }
    if quarter:
        faces |= {"symmetry_y": number[:, :1], "symmetry_x": number[:, -1:]}
    facets = {
        name: lattice_cells(np.squeeze(f), order, simplex=simplex) for name, f in faces.items()
    }
    cells = lattice_cells(number, order, simplex=simplex)
    return WallArrays(
        points=x.reshape(-1, 3),
        cells=cells,
        layers=np.repeat(layers, len(cells) // len(layers)),
        facets=np.concatenate(list(facets.values())),
        surfaces=np.concatenate([np.full(len(f), TAGS[name]) for name, f in facets.items()]),
        layer_names={name: TAGS[name] for name in ("media", "adventitia")},
        surface_names={name: TAGS[name] for name in faces},
    )


def lattice_cells(number: Indices, order: int, *, simplex: bool) -> Indices:
    """Return the nodes of all cells of a lattice in dolfinx's order, (cells, nodes).

    Args:
        number: Number of each node of the lattice, in two or three dimensions.
        order: Order of the cells.
        simplex: Whether each brick is cut into simplices.
    """
    offsets = order * _reference_nodes(number.ndim, order, simplex=simplex)
    cells = [(extent - 1) // order for extent in number.shape]
    first = order * np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1)
    nodes = first.reshape(-1, 1, 1, number.ndim) + np.rint(offsets).astype(np.int64)
    return np.asarray(number[tuple(np.moveaxis(nodes, -1, 0))].reshape(-1, offsets.shape[1]))


def _reference_nodes(dim: int, order: int, *, simplex: bool) -> Points:
    """Return the nodes of the cells of a unit brick, (cells, nodes, dim).

    Each simplex has the corners on a path of edges from the first corner of the brick to the last:
    the steps of the path are a permutation of the axes.
    """
    names = ("triangle", "tetrahedron") if simplex else ("quadrilateral", "hexahedron")
    kind = getattr(basix.CellType, names[dim - 2])
    points = np.asarray(basix.create_element(basix.ElementFamily.P, kind, order).points, np.float64)
    if not simplex:
        return points[None]
    steps = np.array([np.eye(dim)[list(path)] for path in itertools.permutations(range(dim))])
    return np.asarray(points @ np.cumsum(steps, axis=1))
