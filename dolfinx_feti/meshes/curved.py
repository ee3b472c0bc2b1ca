# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Meshes with quadratic geometry, whose cells follow curved surfaces."""

from __future__ import annotations

from collections.abc import Callable

import basix.ufl
import dolfinx

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.scotch import repeatable_partitions

__all__ = ["create_curved_mesh"]


def create_curved_mesh(
    mesh: dolfinx.mesh.Mesh, move: Callable[[Array], Array]
) -> dolfinx.mesh.Mesh:
    """Return a mesh of the same cells with quadratic geometry and moved nodes. Collective.

    Args:
        mesh: Mesh with straight cells.
        move: Maps the vertices and the midpoints of edges of the mesh, (n, gdim), to the nodes of
            the new mesh, (n, gdim).
    """
    gdim = mesh.geometry.dim
    element = basix.ufl.element("Lagrange", mesh.basix_cell(), 2, shape=(gdim,))
    V = dolfinx.fem.functionspace(mesh, element)
    n_cells = mesh.topology.index_map(mesh.topology.dim).size_local
    nodes = V.dofmap.index_map
    cells = nodes.local_to_global(V.dofmap.list[:n_cells].ravel()).reshape(n_cells, -1)
    x = move(V.tabulate_dof_coordinates()[: nodes.size_local, :gdim].copy())
    with repeatable_partitions():
        return dolfinx.mesh.create_mesh(mesh.comm, cells=cells, x=x, e=element)
