# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A mesh that moves in place: displacements at its nodes, and cells that turn inside out.

Forms, tags, decomposition and sparsity stay; what is assembled afterwards is of the moved mesh.
Between the nodes a displacement of a higher degree than the geometry's is not followed: a straight
edge stays straight.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.fem.quadrature import quadrature_points
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import bounds
from dolfinx_feti.runtime.compat import geometry_dofmap


def diameter(mesh: dolfinx.mesh.Mesh) -> float:
    """Return the diagonal of the box around the nodes of a mesh. Collective."""
    low, high = bounds(mesh.geometry.x, mesh.comm)
    return float(np.linalg.norm(high - low))


class Nodes:
    """The nodes of a mesh.

    Attributes:
        mesh: The mesh.
        initial: Their coordinates when this was made, (nodes, 3), ghosts included.
    """

    def __init__(self, mesh: dolfinx.mesh.Mesh) -> None:
        """Remember the mesh as it is. Collective."""
        self.mesh = mesh
        self.initial: Array = np.array(mesh.geometry.x, dtype=np.float64)
        self._W = dolfinx.fem.functionspace(mesh, mesh.ufl_domain().ufl_coordinate_element())
        degree = self._W.ufl_element().degree
        points = quadrature_points(mesh, mesh.geometry.dim * degree)
        self._determinant = dolfinx.fem.Expression(ufl.JacobianDeterminant(mesh), points)
        self._sign = np.sign(self._determinants())

    def displacement(self, u: dolfinx.fem.Function) -> Array:
        """Return a displacement at the nodes of this process, (nodes, 3)."""
        w = dolfinx.fem.Function(self._W)
        w.interpolate(u)
        dim, nodes = self.mesh.geometry.dim, geometry_dofmap(self.mesh)
        values = np.zeros(self.initial.shape)
        values[nodes.ravel(), :dim] = w.x.array.reshape(-1, dim)[self._W.dofmap.list.ravel()]
        return values

    def longest(self, w: Array) -> float:
        """Return the length of the longest of the vectors at the nodes, (nodes, 3). Collective."""
        length = float(np.linalg.norm(w, axis=1).max(initial=0.0))
        return self.mesh.comm.allreduce(length, op=MPI.MAX)

    def inverted(self) -> int:
        """Count the cells that are inside out, compared with the mesh as it was. Collective."""
        bad = np.any(self._determinants() * self._sign <= 0.0, axis=1)
        return self.mesh.comm.allreduce(int(bad.sum()))

    def _determinants(self) -> Array:
        """Return det ∂x/∂ξ of the owned cells at quadrature points, (cells, points)."""
        n = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        values = self._determinant.eval(self.mesh, np.arange(n, dtype=np.int32))
        return np.asarray(values, dtype=np.float64).reshape(n, -1)
