# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The two-layer tube of bricks, with straight edges or with curved ones, on all processes.

Node (i, j, k) of a lattice is the i-th through the wall, the j-th around and the k-th along; a
brick has (order + 1)³ of them, and lies on a circle at order + 1 places around. It is a hexahedron,
or cut into six tetrahedra along the paths of edges from its first corner to the last. Layers,
surfaces and lengths are those of :mod:`meshes.tube`.
"""

from __future__ import annotations

import itertools

from mpi4py import MPI

import numpy as np

import basix

from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.wall import Wall
from dolfinx_feti.wall.wallfile import RawWall, distribute
from meshes.layers import sheets
from meshes.surface import Indices, Points
from meshes.tube import ADVENTITIA, INNER_RADIUS, MEDIA, count_around
from meshes.wall_mesh import TAGS

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
        around: Elements around the circumference (a quarter of it for the quarter); about so many
            that they are as long as wanted if not given.
        along: Elements along the axis; as for ``around``.
        through: Elements through media and adventitia; as for ``around``.
        growth: Of the elements through the media: their thickness outside over that at the lumen,
            where stresses are steep; on finer meshes the same.
        order: Of the geometry: 1 for straight edges, 2 for curved ones.
        tetrahedra: Six of them in place of each hexahedron.

    Raises:
        ValueError: A length is not positive, or the order is another one. On all processes.

    Note:
        Collective.
    """
    if not (length > 0 and size > 0 and growth > 0) or order not in (1, 2):
        raise ValueError(
            f"length={length}, size={size}, growth={growth}, order={order}: give lengths and a "
            "growth above zero, and order 1 or 2."
        )
    counts = (
        through or tuple(max(1, round(extent / size)) for extent in (MEDIA, ADVENTITIA)),
        count_around(size, quarter=quarter) if around is None else around,
        max(1, round(length / size)) if along is None else along,
    )
    raw: list[RawWall] = []  # on the first process

    def create() -> None:
        shape = {"quarter": quarter, "order": order, "simplex": tetrahedra}
        raw.append(_create(length, *counts, growth=growth, **shape))

    on_first(create, comm)
    return distribute(raw[0] if raw else None, comm)


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
) -> RawWall:
    """Return points, cells and surfaces of the whole tube."""
    heights, layers = sheets((MEDIA, ADVENTITIA), through, (TAGS["media"], TAGS["adventitia"]))
    if growth != 1.0:
        media = heights[: through[0] + 1]
        ξ = media / media[-1]
        media[:] = media[-1] * (growth**ξ - 1.0) / (growth - 1.0)
    columns = order * around + (1 if quarter else 0)
    s = np.interp(np.arange(order * len(layers) + 1) / order, np.arange(len(heights)), heights)
    angle = np.arange(columns) * (np.pi / 2 if quarter else 2 * np.pi) / (order * around)
    height = np.linspace(0.0, length, order * along + 1)
    r, θ, z = np.meshgrid(INNER_RADIUS + (MEDIA + ADVENTITIA) * s, angle, height, indexing="ij")
    x = np.stack([r * np.cos(θ), r * np.sin(θ), z], axis=-1)
    x[np.abs(x) < 1e-15] = 0.0  # the symmetry planes hold their points exactly
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
    return RawWall(
        points=x.reshape(-1, 3),
        cells=cells,
        layers=np.repeat(layers, len(cells) // len(layers)),
        facets=np.concatenate(list(facets.values())),
        surfaces=np.concatenate([np.full(len(f), TAGS[name]) for name, f in facets.items()]),
        layer_names={name: TAGS[name] for name in ("media", "adventitia")},
        surface_names={name: TAGS[name] for name in faces},
    )


def lattice_cells(number: Indices, order: int, *, simplex: bool) -> Indices:
    """Return the nodes of all cells of a lattice as dolfinx numbers them, (cells, nodes)."""
    offsets = order * _reference_nodes(number.ndim, order, simplex=simplex)
    cells = [(extent - 1) // order for extent in number.shape]
    first = order * np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1)
    nodes = first.reshape(-1, 1, 1, number.ndim) + np.rint(offsets).astype(np.int64)
    return np.asarray(number[tuple(np.moveaxis(nodes, -1, 0))].reshape(-1, offsets.shape[1]))


def _reference_nodes(dim: int, order: int, *, simplex: bool) -> Points:
    """Return the nodes of the cells of a unit brick, (cells, nodes, dim)."""
    names = ("triangle", "tetrahedron") if simplex else ("quadrilateral", "hexahedron")
    kind = getattr(basix.CellType, names[dim - 2])
    points: Points = basix.create_element(basix.ElementFamily.P, kind, order).points
    if not simplex:
        return points[None]
    steps = np.array([np.eye(dim)[list(path)] for path in itertools.permutations(range(dim))])
    return np.asarray(points @ np.cumsum(steps, axis=1))
