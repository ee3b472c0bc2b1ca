# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Patches: from values inside the cells to fields that are continuous in each layer.

A linear function is fitted to a field in the patch of each vertex (Zienkiewicz and Zhu 1992), and
the fits are blended with the hat functions φ_v of the vertices:

.. math:: \mathcal R f = \sum_v φ_v \, (\bar f_v + G_v (x - \bar x_v)), \qquad
          G_v = \operatorname{cov}(f, x) \operatorname{cov}(x, x)^+ .

The patch of v consists of the cells of one layer that share a vertex with a cell at v. In the fit,
the weight of a cell K is its volume times the number of pairs (w, K'), where w is a vertex of K and
K' a cell with the vertices w and v. This number is larger for cells near v. With the incidence A of
vertices and cells, the numbers are the entries of A Aᵀ A.

A fit smooths the field. Further sweeps f* ← f* + R(f − f*) restore what it has smoothed away. The
data are values inside the cells (:class:`FitToValues`), or means over cells, located at their
centroids (:class:`FitToMeans`; docs/stresses.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse

import basix
import dolfinx
from ufl.core.expr import Expr
from ufl.domain import extract_domains

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.compat import geometry_dofmap, interpolation_points

__all__ = ["FitToMeans", "FitToValues", "Patches", "create_patches", "moments"]

#: Number of cells that are evaluated at once: a memory bound, some 3 MiB for the values of a stress
#: at 11 points in each cell.
CELLS_AT_ONCE = 4096

#: Variance of a patch in a principal direction, over the largest one, below which the patch is
#: flat: its thickness is less than 3e-5 of its width. The fit has no slope in this direction.
FLAT_PATCH_RTOL = 1e-9


@dataclass(frozen=True, slots=True)
class Patches:
    """The patches of a mesh: each vertex has one for each layer.

    n_v is the number of patches of this process, including those of ghost vertices. n_c is the
    number of owned cells.

    Attributes:
        mesh: The mesh.
        n_layers: Number of layers.
        patches_of_cells: Patches of the d + 1 vertices of each cell, in its layer, (n_c, d + 1).
        incidence: A, with an entry 1 for a patch and each cell at its vertex, (n_v, n_c).
        points: Quadrature points of the reference cell, (n_q, d).
        to_moments: Maps values f at these points to the means of f and of f (ξ − ξ̄), with the
            reference coordinates ξ, (1 + d, n_q).
    """

    mesh: dolfinx.mesh.Mesh
    n_layers: int
    patches_of_cells: Numbers
    incidence: scipy.sparse.csr_array
    points: Array
    to_moments: Array

    def sum_at_vertices(self, values: Array) -> Array:
        """Return A f of cell values f, (n_c, k): the sums at each vertex, (n_v, k). Collective."""
        vertices = self.mesh.topology.index_map(0)
        vector = dolfinx.la.vector(vertices, self.n_layers * values.shape[1])
        vector.array[:] = (self.incidence @ values).ravel()
        vector.scatter_reverse(dolfinx.la.InsertMode.add)
        vector.scatter_forward()
        return np.array(vector.array).reshape(-1, values.shape[1])

    def sum_over_patches(self, values: Array) -> Array:
        """Return A Aᵀ A f of cell values f, (n_c, k): sums over patches, (n_v, k). Collective."""
        return self.sum_at_vertices(self.incidence.T @ self.sum_at_vertices(values))


def create_patches(
    mesh: dolfinx.mesh.Mesh, layers: dolfinx.mesh.MeshTags | None = None, *, degree: int = 4
) -> Patches:
    """Create the patches of a mesh. Collective.

    Patches depend on the topology of the mesh only. If the mesh moves, a recovery uses its current
    position.

    Args:
        mesh: Triangles in the plane or tetrahedra, with straight edges.
        layers: The layer of each cell; by default all cells are in one layer.
        degree: Quadrature degree inside the cells, 3 or more; 4 suits the stress of P2 elements.

    Raises:
        TypeError: The mesh has other cells.
        ValueError: A cell has no layer, the tags belong to another mesh or not to cells, or the
            degree is too low.
    """
    cell = mesh.topology.cell_name()
    nodes = geometry_dofmap(mesh).shape[1]
    if (cell, nodes, mesh.geometry.dim) not in (("triangle", 3, 2), ("tetrahedron", 4, 3)):
        raise TypeError(
            f"The mesh has cells of type {cell} with {nodes} nodes in {mesh.geometry.dim} "
            "dimensions, but patches are made for triangles in the plane and for tetrahedra, with "
            "straight edges."
        )
    if not degree >= 3:
        raise ValueError(f"degree={degree}: give a quadrature degree of 3 or more.")
    dim = mesh.topology.dim
    vertices = mesh.topology.index_map(0)
    layer, n_layers = _layer_of_cells(mesh, layers)
    vertices_of_cells = mesh.topology.connectivity(dim, 0).array.reshape(-1, dim + 1)[: len(layer)]
    patches_of_cells = vertices_of_cells.astype(np.int64) * n_layers + layer[:, None]
    rows = patches_of_cells.ravel()
    columns = np.repeat(np.arange(len(layer)), dim + 1)
    shape = ((vertices.size_local + vertices.num_ghosts) * n_layers, len(layer))
    incidence = scipy.sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=shape)
    rule = basix.make_quadrature(getattr(basix.CellType, cell), degree)
    points, w = (np.asarray(array, dtype=np.float64) for array in rule)
    from_centroid = points - 1.0 / (dim + 1)
    to_moments = np.vstack([np.ones(len(points)), from_centroid.T]) * w / w.sum()
    return Patches(mesh, n_layers, patches_of_cells, incidence, points, to_moments)


def moments(expression: Expr, patches: Patches) -> Array:
    """Return the means of f, and of f (ξ − ξ̄) with the reference coordinates ξ. Collective.

    Args:
        expression: f, of any shape.
        patches: Patches of its mesh.

    Returns:
        The means in each cell, (n_c, 1 + d, components): of f, [:, :1], and of f (ξ − ξ̄), [:, 1:].

    Raises:
        ValueError: The expression lives on another mesh.
        ArithmeticError: It is not finite in a cell.
    """
    mesh = patches.mesh
    n_cells = len(patches.patches_of_cells)
    size = int(np.prod(expression.ufl_shape))
    means = np.zeros((n_cells, len(patches.to_moments), size))
    not_finite = 0  # cells
    on_mesh = dolfinx.fem.Constant(mesh, np.float64(1.0)) * expression  # a number has no mesh
    domains = extract_domains(on_mesh)
    if any(domain != mesh.ufl_domain() for domain in domains):
        raise ValueError(
            "The expression does not live on the mesh of the patches: create the patches with the "
            "mesh of the functions in the expression."
        )
    if not domains:  # UFL has simplified the expression to zero
        return means
    compiled = Compiler(mesh.comm).expression(on_mesh, patches.points)
    for first in range(0, n_cells, CELLS_AT_ONCE):
        cells = np.arange(first, min(first + CELLS_AT_ONCE, n_cells), dtype=np.int32)
        values = np.asarray(compiled.eval(mesh, cells)).reshape(len(cells), -1, size)
        not_finite += int((~np.isfinite(values)).any(axis=(1, 2)).sum())
        with np.errstate(invalid="ignore"):
            means[cells] = patches.to_moments @ values
    not_finite = mesh.comm.allreduce(not_finite)
    if not_finite:
        raise ArithmeticError(
            f"The expression is NaN or infinite in {not_finite} cells: evaluate it in an "
            "admissible state, with det F > 0."
        )
    return means


class FitToMeans:
    """Linear functions, fitted in each patch to the means of a field at the centroids of cells.

    The positions are those of the mesh at the time when the object is created.
    """

    def __init__(self, patches: Patches) -> None:
        """Compute the positions of cells and patches. Collective."""
        mesh = patches.mesh
        n_cells = len(patches.patches_of_cells)
        dim = mesh.geometry.dim
        x = np.asarray(mesh.geometry.x, dtype=np.float64)
        self._patches = patches
        self._corners = x[geometry_dofmap(mesh)[:n_cells], :dim]  # (n_c, d + 1, d)
        first = self._corners[:, :1]
        self._jacobians = np.swapaxes(self._corners[:, 1:] - first, 1, 2)  # dx/dξ, (n_c, d, d)
        self._volumes = np.abs(np.linalg.det(self._jacobians))[:, None] / math.factorial(dim)
        self._centroids = self._corners.mean(axis=1)
        # means over the patches of 1, x and x xᵀ
        second = self._centroids[:, :, None] * self._centroids[:, None] + self._variance_in_cells()
        of_cells = np.column_stack(
            [np.ones(n_cells), self._centroids, second.reshape(n_cells, dim**2)]
        )
        sums = patches.sum_over_patches(self._volumes * of_cells)
        # a vertex may have no cell of a layer
        self._patch_volumes = np.where(sums[:, :1] > 0, sums[:, :1], 1.0)
        self._centres, second = np.split(sums[:, 1:] / self._patch_volumes, [dim], axis=1)
        covariance = (
            second.reshape(-1, dim, dim) - self._centres[:, :, None] * self._centres[:, None]
        )
        self._inverses = np.linalg.pinv(covariance, rcond=FLAT_PATCH_RTOL, hermitian=True)

    def recover(self, data: Array, *, sweeps: int) -> Array:
        """Return a field that is continuous in each layer, fitted to moments. Collective.

        Args:
            data: Moments of the field in each cell, from :func:`moments`, (n_c, 1 + d, components).
            sweeps: Number of fits. Each is a fit to what the earlier ones have left.

        Returns:
            Values at the nodes of the discontinuous quadratic element, (n_c, nodes, components).
        """
        patches = self._patches
        space = dolfinx.fem.functionspace(patches.mesh, ("DG", 2))
        nodes = interpolation_points(space)
        φ = space.element.basix_element.tabulate(0, patches.points)[0, :, :, 0]
        nodes_to_moments = patches.to_moments @ φ
        hats = np.column_stack([1.0 - nodes.sum(axis=1), nodes])  # at the nodes, (nodes, d + 1)
        x_nodes = hats @ self._corners
        field = np.zeros((len(data), len(nodes), data.shape[2]))
        for _ in range(sweeps):
            mean, slope = self._fit(data - nodes_to_moments @ field)
            # f* += Σ φ_v (m_v + G_v (x − x̄_v)) over the vertices v of each cell
            for hat, v in zip(hats.T, patches.patches_of_cells.T, strict=True):
                linear = mean[v] + (x_nodes - self._centres[v, None]) @ slope[v]
                field += hat[:, None] * linear
        return field

    def _fit(self, data: Array) -> tuple[Array, Array]:
        """Fit a linear function in each patch. Collective.

        Args:
            data: Moments of a field in each cell, (n_c, 1 + d, components).

        Returns:
            Means f̄_v, (n_v, 1, components), and slopes G_v, transposed, (n_v, d, components).
        """
        n_cells, n_moments, size = data.shape
        products = self._centroids[:, :, None] * data[:, :1] + self._covariance_in_cells(data)
        of_cells = np.concatenate([data[:, :1], products], axis=1)  # means of f and x f
        weighted = self._volumes * of_cells.reshape(n_cells, n_moments * size)
        sums = self._patches.sum_over_patches(weighted) / self._patch_volumes
        of_patches = sums.reshape(-1, n_moments, size)
        mean = of_patches[:, :1]
        covariance = of_patches[:, 1:] - self._centres[:, :, None] * mean
        return mean, self._inverses @ covariance  # cov(x, x)⁺ cov(x, f)

    def _variance_in_cells(self) -> Array | float:
        """Return cov(x, x) over each cell, (n_c, d, d): zero, as a mean counts at one point."""
        return 0.0

    def _covariance_in_cells(self, data: Array) -> Array | float:
        """Return cov(x, f) over each cell, (n_c, d, components): zero, as above.

        Args:
            data: Moments of the field in each cell, (n_c, 1 + d, components).
        """
        return 0.0


class FitToValues(FitToMeans):
    """Linear functions, fitted in each patch to the values of a field inside the cells."""

    def _variance_in_cells(self) -> Array | float:
        """Return cov(x, x) over each cell, (n_c, d, d)."""
        in_reference = self._patches.to_moments[1:] @ self._patches.points  # cov(ξ, ξ)
        return np.asarray(self._jacobians @ in_reference @ np.swapaxes(self._jacobians, 1, 2))

    def _covariance_in_cells(self, data: Array) -> Array | float:
        """Return cov(x, f) over each cell, (n_c, d, components)."""
        return np.asarray(self._jacobians @ data[:, 1:])


def _layer_of_cells(
    mesh: dolfinx.mesh.Mesh, layers: dolfinx.mesh.MeshTags | None
) -> tuple[Numbers, int]:
    """Return the layer of each owned cell, from 0, (n_c,), and the number of layers. Collective.

    Raises:
        ValueError: The tags belong to another mesh or not to cells, or a cell has no tag.
    """
    n_cells = mesh.topology.index_map(mesh.topology.dim).size_local
    layer = np.zeros(n_cells, dtype=np.int64)
    if layers is None:
        return layer, 1
    if layers.dim != mesh.topology.dim or layers.topology != mesh._cpp_object.topology:
        raise ValueError(
            f"layers are tags of dimension {layers.dim}, or of another mesh: give the tags of the "
            "cells of this mesh."
        )
    owned = layers.indices < n_cells
    untagged = np.ones(n_cells, dtype=np.bool_)
    untagged[layers.indices[owned]] = False
    missing = mesh.comm.allreduce(int(untagged.sum()))
    if missing:
        raise ValueError(f"layers: {missing} cells have no tag; give each cell its layer.")
    tags = np.unique(np.concatenate(mesh.comm.allgather(np.unique(layers.values[owned]))))
    layer[layers.indices[owned]] = np.searchsorted(tags, layers.values[owned])
    return layer, len(tags)
