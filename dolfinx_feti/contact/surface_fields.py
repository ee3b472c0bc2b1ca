# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Functions on a mesh of a surface alone, to write and draw values at its quadrature points."""

from __future__ import annotations

import numpy as np

import basix
import basix.ufl
import dolfinx

from dolfinx_feti.contact.surface import ContactSurface
from dolfinx_feti.fem.facets import facets_of_pairs
from dolfinx_feti.runtime import compat
from dolfinx_feti.runtime.arrays import Array, Indices, Numbers

__all__ = ["SurfaceFields"]


class SurfaceFields:
    """A mesh of the facets of a surface, with functions at their quadrature points."""

    def __init__(self, surface: ContactSurface) -> None:
        """Create the mesh, and find the point of each dof. Collective."""
        mesh = surface.mesh
        tdim = mesh.topology.dim
        numbers = facets_of_pairs(mesh, surface.facets)
        order = np.argsort(numbers, kind="stable")
        submesh, parents = compat.create_submesh(mesh, tdim - 1, numbers[order])
        cell = getattr(basix.CellType, submesh.topology.cell_name())
        degree = surface.ds.metadata()["quadrature_degree"]
        element = basix.ufl.quadrature_element(cell, degree=degree)
        self._space = dolfinx.fem.functionspace(submesh, element)
        # a facet has the same points in both meshes, in a different order
        n = len(surface.element.rules[0])
        facets = order[np.searchsorted(numbers[order], parents)]  # of each cell of the submesh
        in_body = surface.coordinates().reshape(len(numbers), n, mesh.geometry.dim)[facets]
        on_surface = _coordinates_of_points(self._space)
        number_in_facet = _nearest_points(in_body, on_surface)
        self._point_of_dof: Indices = (facets[:, None] * n + number_in_facet).astype(np.int32)

    def create(self, name: str) -> dolfinx.fem.Function:
        """Create a function of zeros. Collective."""
        return dolfinx.fem.Function(self._space, name=name)

    def set_values(self, f: dolfinx.fem.Function, values: Array) -> None:
        """Set a function to values at the points of the surface. Collective.

        Args:
            f: A function from :meth:`create`.
            values: The values, (points,).
        """
        dofs = self._space.dofmap.list[: len(self._point_of_dof)]
        f.x.array[dofs] = values[self._point_of_dof]
        f.x.scatter_forward()


def _nearest_points(points: Array, positions: Array) -> Numbers:
    """Return the number of the point that is nearest to each position, (facets, positions).

    Args:
        points: Points of each facet, (facets, points, d).
        positions: Positions on each facet, (facets, positions, d).
    """
    distances = np.linalg.norm(points[:, None, :, :] - positions[:, :, None, :], axis=3)
    return np.asarray(np.argmin(distances, axis=2))


def _coordinates_of_points(V: dolfinx.fem.FunctionSpace) -> Array:
    """Return the points of a space of values at quadrature points, (owned cells, points, d)."""
    mesh = V.mesh
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    points = compat.interpolation_points(V)
    shape = (len(cells), len(points), mesh.geometry.dim)
    if not len(cells):
        return np.zeros(shape)
    nodes = mesh.geometry.x[compat.geometry_dofmap(mesh)[cells]]
    φ = mesh.ufl_domain().ufl_coordinate_element().sub_elements[0].tabulate(0, points)[0]
    return np.einsum("qn,cnd->cqd", φ, nodes)[:, :, : mesh.geometry.dim]
