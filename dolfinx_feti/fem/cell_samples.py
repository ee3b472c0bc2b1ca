# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Smallest, mean and largest value of a scalar in each cell, at points inside the cell.

The points are those of a quadrature, which define the mean
:math:`\sum_q w_q f(ξ_q) / \sum_q w_q`. A scalar that is positive there may be negative between
them, so there are two further sets of points:

- the midpoints of all entities of a cell: vertices, edges, faces, and the cell,
- the nodes of a Lagrange element of the unknown's degree, if that is higher than two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import basix
import dolfinx
from ufl.core.expr import Expr

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime.arrays import Array

#: Share of their distance by which points are moved towards the midpoint of the cell, because on
#: the axis of an axisymmetric body u/r is 0/0. Near the axis u/r has about five digits: FFCx rounds
#: values of basis functions below 1e-9 to zero, among them products of two barycentric coordinates
#: of this size. A larger shift gives u/r more digits, but other scalars change by about that share.
INWARD_SHIFT = 1e-5

#: Midpoints are the nodes of elements up to this degree.
MIDPOINT_DEGREE = 2

#: Cells that are evaluated together: a memory bound, some 10 MiB of values. With ten times as many
#: cells at once, the evaluation of a mesh takes as long.
SAMPLED_CELLS_AT_ONCE = 50_000


@dataclass(frozen=True, slots=True)
class CellValues:
    """Values of a scalar in the owned cells.

    A cell with NaN at one point has NaN in all three arrays.

    Attributes:
        minimum: Smallest value, (n_cells,).
        mean: Mean by the quadrature, (n_cells,).
        maximum: Largest value, (n_cells,).
    """

    minimum: Array
    mean: Array
    maximum: Array


class CellSamples:
    """A scalar expression at points of all owned cells of a mesh."""

    def __init__(
        self,
        expression: Expr,
        mesh: dolfinx.mesh.Mesh,
        compiler: Compiler,
        *,
        degree: int,
        quadrature_degree: int,
    ) -> None:
        """Compile the expression. Collective.

        Args:
            expression: A scalar.
            mesh: Its mesh.
            compiler: Compiler of the problem.
            degree: Degree of the unknown.
            quadrature_degree: Degree of the quadrature.

        Raises:
            ValueError: The expression has no values at these points; on all processes.
        """
        self._mesh = mesh
        cell = mesh.basix_cell()
        points, weights = basix.make_quadrature(cell, quadrature_degree)
        self._weights = np.asarray(weights) / np.sum(weights)
        all_points = np.vstack([points, sample_points(cell, degree)])
        self._compiled = compiler.expression(expression, all_points)

    def evaluate(self) -> CellValues:
        """Return the values at the present state, without communication."""
        dim = self._mesh.topology.dim
        n_cells = self._mesh.topology.index_map(dim).size_local
        minimum = np.empty(n_cells)
        mean = np.empty(n_cells)
        maximum = np.empty(n_cells)
        for first in range(0, n_cells, SAMPLED_CELLS_AT_ONCE):
            chunk = slice(first, min(first + SAMPLED_CELLS_AT_ONCE, n_cells))
            cells = np.arange(chunk.start, chunk.stop, dtype=np.int32)
            values = np.asarray(self._compiled.eval(self._mesh, cells)).reshape(len(cells), -1)
            minimum[chunk] = values.min(axis=1)
            mean[chunk] = values[:, : len(self._weights)] @ self._weights
            maximum[chunk] = values.max(axis=1)
        return CellValues(minimum, mean, maximum)


def sample_points(cell: basix.CellType, degree: int) -> Array:
    """Return midpoints of the entities of a reference cell, and nodes of a degree, moved inwards.

    Args:
        cell: The reference cell.
        degree: Degree of the nodes; up to two they are the midpoints.

    Returns:
        The points, (points, dimension).
    """
    corners = np.asarray(basix.geometry(cell), dtype=np.float64)
    entities = [entity for of_dimension in basix.topology(cell) for entity in of_dimension]
    points = np.array([corners[entity].mean(axis=0) for entity in entities])
    if degree > MIDPOINT_DEGREE:
        equispaced = basix.LatticeType.equispaced
        nodes = basix.create_lattice(cell, degree, equispaced, True)
        points = np.vstack([points, np.asarray(nodes, dtype=np.float64)])
    return points + INWARD_SHIFT * (corners.mean(axis=0) - points)
