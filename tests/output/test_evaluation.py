# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Values at points: exact for polynomials, on curved cells and between cells."""

import numpy as np
import pytest
from collective import COMM, equal, raises

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti.output import evaluate

#: dolfinx 0.9 has no quadratic spaces on prisms.
CELLS = {2: ("triangle", "quadrilateral"), 3: ("tetrahedron", "hexahedron")}


def unit_mesh(cell):
    """Return the unit square or cube of one cell type."""
    kind = getattr(dolfinx.mesh.CellType, cell)
    if cell in CELLS[2]:
        return dolfinx.mesh.create_unit_square(COMM, 3, 4, kind)
    return dolfinx.mesh.create_unit_cube(COMM, 3, 2, 4, kind)


def random_points(dim, count=70):
    """Return points inside the unit cube, the same on all processes."""
    return np.random.default_rng(3).uniform(0.01, 0.99, (count, dim))


@pytest.mark.parametrize("cell", [*CELLS[2], *CELLS[3]])
def test_gradient_of_a_quadratic_field(cell):
    """The gradient of a quadratic field is exact at random points."""
    mesh = unit_mesh(cell)
    dim = mesh.geometry.dim
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (dim,)))
    u = dolfinx.fem.Function(V)
    u.interpolate(lambda x: np.array([x[0] ** 2 + x[1], x[0] * x[1], x[1] ** 2])[:dim])
    X = random_points(dim)
    x = X[:, 0]
    y = X[:, 1]
    exact = np.zeros((len(X), dim, dim))
    exact[:, 0, 0] = 2 * x
    exact[:, 0, 1] = 1.0
    exact[:, 1, 0] = y
    exact[:, 1, 1] = x
    if dim == 3:
        exact[:, 2, 1] = 2 * y
    equal(evaluate(ufl.grad(u), X), exact, 1e-12)


def test_single_point_has_the_shape_of_the_expression():
    """A single point has a value of the expression's shape."""
    mesh = unit_mesh("tetrahedron")
    value = evaluate(ufl.SpatialCoordinate(mesh), [0.3, 0.4, 0.5])
    equal(value, [0.3, 0.4, 0.5], 1e-12)


def test_value_between_cells_is_their_mean():
    """At a vertex, a DG function has the mean of the values of all cells around."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 2, 2)
    Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
    f = dolfinx.fem.Function(Q)
    f.interpolate(lambda x: np.where(x[0] < 0.5, 1.0, 3.0))
    cells = {"below": 3, "above": 3}  # the diagonals of the four squares: three cells on each side
    mean = (cells["below"] * 1.0 + cells["above"] * 3.0) / 6
    equal(evaluate(f, [[0.5, 0.5], [0.25, 0.3], [0.75, 0.3]]), [mean, 1.0, 3.0], 1e-14)


def test_curved_cells():
    """On curved cells, the position evaluates to the point itself."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 4, 4)
    curved = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    where = dolfinx.fem.Function(curved)

    def ring(x):
        r = 1.0 + x[0]
        φ = 0.5 * np.pi * x[1]
        return np.array([r * np.cos(φ), r * np.sin(φ)])

    where.interpolate(ring)
    points = ring(random_points(2, 20).T * 0.9 + 0.05).T
    quadratic = _quadratic_mesh(mesh, where)
    equal(evaluate(ufl.SpatialCoordinate(quadratic), points), points, 1e-9)


def _quadratic_mesh(mesh, where):
    """Create the mesh of P2 cells whose nodes a function gives."""
    V = where.function_space
    index_map = V.dofmap.index_map
    n_cells = mesh.topology.index_map(2).size_local
    cells = index_map.local_to_global(V.dofmap.list[:n_cells].ravel()).reshape(n_cells, -1)
    owned = where.x.array[: 2 * index_map.size_local].reshape(-1, 2)
    element = basix.ufl.element("Lagrange", "triangle", 2, shape=(2,))
    return dolfinx.mesh.create_mesh(COMM, cells, *_ordered(element, owned))


def _ordered(element, nodes):
    """Return create_mesh's arguments after the cells, whose order changed with dolfinx 0.10."""
    major, minor, *_ = dolfinx.__version__.split(".")
    domain = ufl.Mesh(element)
    return (nodes, domain) if (int(major), int(minor)) < (0, 10) else (domain, nodes)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([2.0, 0.5], "1 of 1 points are in no cell"),
        ([0.5, 0.5, 0.5], r"points has the shape \(3,\)"),
        ([[0.5, np.nan]], "give finite coordinates"),
    ],
    ids=["outside", "three-coordinates", "not-a-number"],
)
def test_wrong_points_are_named(points, message):
    """Points outside the mesh or of a wrong shape are an error on all processes."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 3, 3)
    with raises(ValueError, message):
        evaluate(ufl.SpatialCoordinate(mesh), points)


def test_expression_without_a_mesh_is_refused():
    """An expression without a mesh is refused."""
    with raises(ValueError, "lives on no mesh"):
        evaluate(ufl.as_ufl(2.0), [0.5, 0.5])
