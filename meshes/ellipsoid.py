# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Land's truncated ellipsoid, of curved hexahedra, and its fibres.

At the fraction t of the way through the wall, 0 inside and 1 outside, the half axes are
r_s = 7 + 3 t and r_l = 17 + 3 t [mm]; with the angle μ from the apex

    x = (r_s sin μ cos θ, r_s sin μ sin θ, -r_l cos μ)

up to the base z = 5. A disc of five blocks, a square among four, is laid over it, so that the apex
is a node as others are. Fibres turn through the wall:
f = sin α e_μ + cos α e_θ with α = 90° - 180° t.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.wall import Wall
from dolfinx_feti.wall.wallfile import RawWall, distribute
from meshes.bricks import lattice_cells

__all__ = ["LONG", "THICKNESS", "create_ellipsoid", "ellipsoid_fibre"]

Array = npt.NDArray[np.float64]

SHORT, LONG, THICKNESS, BASE = 7.0, 17.0, 3.0, 5.0  # mm
SQUARE = 0.3  # half the edge of the square in the disc of radius 1


def create_ellipsoid(comm: MPI.Comm, n: int, through: int | None = None) -> Wall:
    """Mesh the ellipsoid with n bricks through the wall, or so many, and 8 n around.

    Its surfaces are lumen and base. Collective.
    """
    return distribute(_create(n, through or n) if comm.rank == 0 else None, comm)


def ellipsoid_fibre(mesh: dolfinx.mesh.Mesh) -> Expr:
    """Return the direction of the fibres [-], (3,). Collective."""
    t = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 2)))
    t.interpolate(lambda x: _fraction(np.hypot(x[0], x[1]), x[2]))
    x = ufl.SpatialCoordinate(mesh)
    r = ufl.sqrt(x[0] ** 2 + x[1] ** 2)
    e_r, e_t = ufl.as_vector([x[0], x[1], 0]) / r, ufl.as_vector([-x[1], x[0], 0]) / r
    short, long = SHORT + THICKNESS * t, LONG + THICKNESS * t
    up = -short * x[2] / long * e_r + long * r / short * ufl.as_vector([0, 0, 1])  # ∂x/∂μ
    α = np.pi / 2 - np.pi * t
    return ufl.sin(α) * up / ufl.sqrt(ufl.dot(up, up)) + ufl.cos(α) * e_t


def _fraction(r: Array, z: Array) -> Array:
    """Return t at points, by bisection of (r/r_s)² + (z/r_l)² = 1."""
    low, high = np.full(r.shape, -0.1), np.full(r.shape, 1.1)
    for _ in range(60):
        t = (low + high) / 2
        at = (r / (SHORT + THICKNESS * t)) ** 2 + (z / (LONG + THICKNESS * t)) ** 2
        low, high = np.where(at > 1, t, low), np.where(at > 1, high, t)
    return (low + high) / 2


def _create(n: int, through: int) -> RawWall:
    """Return the points, cells and surfaces."""
    t = np.linspace(0.0, 1.0, 2 * through + 1)
    s = np.linspace(-1.0, 1.0, 4 * n + 1)
    square = SQUARE * np.stack(np.meshgrid(s, s, indexing="ij"), axis=-1)
    ρ = np.linspace(0.0, 1.0, 6 * n + 1)[:, None, None]
    side = np.stack([np.full_like(s, SQUARE), SQUARE * s], axis=-1)
    arc = np.stack([np.cos(np.pi / 4 * s), np.sin(np.pi / 4 * s)], axis=-1)
    block = (1 - ρ) * side + ρ * arc
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    blocks = [square, *(block @ np.linalg.matrix_power(turn, k) for k in range(4))]
    points = [_place(t[:, None, None], disc) for disc in blocks]
    ends = np.cumsum([part[..., 0].size for part in points])
    flat = np.concatenate([part.reshape(-1, 3) for part in points])
    _, first, number = np.unique(
        np.round(flat, 9) + 0.0, axis=0, return_index=True, return_inverse=True
    )
    numbers = [
        part.reshape(points[i].shape[:3])
        for i, part in enumerate(np.split(number.ravel(), ends[:-1]))
    ]
    cells = np.concatenate([lattice_cells(each, 2, simplex=False) for each in numbers])
    lumen = [lattice_cells(each[0], 2, simplex=False) for each in numbers]
    base = [lattice_cells(each[:, -1], 2, simplex=False) for each in numbers[1:]]
    facets = [np.concatenate(lumen), np.concatenate(base)]
    return RawWall(
        points=flat[first],
        cells=cells,
        layers=np.ones(len(cells), dtype=np.int64),
        facets=np.concatenate(facets),
        surfaces=np.repeat([3, 11], [len(part) for part in facets]),
        layer_names={"wall": 1},
        surface_names={"lumen": 3, "base": 11},
    )


def _place(t: Array, disc: Array) -> Array:
    """Lay points of the unit disc, (j, k, 2), over the ellipsoids of t, (i, 1, 1)."""
    ρ = np.linalg.norm(disc, axis=-1)
    short, long = SHORT + THICKNESS * t, LONG + THICKNESS * t
    μ = ρ * (np.pi - np.arccos(BASE / long))
    outwards = disc / np.maximum(ρ, 1e-300)[..., None]
    across = (short * np.sin(μ))[..., None] * outwards
    return np.concatenate([across, -(long * np.cos(μ))[..., None]], axis=-1)
