# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Patches: from values inside the cells to fields that are continuous in each layer.

In the patch of a vertex v a cell K of the layer has its volume times the number of ways K – w – K'
– v over vertices w as its weight, from A Aᵀ A with the incidence A of vertices and cells. A linear
function is fitted there (Zienkiewicz and Zhu 1992), and fits are blended with hat functions φ_v,

.. math:: \mathcal R f = \sum_v φ_v \, (\bar f_v + G_v (x - \bar x_v)), \qquad
          G_v = \operatorname{cov}(f, x) \operatorname{cov}(x, x)^+ .

Sweeps f* ← f* + R(f − f*) put back what is smoothed away. The data are values inside the cells, or
means over them with the centroid for x (docs/stresses.md).
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

__all__ = ["Patches", "create_patches", "moments", "recover"]

#: Number of cells whose values at the quadrature points are in memory at once.
CHUNK = 4096

#: A patch is flat in the directions where its variance is below this fraction of the largest one.
FLAT_PATCH = 1e-9


@dataclass(frozen=True, slots=True)
class Patches:
    """The n_v vertices of the layers, a copy for each, and the n_c owned cells around them."""

    mesh: dolfinx.mesh.Mesh
    layers: int  #: Number of layers
    rows: Numbers  #: Vertices of each cell in the cell's layer, (n_c, d + 1)
    matrix: scipy.sparse.csr_array  #: A, (n_v, n_c)
    points: Array  #: Quadrature points of the reference cell, (n_q, d)
    weights: Array  #: From values f there to means of f and f (X − X̄), (1 + d, n_q)

    def around(self, values: Array) -> Array:
        """Sum values of the cells over those at a vertex, of all processes, (n_v, k)."""
        vertices = self.mesh.topology.index_map(0)
        vector = dolfinx.la.vector(vertices, self.layers * values.shape[1])
        vector.array[:] = (self.matrix @ values).ravel()
        vector.scatter_reverse(dolfinx.la.InsertMode.add)
        vector.scatter_forward()
        return np.array(vector.array).reshape(-1, values.shape[1])

    def sums(self, values: Array) -> Array:
        """Sum values of the cells over the patches, A Aᵀ A, (n_v, k)."""
        return self.around(self.matrix.T @ self.around(values))


def create_patches(
    mesh: dolfinx.mesh.Mesh, layers: dolfinx.mesh.MeshTags | None = None, *, degree: int = 4
) -> Patches:
    """Find the patches of a mesh; fields are recovered where it is then, if it moves. Collective.

    Args:
        mesh: Triangles in the plane or tetrahedra, with straight edges.
        layers: The layer of each cell; if not given, all cells are one layer.
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
    layer, count = _layer_of_cells(mesh, layers)
    of_cells = mesh.topology.connectivity(dim, 0).array.reshape(-1, dim + 1)[: len(layer)]
    rows = of_cells.astype(np.int64) * count + layer[:, None]
    entries = (np.ones(rows.size), (rows.ravel(), np.repeat(np.arange(len(rows)), dim + 1)))
    shape = ((vertices.size_local + vertices.num_ghosts) * count, len(rows))
    rule = basix.make_quadrature(getattr(basix.CellType, cell), degree)
    points, w = (np.asarray(array, dtype=np.float64) for array in rule)
    weights = np.vstack([np.ones(len(points)), (points - 1.0 / (dim + 1)).T]) * w / w.sum()
    matrix = scipy.sparse.csr_array(entries, shape=shape)
    return Patches(mesh, count, rows, matrix, points, weights)


def moments(expression: Expr, patches: Patches) -> Array:
    """Return means of f, and of f times the reference coordinates relative to the centroid.

    The shape is (n_c, 1 + d, components). An expression of another mesh is a ValueError, one that
    is not finite an ArithmeticError. Collective.
    """
    mesh = patches.mesh
    n_cells = len(patches.rows)
    size = int(np.prod(expression.ufl_shape))
    integrals = np.zeros((n_cells, len(patches.weights), size))
    wrong = 0
    on_mesh = dolfinx.fem.Constant(mesh, np.float64(1.0)) * expression  # a number knows no mesh
    domains = extract_domains(on_mesh)
    if any(domain != mesh.ufl_domain() for domain in domains):
        raise ValueError(
            "The expression does not live on the mesh of the patches: create the patches with the "
            "mesh of the functions in the expression."
        )
    if not domains:  # UFL knows that it is zero
        return integrals
    compiled = Compiler(mesh.comm).expression(on_mesh, patches.points)
    for first in range(0, n_cells, CHUNK):
        cells = np.arange(first, min(first + CHUNK, n_cells), dtype=np.int32)
        values = np.asarray(compiled.eval(mesh, cells)).reshape(len(cells), -1, size)
        wrong += int((~np.isfinite(values)).any(axis=(1, 2)).sum())
        with np.errstate(invalid="ignore"):
            integrals[cells] = patches.weights @ values
    wrong = mesh.comm.allreduce(wrong)
    if wrong:
        raise ArithmeticError(
            f"The expression is NaN or infinite in {wrong} cells: evaluate it in an admissible "
            "state, with det F > 0."
        )
    return integrals


def recover(patches: Patches, data: Array, *, means: bool, sweeps: int) -> Array:
    """Fit a field that is continuous in each layer to moments of a field. Collective.

    Args:
        patches: The patches.
        data: Moments of the field in each cell, from :func:`moments`, (n_c, rows, components).
        means: Whether the means over the cells are fitted, not the values inside them.
        sweeps: Number of fits, each to the remainder of those before.

    Returns:
        Values at the nodes of the discontinuous quadratic element, (n_c, nodes, components).
    """
    mesh = patches.mesh
    n_cells, n_rows, size = data.shape
    dim = n_rows - 1
    corners = mesh.geometry.x[geometry_dofmap(mesh)[:n_cells], :dim]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)  # dx/dX
    volumes = np.abs(np.linalg.det(edges))[:, None] / math.factorial(dim)
    x = corners.mean(axis=1)
    second = x[:, :, None] * x[:, None]
    if not means:
        second += edges @ (patches.weights[1:] @ patches.points) @ np.swapaxes(edges, 1, 2)
    values = np.column_stack([np.ones(n_cells), x, second.reshape(n_cells, dim**2)])
    total = patches.sums(volumes * values)
    volume = np.where(total[:, :1] > 0, total[:, :1], 1.0)  # a vertex may have no cell in a layer
    centre, second = np.split(total[:, 1:] / volume, [dim], axis=1)
    covariance = second.reshape(-1, dim, dim) - centre[:, :, None] * centre[:, None]
    inverse = np.linalg.pinv(covariance, rcond=FLAT_PATCH, hermitian=True)  # cov(x, x)⁺

    space = dolfinx.fem.functionspace(mesh, ("DG", 2))
    nodes = interpolation_points(space)
    φ = space.element.basix_element.tabulate(0, patches.points)[0, :, :, 0]
    to_moments = patches.weights @ φ
    hats = np.column_stack([1.0 - nodes.sum(axis=1), nodes])
    x_nodes = hats @ corners
    field = np.zeros((n_cells, len(nodes), size))
    for _ in range(sweeps):
        remainder = data - to_moments @ field
        product = x[:, :, None] * remainder[:, :1]  # means of x f
        if not means:
            product += edges @ remainder[:, 1:]
        rows = np.concatenate([remainder[:, :1], product], axis=1)
        parts = rows.reshape(n_cells, n_rows * size)
        fits = (patches.sums(volumes * parts) / volume).reshape(-1, n_rows, size)
        mean = fits[:, :1]
        product = fits[:, 1:]
        slope = inverse @ (product - centre[:, :, None] * mean)  # cov(x, x)⁺ cov(x, f)
        for hat, v in zip(hats.T, patches.rows.T, strict=True):  # f* += Σ φ_v (m_v + G_v (x − x̄_v))
            field += hat[:, None] * (mean[v] + (x_nodes - centre[v, None]) @ slope[v])
    return field


def _layer_of_cells(
    mesh: dolfinx.mesh.Mesh, layers: dolfinx.mesh.MeshTags | None
) -> tuple[Numbers, int]:
    """Return the layer of each owned cell, from 0, and the number of layers."""
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
