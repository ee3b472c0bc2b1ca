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

import math

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.meshes.lattice import lattice_cells
from dolfinx_feti.meshes.tags import SURFACE_TAGS, tags_of
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.values import require_within
from dolfinx_feti.wall.wall import Wall
from dolfinx_feti.wall.wall_arrays import WallArrays, create_on_root, distribute

__all__ = ["LONG", "THICKNESS", "create_ellipsoid", "ellipsoid_fibre"]

#: Shorter half axis of the inner surface [mm], across the ventricle: problems 2 and 3 of S. Land et
#: al., *Verification of cardiac mechanics software*, Proceedings of the Royal Society A 471, 2015.
SHORT = 7.0

#: Longer half axis of the inner surface [mm], from the centre to the apex; from the same problems.
LONG = 17.0

#: Thickness of the wall along the axes [mm].
THICKNESS = 3.0

#: Height z of the base [mm].
BASE = 5.0

#: Half the edge of the square in the disc of radius 1, a choice: close to 0 the square's cells
#: shrink, from 1/√2 on the blocks around it have no width.
SQUARE = 0.3

#: Points whose coordinates [mm] agree to this number of digits after the point are equal: shared
#: points of two blocks agree to rounding, 1e-14, and nodes of a mesh are at least 1e-3 apart.
SAME_POINT_DIGITS = 9

#: Bisections of an interval of length 1.2 that reach rounding: 1.2 / 2⁶⁰ is 1e-18.
BISECTIONS = 60

#: The bisection for the fraction t starts from an interval that is longer than [0, 1] by this much
#: at both ends: nodes on the inner and outer ellipsoid lie there only up to rounding.
FRACTION_MARGIN = 0.1


def create_ellipsoid(comm: MPI.Comm, n: int, through: int | None = None) -> Wall:
    """Create the ellipsoid's wall, one layer with the surfaces ``lumen`` and ``base``. Collective.

    Args:
        comm: Communicator of the mesh.
        n: The refinement, 1 or more: 8 n bricks around, 4 n from the apex to the base.
        through: Bricks through the wall, 1 or more; n if not given.

    Raises:
        ValueError: A number is less than 1. On all processes.
    """
    n_through = n if through is None else through
    require_within(1.0, math.inf, {"n": n, "through": n_through}, remedy="1 or more")
    arrays = create_on_root(lambda: _create_arrays(n, n_through), comm)
    return distribute(arrays, comm)


def ellipsoid_fibre(mesh: dolfinx.mesh.Mesh) -> Expr:
    """Return the direction of the fibres [-], (3,). Collective."""
    t = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 2)))
    t.interpolate(lambda x: _fraction(np.hypot(x[0], x[1]), x[2]))
    x = ufl.SpatialCoordinate(mesh)
    r = ufl.sqrt(x[0] ** 2 + x[1] ** 2)
    e_r = ufl.as_vector([x[0], x[1], 0]) / r
    e_θ = ufl.as_vector([-x[1], x[0], 0]) / r
    short = SHORT + THICKNESS * t
    long = LONG + THICKNESS * t
    up = -short * x[2] / long * e_r + long * r / short * ufl.as_vector([0, 0, 1])  # ∂x/∂μ
    α = np.pi / 2 - np.pi * t
    return ufl.sin(α) * up / ufl.sqrt(ufl.dot(up, up)) + ufl.cos(α) * e_θ


def _fraction(r: Array, z: Array) -> Array:
    """Return t at points, (n,), by bisection of (r/r_s)² + (z/r_l)² = 1.

    Args:
        r: Distance from the axis [mm], (n,).
        z: Height [mm], (n,).
    """
    low = np.full(r.shape, -FRACTION_MARGIN)
    high = np.full(r.shape, 1.0 + FRACTION_MARGIN)
    for _ in range(BISECTIONS):
        t = (low + high) / 2
        is_outside = (r / (SHORT + THICKNESS * t)) ** 2 + (z / (LONG + THICKNESS * t)) ** 2 > 1
        low = np.where(is_outside, t, low)
        high = np.where(is_outside, high, t)
    return (low + high) / 2


def _create_arrays(n: int, through: int) -> WallArrays:
    """Return the points, cells and surfaces.

    Args:
        n: The refinement, see :func:`create_ellipsoid`.
        through: Bricks through the wall.
    """
    # a brick has three nodes along an edge
    t = np.linspace(0.0, 1.0, 2 * through + 1, dtype=np.float64)
    blocks = [_map_to_wall(t[:, None, None], disc) for disc in _disc_blocks(n)]
    points, numbers = _join(blocks)

    # the lumen is the first sheet of all blocks, the base the outer side of those around the square
    cells = [lattice_cells(block, 2, simplices=False) for block in numbers]
    lumen = [lattice_cells(block[0], 2, simplices=False) for block in numbers]
    base = [lattice_cells(block[:, -1], 2, simplices=False) for block in numbers[1:]]
    facets = {"lumen": np.concatenate(lumen), "base": np.concatenate(base)}
    # the base is the only opening, so it has the tag of the first one
    names = {"lumen": SURFACE_TAGS["lumen"], "base": SURFACE_TAGS["opening_1"]}
    all_cells = np.concatenate(cells)
    return WallArrays(
        points=points,
        cells=all_cells,
        cell_tags=np.ones(len(all_cells), dtype=np.int64),
        facets=np.concatenate(list(facets.values())),
        facet_tags=tags_of(facets, names),
        layer_names={"wall": 1},
        surface_names=names,
    )


def _disc_blocks(n: int) -> list[Array]:
    """Return the nodes of the blocks of the unit disc, (j, k, 2) each: the square, and four around.

    Args:
        n: The refinement, see :func:`create_ellipsoid`.
    """
    s = np.linspace(-1.0, 1.0, 4 * n + 1)
    square = SQUARE * np.stack(np.meshgrid(s, s, indexing="ij"), axis=-1)
    ρ = np.linspace(0.0, 1.0, 6 * n + 1)[:, None, None]
    side = np.stack([np.full_like(s, SQUARE), SQUARE * s], axis=-1)
    arc = np.stack([np.cos(np.pi / 4 * s), np.sin(np.pi / 4 * s)], axis=-1)
    block = (1 - ρ) * side + ρ * arc  # from the side of the square to the rim of the disc
    quarter_turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    turned = [block @ np.linalg.matrix_power(quarter_turn, k) for k in range(4)]
    return [np.asarray(disc, dtype=np.float64) for disc in (square, *turned)]


def _join(blocks: list[Array]) -> tuple[Array, list[Numbers]]:
    """Join the points that blocks share.

    Args:
        blocks: Points of each block, (i, j, k, 3).

    Returns:
        All points, (n, 3), and the number of each node of each block, (i, j, k).
    """
    points = np.concatenate([block.reshape(-1, 3) for block in blocks])
    # np.round may leave −0.0, which is not 0.0 in a row
    rounded = np.round(points, SAME_POINT_DIGITS) + 0.0
    _, first, number = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    ends = np.cumsum([block[..., 0].size for block in blocks])
    parts = np.split(number.ravel(), ends[:-1])
    numbers = [part.reshape(block.shape[:3]) for part, block in zip(parts, blocks, strict=True)]
    return points[first], numbers


def _map_to_wall(t: Array, disc: Array) -> Array:
    """Map points of the unit disc to the ellipsoids of the wall, (i, j, k, 3).

    Args:
        t: Fractions of the way through the wall, (i, 1, 1).
        disc: Points of the disc, (j, k, 2).
    """
    ρ = np.linalg.norm(disc, axis=-1)
    short = SHORT + THICKNESS * t
    long = LONG + THICKNESS * t
    μ = ρ * (np.pi - np.arccos(BASE / long))
    outwards = disc / np.maximum(ρ, np.finfo(float).tiny)[..., None]  # zero in the centre
    across = (short * np.sin(μ))[..., None] * outwards
    return np.concatenate([across, -(long * np.cos(μ))[..., None]], axis=-1)
