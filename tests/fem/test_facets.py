# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""``one_side`` selects one side of interior facets, for any numbering of the cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from collective import COMM, agree, raises, small

import dolfinx
import ufl

from dolfinx_feti.fem.facets import _side_labels, one_side

Cell = dolfinx.mesh.CellType
Ghosts = dolfinx.mesh.GhostMode
Points = np.ndarray

#: Stiffness inside and outside of a surface.
INSIDE = 5.0
OUTSIDE = 1.0


@dataclass(frozen=True)
class Shape:
    """A surface in the unit square or cube, on which a function of place is zero.

    Attributes:
        cell: Type of the cells.
        signed: Distance, negative inside; vertices of the mesh lie on its zeros.
        size: Length or area of the surface.
        moved: Maps the points of the mesh after its facets are chosen; None leaves them.
    """

    cell: Cell
    signed: Callable[[Points], Points]
    size: float
    moved: Callable[[Points], Points] | None = None

    def mesh(self, ghosts: Ghosts = Ghosts.shared_facet) -> dolfinx.mesh.Mesh:
        if self.cell in (Cell.triangle, Cell.quadrilateral):
            return dolfinx.mesh.create_unit_square(COMM, 8, 8, self.cell, ghost_mode=ghosts)
        return dolfinx.mesh.create_unit_cube(COMM, 4, 4, 4, self.cell, ghost_mode=ghosts)

    def parts(self, ghosts: Ghosts = Ghosts.shared_facet):
        """Return mesh, facets of the surface, and cells inside."""
        mesh = self.mesh(ghosts)
        tdim = mesh.topology.dim
        facets = dolfinx.mesh.locate_entities(
            mesh, tdim - 1, lambda x: np.isclose(self.signed(x), 0.0, atol=1e-9)
        )
        cells = dolfinx.mesh.locate_entities(mesh, tdim, lambda x: self.signed(x) < 1e-9)
        if self.moved is not None:
            mesh.geometry.x[:] = self.moved(mesh.geometry.x.T).T
        return mesh, facets, cells


def box(x: Points, dim: int, at: float = 0.5, half: float = 0.25) -> Points:
    """Return the signed distance from the rim of a square or cube around (at, …)."""
    return np.max(np.abs(x[:dim] - at), axis=0) - half


def two(x: Points) -> Points:
    """Return the signed distance from the rims of two squares of length 1/4."""
    return np.minimum(box(x, 2, 0.25, 0.125), box(x, 2, 0.75, 0.125))


def sheared(x: Points) -> Points:
    return np.stack([x[0] + 0.7 * x[1], x[1], x[2]])


SHEARED_RIM = 2.0 * 0.5 * (1.0 + np.hypot(0.7, 1.0))

#: Closed surfaces and those that bend around a place.
AROUND = {
    "square": Shape(Cell.quadrilateral, lambda x: box(x, 2), 2.0),
    "parallelogram": Shape(Cell.quadrilateral, lambda x: box(x, 2), SHEARED_RIM, sheared),
    "two-squares": Shape(Cell.quadrilateral, two, 2.0),
    "cube": Shape(Cell.hexahedron, lambda x: box(x, 3), 1.5),
    "tube": Shape(Cell.hexahedron, lambda x: box(x, 2), 2.0),
    "three-sides": Shape(
        Cell.quadrilateral, lambda x: np.maximum(np.abs(x[0] - 0.5) - 0.25, x[1] - 0.75), 2.0
    ),
}

#: Planes; the cells below the plane are inside, and normals point up.
PLANES = {
    "triangles-x": Shape(Cell.triangle, lambda x: x[0] - 0.5, 1.0),
    "quadrilaterals-y": Shape(Cell.quadrilateral, lambda x: x[1] - 0.5, 1.0),
    "tetrahedra-z": Shape(Cell.tetrahedron, lambda x: x[2] - 0.5, 1.0),
    "hexahedra-y": Shape(Cell.hexahedron, lambda x: x[1] - 0.25, 1.0),
    "patch": Shape(
        Cell.quadrilateral, lambda x: np.abs(x[0] - 0.5) + np.maximum(x[1] - 0.5, 0.0), 0.5
    ),
}


SHAPES = {**AROUND, **PLANES}

#: Meshes without ghost cells, and with those that share a facet with an owned cell.
over_ghosts = pytest.mark.parametrize(
    "ghosts", [Ghosts.none, Ghosts.shared_facet], ids=["alone", "ghosts"]
)


def integrals(shape: Shape, ghosts: Ghosts, side: str | None = None) -> tuple[float, float]:
    """Return ∫ k ds and ∫ ds over the surface, for a k that jumps across it."""
    mesh, facets, cells = shape.parts(ghosts)
    tdim = mesh.topology.dim
    k = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    k.x.array[:] = OUTSIDE
    k.x.array[cells] = INSIDE
    every = np.arange(mesh.topology.index_map(tdim).size_local, dtype=np.int32)
    sides = {None: None, "inside": cells, "outside": np.setdiff1d(every, cells), "any": "any"}
    pairs = one_side(mesh, facets, sides[side])
    ds = ufl.Measure("ds", mesh, subdomain_data=[(1, pairs)])
    one = dolfinx.fem.Constant(mesh, 1.0)
    values = (dolfinx.fem.assemble_scalar(dolfinx.fem.form(f * ds(1))) for f in (k, one))
    stiffness, size = (COMM.allreduce(value) for value in values)
    return stiffness, size


@pytest.mark.processes(1, 2, 3)
@over_ghosts
@pytest.mark.parametrize("name", [name for name in SHAPES if name != "patch"])
def test_without_a_named_side_the_cells_inside_or_below_count(name, ghosts):
    """Without ``side`` the cells inside a closed surface are chosen, or below an open one."""
    stiffness, size = integrals(SHAPES[name], ghosts)
    small(size / SHAPES[name].size - 1.0, 1e-12)
    small(stiffness / size - INSIDE, 1e-12)


@pytest.mark.processes(1, 2, 3)
@over_ghosts
def test_a_patch_has_one_normal(ghosts):
    """On a surface that does not divide the mesh, all normals point to the same side."""
    mesh, facets, _ = SHAPES["patch"].parts(ghosts)
    ds = ufl.Measure("ds", mesh, subdomain_data=[(1, one_side(mesh, facets))])
    n = ufl.FacetNormal(mesh)
    along_x = COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(n[0] * ds(1))))
    small(along_x - SHAPES["patch"].size, 1e-12)


@pytest.mark.processes(1, 2, 3)
@over_ghosts
@pytest.mark.parametrize(("side", "expected"), [("inside", INSIDE), ("outside", OUTSIDE)])
@pytest.mark.parametrize("name", ["square", "cube", "tetrahedra-z"])
def test_a_named_side_counts(name, side, expected, ghosts):
    """``side`` chooses the cells that are integrated."""
    stiffness, size = integrals(SHAPES[name], ghosts, side)
    small(size / SHAPES[name].size - 1.0, 1e-12)
    small(stiffness / size - expected, 1e-12)


@pytest.mark.processes(1, 2, 3)
@over_ghosts
def test_facets_that_branch(ghosts):
    """Facets that branch are refused, also with a side, unless any side is allowed."""
    shape = Shape(Cell.triangle, lambda x: box(x, 2), 2.0 + 2.0 * np.hypot(0.125, 0.125))
    mesh, facets, cells = shape.parts(ghosts)
    with raises(ValueError, "facets branch: .* at 4 places.*locate_entities.*Name the side"):
        one_side(mesh, facets)
    with raises(
        ValueError, "side has both cells at 2 facets and none at 0 others.*leave facets out"
    ):
        one_side(mesh, facets, cells)
    small(integrals(shape, ghosts, "any")[1] / shape.size - 1.0, 1e-12)


def test_sides_that_are_none():
    """A side without cells at the facets, or of another type, is refused."""
    mesh, facets, _ = SHAPES["square"].parts()
    with raises(ValueError, "side has both cells at 0 facets and none at 16 others"):
        one_side(mesh, facets, np.zeros(0, dtype=np.int32))
    with raises(ValueError, "side is 'left': give cells"):
        one_side(mesh, facets, "left")


def test_a_strip_with_one_side():
    """A ring of facets has two sides, and a twisted one has one."""
    ridge = np.array([[0, 1], [1, 2], [2, 0]])
    direction = np.array([[-1.0, 1.0]] * 3)
    label = _side_labels(ridge, direction)
    agree(len(set(label[:3])) == 1 and label[0] != label[3], label)
    direction[0] = [1.0, 1.0]
    label = _side_labels(ridge, direction)
    agree(len(set(label)) == 1, f"a strip with one side has the sides {label}")


def test_a_surface_in_a_mesh_that_is_one():
    """In a surface mesh the side has to be named by cells, as normals are ambiguous."""
    solid = dolfinx.mesh.create_unit_cube(COMM, 2, 2, 2)
    bottom = dolfinx.mesh.locate_entities_boundary(solid, 2, lambda x: np.isclose(x[2], 0.0))
    mesh = dolfinx.mesh.create_submesh(solid, 2, bottom)[0]
    facets = dolfinx.mesh.locate_entities(mesh, 1, lambda x: np.isclose(x[0], 0.5))
    with raises(ValueError, "a mesh that is a surface itself.*Name the side by cells"):
        one_side(mesh, facets)
    side = dolfinx.mesh.locate_entities(mesh, 2, lambda x: x[0] < 0.5 + 1e-9)
    pairs = one_side(mesh, facets, side).reshape(-1, 2)
    agree(COMM.allreduce(len(pairs)) == 2 and np.isin(pairs[:, 0], side).all(), pairs)
