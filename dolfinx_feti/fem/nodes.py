# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Nodes of a mesh that is moved in place: displacements at the nodes, and inverted cells.

Forms, tags, decomposition and sparsity stay valid; forms are then assembled on the moved mesh. A
displacement of a higher degree than the geometry is used at the nodes only: a straight edge stays
straight.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.fem.quadrature import quadrature_points
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import bounding_box
from dolfinx_feti.runtime.compat import geometry_dofmap


def diameter(mesh: dolfinx.mesh.Mesh) -> float:
    """Return the diagonal of the box around the nodes of a mesh [mm]. Collective.

    It is an upper bound of the diameter, by a factor of at most √3.
    """
    low, high = bounding_box(mesh.geometry.x, mesh.comm)
    return float(np.linalg.norm(high - low))


class Nodes:
    """The nodes of a mesh that the caller moves in place, with their initial coordinates.

    Attributes:
        mesh: The mesh.
        initial: Coordinates of the nodes when the object was created [mm], ghosts included,
            (nodes, 3).
    """

    def __init__(self, mesh: dolfinx.mesh.Mesh) -> None:
        """Store the coordinates and orientations of a mesh. Collective."""
        self.mesh = mesh
        self.initial: Array = np.array(mesh.geometry.x, dtype=np.float64)
        self._W = dolfinx.fem.functionspace(mesh, mesh.ufl_domain().ufl_coordinate_element())
        # det ∂x/∂ξ, a product of gdim derivatives, has at most this degree in a simplex
        degree = mesh.geometry.dim * self._W.ufl_element().degree
        points = quadrature_points(mesh, degree)
        # no Compiler: the expression belongs to no problem, and has dolfinx's own options
        self._determinant = dolfinx.fem.Expression(ufl.JacobianDeterminant(mesh), points)
        self._sign = np.sign(self._determinants())

    def displacement(self, u: dolfinx.fem.Function) -> Array:
        """Return the values of a displacement at the nodes of this process [mm], (nodes, 3)."""
        w = dolfinx.fem.Function(self._W)
        w.interpolate(u)
        dim = self.mesh.geometry.dim
        nodes = geometry_dofmap(self.mesh)
        values = np.zeros(self.initial.shape)
        values[nodes.ravel(), :dim] = w.x.array.reshape(-1, dim)[self._W.dofmap.list.ravel()]
        return values

    def longest(self, w: Array) -> float:
        """Return the largest length of vectors at the nodes, (nodes, 3). Collective."""
        length = float(np.linalg.norm(w, axis=1).max(initial=0.0))
        return self.mesh.comm.allreduce(length, op=MPI.MAX)

    def inverted(self) -> int:
        """Return the number of cells that are inverted since the object was created. Collective."""
        is_inverted = np.any(self._determinants() * self._sign <= 0.0, axis=1)
        return self.mesh.comm.allreduce(int(is_inverted.sum()))

    def _determinants(self) -> Array:
        """Return det ∂x/∂ξ of the owned cells at quadrature points, (cells, points)."""
        n = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        values = self._determinant.eval(self.mesh, np.arange(n, dtype=np.int32))
        return np.asarray(values, dtype=np.float64).reshape(n, -1)
