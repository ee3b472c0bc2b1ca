# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Land's truncated ellipsoid, of curved hexahedra, and its fibres.

At the fraction t of the way through the wall, 0 inside and 1 outside, the half axes are
r_s = 7 + 3 t and r_l = 17 + 3 t [mm]; with the angle μ from the apex

    x = (r_s sin μ cos θ, r_s sin μ sin θ, -r_l cos μ)

up to the base z = 5. The mesh is that of a disc, a square with four blocks around it, mapped to the
ellipsoids with its centre at the apex: no cell degenerates there. Fibres turn through the wall:
f = sin α e_μ + cos α e_θ with α = 90° - 180° t.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.meshes.bricks import lattice_cells
from dolfinx_feti.meshes.wall_mesh import TAGS
from dolfinx_feti.runtime.collective import on_root_only
from dolfinx_feti.wall.wall import Wall
from dolfinx_feti.wall.wall_arrays import WallArrays, distribute

__all__ = ["LONG", "THICKNESS", "create_ellipsoid", "ellipsoid_fibre"]

Array = npt.NDArray[np.float64]

#: Half axes of the inner surface, thickness of the wall, and height z of the base [mm]: problems 2
#: and 3 of Land et al. 2015.
SHORT = 7.0
LONG = 17.0
THICKNESS = 3.0
BASE = 5.0

#: Half the edge of the square in the disc of radius 1, a choice: close to 0 the square's cells
#: shrink, from 1/√2 on the blocks around it have no width.
SQUARE = 0.3


def create_ellipsoid(comm: MPI.Comm, n: int, through: int | None = None) -> Wall:
    """Create the wall with the surfaces ``lumen`` and ``base``. Collective.

    Args:
        comm: Communicator of the mesh.
        n: The refinement: 8 n bricks around, 4 n from the apex to the base.
        through: Bricks through the wall; n if not given.
    """
    arrays = on_root_only(lambda: _create(n, through or n), comm)
    return distribute(arrays, comm)


def ellipsoid_fibre(mesh: dolfinx.mesh.Mesh) -> Expr:
    """Return the direction of the fibres [-], (3,). Collective."""
    t = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 2)))
    t.interpolate(lambda x: _fraction(np.hypot(x[0], x[1]), x[2]))
    x = ufl.SpatialCoordinate(mesh)
    r = ufl.sqrt(x[0] ** 2 + x[1] ** 2)
    e_r = ufl.as_vector([x[0], x[1], 0]) / r
    e_t = ufl.as_vector([-x[1], x[0], 0]) / r
    short = SHORT + THICKNESS * t
    long = LONG + THICKNESS * t
    up = -short * x[2] / long * e_r + long * r / short * ufl.as_vector([0, 0, 1])  # ∂x/∂μ
    α = np.pi / 2 - np.pi * t
    return ufl.sin(α) * up / ufl.sqrt(ufl.dot(up, up)) + ufl.cos(α) * e_t


def _fraction(r: Array, z: Array) -> Array:
    """Return t at points, by bisection of (r/r_s)² + (z/r_l)² = 1."""
    # the nodes of curved cells lie on ellipsoids up to rounding: 0.1 is an ample margin
    low = np.full(r.shape, -0.1)
    high = np.full(r.shape, 1.1)
    for _ in range(60):  # 1.2 / 2⁶⁰ is below rounding
        t = (low + high) / 2
        at = (r / (SHORT + THICKNESS * t)) ** 2 + (z / (LONG + THICKNESS * t)) ** 2
        low = np.where(at > 1, t, low)
        high = np.where(at > 1, high, t)
    return (low + high) / 2


def _create(n: int, through: int) -> WallArrays:
    """Return the points, cells and surfaces.

    Args:
        n: The refinement, see :func:`create_ellipsoid`.
        through: Bricks through the wall.
    """
    # points of the five blocks of the disc, (j, k, 2) each; a brick has three nodes along an edge
    t = np.linspace(0.0, 1.0, 2 * through + 1, dtype=np.float64)
    s = np.linspace(-1.0, 1.0, 4 * n + 1)
    square = SQUARE * np.stack(np.meshgrid(s, s, indexing="ij"), axis=-1)
    ρ = np.linspace(0.0, 1.0, 6 * n + 1)[:, None, None]
    side = np.stack([np.full_like(s, SQUARE), SQUARE * s], axis=-1)
    arc = np.stack([np.cos(np.pi / 4 * s), np.sin(np.pi / 4 * s)], axis=-1)
    block = (1 - ρ) * side + ρ * arc
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    blocks = [square, *(block @ np.linalg.matrix_power(turn, k) for k in range(4))]

    # points of the wall; those that blocks share become one: they agree up to rounding, and 0.0 is
    # added because np.round leaves −0.0
    points = [_map_to_wall(t[:, None, None], disc.astype(np.float64)) for disc in blocks]
    ends = np.cumsum([part[..., 0].size for part in points])
    flat = np.concatenate([part.reshape(-1, 3) for part in points])
    _, first, number = np.unique(
        np.round(flat, 9) + 0.0, axis=0, return_index=True, return_inverse=True
    )
    numbers = [
        part.reshape(points[i].shape[:3])
        for i, part in enumerate(np.split(number.ravel(), ends[:-1]))
    ]

    # the lumen is the first sheet of all blocks, the base the outer edge of those around the square
    cells = np.concatenate([lattice_cells(each, 2, simplex=False) for each in numbers])
    lumen = [lattice_cells(each[0], 2, simplex=False) for each in numbers]
    base = [lattice_cells(each[:, -1], 2, simplex=False) for each in numbers[1:]]
    facets = [np.concatenate(lumen), np.concatenate(base)]
    tags = {"lumen": TAGS["lumen"], "base": TAGS["opening_1"]}
    return WallArrays(
        points=flat[first],
        cells=cells,
        layers=np.ones(len(cells), dtype=np.int64),
        facets=np.concatenate(facets),
        surfaces=np.repeat(list(tags.values()), [len(part) for part in facets]),
        layer_names={"wall": 1},
        surface_names=tags,
    )


def _map_to_wall(t: Array, disc: Array) -> Array:
    """Map points of the unit disc, (j, k, 2), to the ellipsoids at t, (i, 1, 1)."""
    ρ = np.linalg.norm(disc, axis=-1)
    short = SHORT + THICKNESS * t
    long = LONG + THICKNESS * t
    μ = ρ * (np.pi - np.arccos(BASE / long))
    outwards = disc / np.maximum(ρ, 1e-300)[..., None]  # zero in the centre
    across = (short * np.sin(μ))[..., None] * outwards
    return np.concatenate([across, -(long * np.cos(μ))[..., None]], axis=-1)
