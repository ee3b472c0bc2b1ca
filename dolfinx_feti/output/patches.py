# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Patches: from values inside the cells to fields that are continuous in each layer.

A patch consists of the cells of one layer near a vertex v: a cell K has the weight of its volume
times the number of ways K – w – K' – v over a vertex w that K shares with a cell K' at v. With A,
the incidence of the vertices and cells of the layer, these numbers are the rows of A Aᵀ A, so that
sums over patches are made of sums over the cells at a vertex. On each patch a linear function is
fitted to f by least squares (Zienkiewicz and Zhu 1992),

.. math:: \min_{m_v, G_v} \int_{P_v} |m_v + G_v (x - \bar x_v) - f|^2, \qquad
          m_v = \bar f_v, \quad G_v = \operatorname{cov}(f, x) \operatorname{cov}(x, x)^+,

and the fits are blended with the hat functions φ_v of the vertices,

.. math:: \mathcal R f = \sum_v φ_v \, (m_v + G_v (x - \bar x_v)),

quadratic in each cell, continuous in each layer, and equal to f if f is linear in each layer. A few
sweeps f* ← f* + R(f − f*) put back what the blending has smoothed away.

The data are the values of f inside the cells, or its means over the cells only: then the centroid
of a cell stands for x, and the mean for f.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import scipy.sparse

import basix
import dolfinx
from ufl.core.expr import Expr
from ufl.domain import extract_domains

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.compat import geometry_dofmap, interpolation_points

__all__ = ["Incidence", "Patches", "Scatter", "create_patches", "moments", "present", "recover"]


#: Number of cells whose values at the quadrature points are in memory at once.
CHUNK = 4096

#: A patch is flat in the directions where its variance is below this fraction of the largest one.
FLAT_PATCH = 1e-9


@dataclass(frozen=True, slots=True)
class Incidence:
    """The n_v vertices of the layers, a copy for each layer, and the n_c owned cells around them.

    Attributes:
        vertices: dolfinx's vertices.
        layers: Number of layers.
        rows: The vertices of each cell in the cell's layer, (n_c, d + 1).
        matrix: A, (n_v, n_c).
    """

    vertices: dolfinx.common.IndexMap
    layers: int
    rows: Numbers
    matrix: scipy.sparse.csr_array

    def around(self, values: Array) -> Array:
        """Sum values of the cells over those at a vertex, of all processes, (n_v, k)."""
        vector = dolfinx.la.vector(self.vertices, self.layers * values.shape[1])
        vector.array[:] = (self.matrix @ values).ravel()
        vector.scatter_reverse(dolfinx.la.InsertMode.add)
        vector.scatter_forward()
        return np.array(vector.array).reshape(-1, values.shape[1])

    def over_patches(self, values: Array) -> Array:
        """Sum values of the cells over the patches, A Aᵀ A, (n_v, k)."""
        return self.around(self.matrix.T @ self.around(values))


@dataclass(frozen=True, slots=True)
class Scatter:
    """Where the data of each patch lie: Σ weights (n_v, 1), centroid x̄ (n_v, d), cov(x, x)⁺."""

    volume: Array
    centre: Array
    inverse: Array


@dataclass(frozen=True, slots=True)
class Patches:
    """The patches of a mesh, and the quadrature inside its owned cells.

    Attributes:
        mesh: The mesh.
        incidence: Vertices and cells of the layers.
        corners: The vertices of each cell, (n_c, d + 1, d).
        volumes: Volumes of the cells, (n_c,).
        points: Quadrature points of the reference cell, (n_q, d).
        weights: Maps values at these points to their mean and to the means of the values times the
            reference coordinates relative to the centroid, (1 + d, n_q).
        inside: Scatter of the values inside the cells.
        means: Scatter of the means over the cells.
    """

    mesh: dolfinx.mesh.Mesh
    incidence: Incidence
    corners: Array
    volumes: Array
    points: Array
    weights: Array
    inside: Scatter
    means: Scatter


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
    _check_mesh(mesh)
    if not degree >= 3:
        raise ValueError(f"degree={degree}: give a quadrature degree of 3 or more.")
    dim = mesh.topology.dim
    incidence = _create_incidence(mesh, *_layer_of_cells(mesh, layers))
    rule = basix.make_quadrature(getattr(basix.CellType, mesh.topology.cell_name()), degree)
    points, w = (np.asarray(array, dtype=np.float64) for array in rule)
    weights = np.vstack([np.ones(len(points)), (points - 1.0 / (dim + 1)).T]) * w / w.sum()
    return _measured(mesh, incidence, points, weights)


def present(patches: Patches) -> Patches:
    """Return the patches of the mesh where it is now, for it may have moved. Collective."""
    same = np.array_equal(_corners(patches.mesh, patches.incidence), patches.corners)
    if patches.mesh.comm.allreduce(same, op=MPI.LAND):
        return patches
    return _measured(patches.mesh, patches.incidence, patches.points, patches.weights)


def _corners(mesh: dolfinx.mesh.Mesh, incidence: Incidence) -> Array:
    """Return the vertices of the owned cells, (n_c, d + 1, d)."""
    nodes = geometry_dofmap(mesh)[: len(incidence.rows)]
    return np.asarray(mesh.geometry.x[nodes, : mesh.topology.dim], dtype=np.float64)


def _measured(
    mesh: dolfinx.mesh.Mesh, incidence: Incidence, points: Array, weights: Array
) -> Patches:
    """Measure the cells of the patches. Collective."""
    corners = _corners(mesh, incidence)
    edges = _edges(corners)
    volumes = np.abs(np.linalg.det(edges)) / math.factorial(mesh.topology.dim)
    inner = edges @ (weights[1:] @ points) @ np.swapaxes(edges, 1, 2)  # dx/dX cov(X, X) dx/dXᵀ
    inside, means = (
        _scatter(incidence, corners.mean(axis=1), volumes, covariance)
        for covariance in (inner, np.zeros_like(inner))
    )
    return Patches(mesh, incidence, corners, volumes, points, weights, inside, means)


def moments(expression: Expr, patches: Patches) -> Array:
    """Evaluate an expression of m components in the owned cells. Collective.

    Returns in each cell its mean, and the means of the expression times the reference coordinates
    relative to the centroid, (n_c, 1 + d, m). An expression of another mesh is a ValueError, one
    that is not finite somewhere an ArithmeticError.
    """
    mesh, n_cells = patches.mesh, len(patches.volumes)
    size = int(np.prod(expression.ufl_shape))
    integrals, wrong = np.zeros((n_cells, len(patches.weights), size)), 0
    one = dolfinx.fem.Constant(mesh, np.float64(1.0))
    on_mesh = one * expression  # a constant alone knows no mesh
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
    """Fit a field that is continuous in each layer to what :func:`moments` returns. Collective.

    ``means`` fits the means over the cells, not the values inside them; each of the sweeps fits
    what those before it leave. Returns values at the nodes of the discontinuous quadratic element,
    (n_c, nodes, m).
    """
    space = dolfinx.fem.functionspace(patches.mesh, ("DG", 2))
    nodes = interpolation_points(space)
    φ = space.element.basix_element.tabulate(0, patches.points)[0, ..., 0]
    to_moments = patches.weights @ φ
    field = np.zeros((len(data), len(nodes), data.shape[2]))
    for _ in range(sweeps):
        field += _blend(patches, data - to_moments @ field, nodes, means=means)  # f* += R(f − f*)
    return field


def _blend(patches: Patches, data: Array, nodes: Array, *, means: bool) -> Array:
    """Return Σ_v φ_v (m_v + G_v (x − x̄_v)) at the nodes of the owned cells, (n_c, nodes, m)."""
    scatter = patches.means if means else patches.inside
    n_cells, n_rows, size = data.shape
    product = patches.corners.mean(axis=1)[:, :, None] * data[:, :1]  # means of x f
    if not means:
        product += _edges(patches.corners) @ data[:, 1:]
    sums = patches.incidence.over_patches(
        patches.volumes[:, None]
        * np.concatenate([data[:, :1], product], axis=1).reshape(n_cells, n_rows * size)
    )
    mean, product = np.split((sums / scatter.volume).reshape(-1, n_rows, size), [1], axis=1)
    slope = scatter.inverse @ (product - scatter.centre[:, :, None] * mean)  # cov(x, x)⁺ cov(x, f)
    hats = np.column_stack([1.0 - nodes.sum(axis=1), nodes])
    x = hats @ patches.corners
    field = np.zeros((n_cells, len(nodes), size))
    for hat, v in zip(hats.T, patches.incidence.rows.T, strict=True):
        field += hat[:, None] * (mean[v] + (x - scatter.centre[v, None]) @ slope[v])
    return field


def _scatter(incidence: Incidence, x: Array, volumes: Array, inner: Array) -> Scatter:
    """Sum up where the data lie: centroids x, (n_c, d), and cov(x, x) in each cell, (n_c, d, d)."""
    second = (x[:, :, None] * x[:, None] + inner).reshape(len(x), x.shape[1] ** 2)
    sums = incidence.over_patches(volumes[:, None] * np.column_stack([np.ones(len(x)), x, second]))
    volume = np.where(sums[:, :1] > 0, sums[:, :1], 1.0)  # a vertex may have no cell in a layer
    centre, product = np.split(sums[:, 1:] / volume, [x.shape[1]], axis=1)
    covariance = product.reshape(-1, *inner.shape[1:]) - centre[:, :, None] * centre[:, None]
    return Scatter(volume, centre, np.linalg.pinv(covariance, rcond=FLAT_PATCH, hermitian=True))


def _create_incidence(mesh: dolfinx.mesh.Mesh, layer: Numbers, layers: int) -> Incidence:
    """Number the vertices of each layer on their own; layers of owned cells count from 0."""
    dim = mesh.topology.dim
    vertices = mesh.topology.index_map(0)
    of_cells = mesh.topology.connectivity(dim, 0).array.reshape(-1, dim + 1)[: len(layer)]
    rows = of_cells.astype(np.int64) * layers + layer[:, None]
    columns = np.repeat(np.arange(len(rows)), dim + 1)
    shape = ((vertices.size_local + vertices.num_ghosts) * layers, len(rows))
    matrix = scipy.sparse.csr_array((np.ones(rows.size), (rows.ravel(), columns)), shape=shape)
    return Incidence(vertices, layers, rows, matrix)


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


def _check_mesh(mesh: dolfinx.mesh.Mesh) -> None:
    """Require simplices with straight edges that fill their space."""
    cell, nodes = mesh.topology.cell_name(), geometry_dofmap(mesh).shape[1]
    if (cell, nodes, mesh.geometry.dim) not in (("triangle", 3, 2), ("tetrahedron", 4, 3)):
        raise TypeError(
            f"The mesh has cells of type {cell} with {nodes} nodes in {mesh.geometry.dim} "
            "dimensions, but patches are made for triangles in the plane and for tetrahedra, with "
            "straight edges. The stress of other cells is recovered by balanced_stress."
        )


def _edges(corners: Array) -> Array:
    """Return dx/dX of the cells, (n_c, d, d); its columns are the edges at the first vertex."""
    return np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
