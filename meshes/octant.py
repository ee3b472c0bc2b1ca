# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""An octant of a thick sphere, of curved tetrahedra: a lattice of triangles, raised in layers.

A triangle with corners (1, 0, 0), (0, 1, 0), (0, 0, 1) is divided evenly and projected on spheres.
Each prism between two layers is cut into three tetrahedra along diagonals from the lower numbers.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx

__all__ = ["create_octant"]


def create_octant(
    comm: MPI.Comm, divisions: int, layers: int, inner: float = 1.0, outer: float = 1.1
) -> dolfinx.mesh.Mesh:
    """Mesh the part of a hollow sphere with x, y, z ≥ 0 by tetrahedra of second order.

    Args:
        comm: Communicator of the mesh.
        divisions: Of an edge of the triangle.
        layers: Through the wall.
        inner: Radius [mm].
        outer: Radius [mm].

    Note:
        Collective.
    """
    n, points, cells = divisions, np.zeros((0, 3)), np.zeros((0, 4), dtype=np.int64)
    if comm.rank == 0:
        at = {ij: k for k, ij in enumerate((i, j) for i in range(n + 1) for j in range(n + 1 - i))}
        flat = np.array(list(at)) / n
        radii = np.linspace(inner, outer, layers + 1)
        points = np.vstack([np.column_stack((flat, np.full(len(flat), r))) for r in radii])
        down = [(at[i, j], at[i + 1, j], at[i, j + 1]) for i, j in at if i + j < n]
        up = [(at[i + 1, j], at[i + 1, j + 1], at[i, j + 1]) for i, j in at if i + j < n - 1]
        low = np.sort(down + up, axis=1)
        for a, b in ((low + k * len(flat), low + (k + 1) * len(flat)) for k in range(layers)):
            prisms = (a, b[:, 2]), (a[:, :2], b[:, 1:]), (a[:, 0], b)
            cells = np.vstack([cells, *map(np.column_stack, prisms)])
    linear = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    prism = dolfinx.mesh.create_mesh(comm, cells=cells, x=points, e=linear)
    quadratic = basix.ufl.element("Lagrange", "tetrahedron", 2, shape=(3,))
    nodes = dolfinx.fem.functionspace(prism, quadratic)
    owned, count = nodes.dofmap.index_map.size_local, prism.topology.index_map(3).size_local
    x, y, r = nodes.tabulate_dof_coordinates()[:owned].T
    rays = np.column_stack((x, y, 1.0 - x - y))
    number = nodes.dofmap.index_map.local_to_global(nodes.dofmap.list[:count].ravel())
    return dolfinx.mesh.create_mesh(
        comm,
        cells=number.reshape(count, -1),
        x=r[:, None] * rays / np.linalg.norm(rays, axis=1)[:, None],
        e=quadratic,
    )
