# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Meshes with quadratic geometry, whose cells follow curved surfaces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import basix.ufl
import dolfinx

from dolfinx_feti.runtime.scotch import repeatable_partitions

__all__ = ["curved"]

Points = np.ndarray


def curved(mesh: dolfinx.mesh.Mesh, place: Callable[[Points], Points]) -> dolfinx.mesh.Mesh:
    """Return a mesh of the same cells with quadratic geometry and moved nodes. Collective.

    Args:
        mesh: Mesh with straight cells.
        place: Maps the positions of vertices and midpoints of edges, (n, gdim), to those of the
            nodes of the new mesh.
    """
    gdim = mesh.geometry.dim
    element = basix.ufl.element("Lagrange", mesh.basix_cell(), 2, shape=(gdim,))
    V = dolfinx.fem.functionspace(mesh, element)
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    nodes = V.dofmap.index_map
    cells = nodes.local_to_global(V.dofmap.list[:owned].ravel()).reshape(owned, -1)
    x = place(V.tabulate_dof_coordinates()[: nodes.size_local, :gdim].copy())
    with repeatable_partitions():
        return dolfinx.mesh.create_mesh(mesh.comm, cells=cells, x=x, e=element)
