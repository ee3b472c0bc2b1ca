# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Surfaces of bodies for pictures: areas, closedness and values, for any partition."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, small

import dolfinx
import ufl

from dolfinx_feti.output.surfaces import BodySurface, gather_surface

CELLS = {
    "triangle": dolfinx.mesh.CellType.triangle,
    "quadrilateral": dolfinx.mesh.CellType.quadrilateral,
    "tetrahedron": dolfinx.mesh.CellType.tetrahedron,
    "hexahedron": dolfinx.mesh.CellType.hexahedron,
}


def create_body(cell: str) -> dolfinx.mesh.Mesh:
    """Return the unit square or cube, with a vertex at a multiple of 2⁻⁹."""
    kind = CELLS[cell]
    if cell in ("triangle", "quadrilateral"):
        return dolfinx.mesh.create_unit_square(COMM, 4, 4, cell_type=kind)
    return dolfinx.mesh.create_unit_cube(COMM, 4, 4, 4, cell_type=kind)


def areas(surface: BodySurface) -> np.ndarray:
    """Return the area vectors of the triangles, (t, 3)."""
    x = surface.points[surface.triangles]
    return np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) / 2


def from_root(value: float | None) -> float:
    return COMM.bcast(value, root=0)


@pytest.mark.parametrize("cell", CELLS)
def test_area_of_a_body(cell):
    """The square has the area 1 and the cube 6, for any partition."""
    surface = gather_surface(create_body(cell), None, None)
    agree((surface is None) == (COMM.rank > 0))
    area = from_root(None if surface is None else np.linalg.norm(areas(surface), axis=1).sum())
    small(area - (1.0 if cell in ("triangle", "quadrilateral") else 6.0), 1e-12)


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_outside_is_on_the_left_hand_turn(cell):
    """Triangles are oriented outwards, so that the divergence theorem gives each volume."""
    mesh = create_body(cell)
    n_cells = mesh.topology.index_map(3).size_local
    one = COMM.rank * np.ones(n_cells, dtype=np.int64)
    for part in (None, one):
        surface = gather_surface(mesh, None, None, part=part)
        volume = None
        if surface is not None:
            middles = surface.points[surface.triangles].mean(axis=1)
            volume = np.einsum("ti,ti->", areas(surface), middles) / 3
        small(from_root(volume) - 1.0, 1e-12)


@pytest.mark.parametrize("cell", CELLS)
def test_displacement_and_values_are_exact_at_the_points(cell):
    """Quadratic fields are exact at the points of a surface."""
    mesh = create_body(cell)
    gdim = mesh.geometry.dim
    x = ufl.SpatialCoordinate(mesh)
    u = ufl.as_vector([x[0] ** 2] + [0.0] * (gdim - 1))
    surface = gather_surface(mesh, x[0] + x[0] ** 2, u)
    error = None
    if surface is not None:
        error = np.abs(surface.points[:, 0] - surface.values).max()
    small(from_root(error), 1e-12)


def test_points_are_shared_inside_of_a_part_alone():
    """Cells of one part share their points, and cells of different parts do not."""
    mesh = create_body("quadrilateral")
    surface = gather_surface(mesh, None, None)
    agree(from_root(None if surface is None else len(surface.points)) == 81)
    n_cells = mesh.topology.index_map(2).size_local
    middles = dolfinx.mesh.compute_midpoints(mesh, 2, np.arange(n_cells, dtype=np.int32))
    left = middles[:, 0] < 0.5
    surface = gather_surface(mesh, None, None, part=left.astype(np.int64))
    agree(from_root(None if surface is None else len(surface.points)) == 2 * 45)


def test_vectors_in_the_plane_get_a_third_component():
    """Vectors in the plane get a third component of zero."""
    mesh = create_body("triangle")
    surface = gather_surface(mesh, ufl.as_vector([1.0, 2.0]) * ufl.SpatialCoordinate(mesh)[0], None)
    agree(surface is None or surface.values.shape[1] == 3)


def test_part_of_a_body():
    """The surface of half a cube has the area 2 + 4/2."""
    mesh = create_body("tetrahedron")
    n_cells = mesh.topology.index_map(3).size_local
    middles = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(n_cells, dtype=np.int32))
    surface = gather_surface(mesh, None, None, mask=middles[:, 2] < 0.5)
    area = from_root(None if surface is None else np.linalg.norm(areas(surface), axis=1).sum())
    small(area - 4.0, 1e-12)


def test_faces_that_do_not_share_their_points():
    """A field that jumps keeps its value in each cell, if faces share no points."""
    mesh = create_body("quadrilateral")
    jumping = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    jumping.interpolate(lambda x: np.where(x[0] < 0.5, 1.0, 2.0))
    surface = gather_surface(mesh, jumping, None, is_continuous=False)
    agree(surface is None or set(surface.values) == {1.0, 2.0})
    agree(from_root(None if surface is None else len(surface.points)) == 16 * 9)
