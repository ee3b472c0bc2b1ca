# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Values in cells at vertices and midpoints, and means by a quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal
from problems import Cell, cube

import basix
import ufl

from dolfinx_feti.fem import cell_samples
from dolfinx_feti.fem.cell_samples import CellSamples, sample_points
from dolfinx_feti.fem.compiler import Compiler

#: Vertices, edges, faces and cell.
PARTS = {
    "interval": 3,
    "triangle": 7,
    "quadrilateral": 9,
    "tetrahedron": 15,
    "hexahedron": 27,
    "prism": 21,
}


@pytest.mark.serial
@pytest.mark.parametrize("name", PARTS)
def test_sample_points_lie_inside_the_cell(name):
    """The sample points of a cell are inside, near its vertices and edge midpoints."""
    cell = getattr(basix.CellType, name)
    corners = np.asarray(basix.geometry(cell))
    points = sample_points(cell, 2)
    assert len(points) == PARTS[name] == len(np.unique(points.round(3), axis=0))
    for corner in (*corners, corners.mean(axis=0)):
        assert np.abs(points - corner).max(axis=1).min() <= 2e-5, corner
    assert len(sample_points(cell, 3)) > len(points)
    assert points.min() > 0.0


@pytest.mark.parametrize("at_once", [3, 1000])
@pytest.mark.parametrize("kind", [Cell.triangle, Cell.quadrilateral])
def test_values_of_a_linear_function(kind, at_once, monkeypatch):
    """Extrema of a linear function are at vertices and its mean at the midpoint.

    The number of cells that are evaluated at once does not matter.
    """
    monkeypatch.setattr(cell_samples, "SAMPLED_CELLS_AT_ONCE", at_once)
    mesh = cube(2, 3, kind)
    x = ufl.SpatialCoordinate(mesh)
    samples = CellSamples(x[0] + 10 * x[1], mesh, Compiler(COMM), degree=2, quadrature_degree=2)
    found = samples.evaluate()
    n_cells = mesh.topology.index_map(2).size_local
    corners = mesh.geometry.x[mesh.geometry.dofmap[:n_cells]]
    values = corners[..., 0] + 10 * corners[..., 1]
    agree(len(found.minimum) == n_cells)
    equal(found.minimum, values.min(axis=1), 1e-4)
    equal(found.maximum, values.max(axis=1), 1e-4)
    equal(found.mean, values.mean(axis=1), 1e-12)
