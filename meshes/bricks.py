# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The two-layer tube of hexahedra, with straight edges or with curved ones, on all processes.

Node (i, j, k) of a lattice is the i-th through the wall, the j-th around and the k-th along; a cell
has (order + 1)³ of them, and lies on a circle at order + 1 places around. Layers, surfaces and
lengths are those of :mod:`meshes.tube`.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

import basix

from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.wall import Wall
from dolfinx_feti.wall.wall import distribute
from dolfinx_feti.wall.wallfile import RawWall
from meshes.layers import sheets
from meshes.surface import Indices, Points
from meshes.tube import ADVENTITIA, INNER_RADIUS, MEDIA, count_around
from meshes.wall_mesh import TAGS

__all__ = ["create_brick_tube"]


def create_brick_tube(
    comm: MPI.Comm,
    *,
    length: float,
    size: float,
    quarter: bool = False,
    around: int | None = None,
    along: int | None = None,
    order: int = 2,
) -> Wall:
    """Mesh the tube with hexahedra.

    Args:
        comm: Communicator of the mesh.
        length: Length [mm].
        size: Wanted length of the edges [mm].
        quarter: Only the part with x ≥ 0 and y ≥ 0.
        around: Elements around the circumference (a quarter of it for the quarter); about so many
            that they are as long as wanted if not given.
        along: Elements along the axis; as for ``around``.
        order: Of the geometry: 1 for straight edges, 2 for curved ones.

    Raises:
        ValueError: A length is not positive, or the order is another one. On all processes.

    Note:
        Collective.
    """
    if not (length > 0 and size > 0) or order not in (1, 2):
        raise ValueError(
            f"length={length}, size={size}, order={order}: give lengths above zero, and order 1 or "
            "2."
        )
    counts = (
        count_around(size, quarter=quarter) if around is None else around,
        max(1, round(length / size)) if along is None else along,
    )
    raw: list[RawWall] = []  # on the first process
    on_first(lambda: raw.append(_create(length, size, *counts, quarter=quarter, order=order)), comm)
    return distribute(raw[0] if raw else None, comm)


def _create(
    length: float, size: float, around: int, along: int, *, quarter: bool, order: int
) -> RawWall:
    """Return points, cells and surfaces of the whole tube."""
    through = [max(1, round(extent / size)) for extent in (MEDIA, ADVENTITIA)]
    heights, layers = sheets((MEDIA, ADVENTITIA), through, (TAGS["media"], TAGS["adventitia"]))
    cells_each_way = (len(layers), around, along)
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
    facets = {name: _elements(np.squeeze(sheet), order) for name, sheet in faces.items()}
    return RawWall(
        points=x.reshape(-1, 3),
        cells=_elements(number, order),
        layers=np.repeat(layers, cells_each_way[1] * cells_each_way[2]),
        facets=np.concatenate(list(facets.values())),
        surfaces=np.concatenate([np.full(len(f), TAGS[name]) for name, f in facets.items()]),
        layer_names={name: TAGS[name] for name in ("media", "adventitia")},
        surface_names={name: TAGS[name] for name in faces},
    )


def _elements(number: Indices, order: int) -> Indices:
    """Return the nodes of all cells of a lattice as dolfinx numbers them, (cells, nodes)."""
    kind = basix.CellType.hexahedron if number.ndim == 3 else basix.CellType.quadrilateral
    points: Points = basix.create_element(basix.ElementFamily.P, kind, order).points
    cells = [(extent - 1) // order for extent in number.shape]
    first = order * np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1)
    nodes = first.reshape(-1, 1, number.ndim) + np.rint(order * points).astype(np.int64)
    return np.asarray(number[tuple(np.moveaxis(nodes, -1, 0))])
