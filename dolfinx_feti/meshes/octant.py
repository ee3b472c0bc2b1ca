# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""An octant of a hollow sphere, of curved tetrahedra: prisms over a lattice of triangles.

A triangle with corners (1, 0, 0), (0, 1, 0), (0, 0, 1) is divided evenly and projected to spheres.
Each prism between two sheets of points is cut into three tetrahedra, along diagonals from the
corners with lower numbers. A straight mesh over the coordinates (x, y) of the triangle and the
radius is created first; its vertices and midpoints of edges are then mapped to the spheres.
"""

from __future__ import annotations

import math

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx

from dolfinx_feti.meshes.curved import create_curved_mesh
from dolfinx_feti.meshes.layers import PRISM_TETRAHEDRA
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.scotch import repeatable_partitions
from dolfinx_feti.runtime.values import require_within

__all__ = ["create_octant"]


def create_octant(
    comm: MPI.Comm, divisions: int, through: int, inner: float = 1.0, outer: float = 1.1
) -> dolfinx.mesh.Mesh:
    """Create a mesh of second order of an octant of a hollow sphere, x, y, z ≥ 0.

    Args:
        comm: Communicator of the mesh.
        divisions: Elements along an edge of the triangle, 1 or more.
        through: Elements through the wall, 1 or more.
        inner: Inner radius [mm].
        outer: Outer radius [mm].

    Returns:
        The mesh, without tags.

    Raises:
        ValueError: A number of elements is less than 1. On all processes.

    Note:
        Collective.
    """
    counts = {"divisions": divisions, "through": through}
    require_within(1.0, math.inf, counts, remedy="1 or more")
    points: Array = np.zeros((0, 3))  # of other processes than the first one
    cells: Numbers = np.zeros((0, 4), dtype=np.int64)
    if comm.rank == 0:
        radii = np.linspace(inner, outer, through + 1, dtype=np.float64)
        points, cells = _prisms(divisions, through, radii)
    linear = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    with repeatable_partitions():
        straight = dolfinx.mesh.create_mesh(comm, cells=cells, x=points, e=linear)
    return create_curved_mesh(straight, _on_spheres)


def _on_spheres(x: Array) -> Array:
    """Return the positions on the spheres of points (x, y, radius) over the triangle, (n, 3)."""
    rays = np.column_stack((x[:, 0], x[:, 1], 1.0 - x[:, 0] - x[:, 1]))
    return np.asarray(x[:, 2:] * rays / np.linalg.norm(rays, axis=1)[:, None])


def _prisms(divisions: int, through: int, radii: Array) -> tuple[Array, Numbers]:
    """Return points (x, y, radius) over the triangle, (n, 3), and tetrahedra, (m, 4).

    Args:
        divisions: Elements along an edge of the triangle.
        through: Elements through the wall.
        radii: Radius of each sheet of points, (through + 1,).
    """
    lattice = [(i, j) for i in range(divisions + 1) for j in range(divisions + 1 - i)]
    number = {position: k for k, position in enumerate(lattice)}
    triangles = []  # those that point up, then those that point down
    for i, j in lattice:
        if i + j < divisions:
            triangles.append((number[i, j], number[i + 1, j], number[i, j + 1]))
    for i, j in lattice:
        if i + j < divisions - 1:
            triangles.append((number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]))
    xy = np.array(lattice) / divisions
    points = [np.column_stack((xy, np.full(len(xy), radius))) for radius in radii]
    corners = np.sort(triangles, axis=1)
    cells = []
    for sheet in range(through):
        below = corners + sheet * len(xy)
        prisms = np.hstack([below, below + len(xy)])
        cells += [prisms[:, tetrahedron] for tetrahedron in PRISM_TETRAHEDRA]
    return np.vstack(points), np.vstack(cells)
