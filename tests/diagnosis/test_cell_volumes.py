# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cells that are inside out or distorted are found and counted, also between quadrature points.

The displacements are polynomials of the element, so that det F is known at every vertex.
"""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal, small
from problems import Cell, dirichlet, left
from strips import DISTORTED, INVERTED, ROWS, SOUND, Strip, volume_warnings

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.meshes.curved import create_curved_mesh


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("kind", [Cell.triangle, Cell.quadrilateral])
def test_inverted_cells_are_counted_and_located(kind, unit, caplog):
    """Inverted cells are counted and located, also where det F > 0 at all quadrature points."""
    strip = Strip(kind, unit=unit)
    strip.place(strip.u, INVERTED)
    agree(strip.problem._system.smallest_volume_ratio() > 0.0)
    volumes = strip.problem.cell_volumes()
    agree(all(other == volumes for other in COMM.allgather(volumes)), volumes)
    small(volumes.least - (1.0 - INVERTED), 1e-5)
    small(volumes.greatest - 1.0, 1e-5)
    column = ROWS * (2 if kind == Cell.triangle else 1)
    agree((volumes.cells, volumes.inverted) == (2 * column, column), volumes)
    agree(not volumes.is_sound and volumes.distorted >= volumes.inverted, volumes)
    third = 1 / 3 if kind == Cell.triangle else 1 / 2
    equal(volumes.low, unit * np.array([third, third / ROWS]), 1e-9)
    equal(volumes.high, unit * np.array([1 - third, 1 - third / ROWS]), 1e-9)
    inside = np.array(volumes.low) <= np.array(volumes.worst) * (1 + 1e-9)
    agree(np.all(inside) and len(volumes.worst) == 2, volumes)
    agree(f"not positive in {column} cells" in str(volumes), volumes)
    agree(not volume_warnings(caplog))  # to ask is no reason to warn


@pytest.mark.parametrize(("strain", "is_sound"), [(DISTORTED, False), (SOUND, True)])
def test_distorted_cells(strain, is_sound):
    """A cell counts as distorted if its volume ratio varies by more than the threshold."""
    strip = Strip()
    strip.place(strip.u, strain)
    volumes = strip.problem.cell_volumes()
    agree(volumes.inverted == 0 and volumes.is_sound == is_sound, volumes)
    agree((volumes.distorted > 0) != is_sound and bool(volumes.low) != is_sound, volumes)


def test_axisymmetric_body_with_its_axis():
    """The volume ratio of an axisymmetric body is found on the axis too, where u/r is 0/0."""
    mesh = dolfinx.mesh.create_rectangle(COMM, [(0, 0), (1, 1)], (3, 1))
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = dolfinx.fem.Function(V)
    r = ufl.SpatialCoordinate(mesh)[0]
    H = ufl.grad(u)
    F = ufl.as_matrix([[1 + H[0, 0], H[0, 1], 0], [H[1, 0], 1 + H[1, 1], 0], [0, 0, 1 + u[0] / r]])
    energy = 2 * np.pi * r * (ufl.inner(F, F) - 2 * ufl.ln(ufl.det(F))) * ufl.dx
    axis = dolfinx.mesh.locate_entities_boundary(mesh, 1, left)
    bc = dolfinx.fem.dirichletbc(
        0.0, dolfinx.fem.locate_dofs_topological(V.sub(0), 1, axis), V.sub(0)
    )
    problem = NonlinearProblem(energy, u, bcs=[bc], subdomains=2, quadrature_degree=4)
    u.interpolate(lambda x: np.stack([0.2 * x[0], 0.1 * x[1]]))
    volumes = problem.cell_volumes()
    small(volumes.least - 1.2**2 * 1.1, 1e-5)
    small(volumes.greatest - 1.2**2 * 1.1, 1e-5)
    u.interpolate(lambda x: np.stack([0.2 * x[0], -INVERTED / 2 * x[1] ** 2]))
    volumes = problem.cell_volumes()
    small(volumes.least - 1.2**2 * (1 - INVERTED), 1e-5)
    agree(volumes.inverted == volumes.cells == 6, volumes)


def test_curved_cells():
    """On curved cells a stretch is no distortion, and inversions are detected."""
    square = dolfinx.mesh.create_unit_square(COMM, 3, 3, Cell.quadrilateral)

    def bent(x):
        radius = 1 + x[:, 0]
        return np.column_stack([radius * np.cos(x[:, 1]), radius * np.sin(x[:, 1])])

    mesh = create_curved_mesh(square, bent)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = dolfinx.fem.Function(V)
    energy = Strip.density(u) * ufl.dx
    problem = NonlinearProblem(energy, u, subdomains=4, quadrature_degree=4)
    u.interpolate(lambda x: np.stack([0.3 * x[0], -0.1 * x[1]]))
    found = problem.cell_volumes()
    small(found.least - 1.3 * 0.9, 1e-6)
    small(found.greatest - 1.3 * 0.9, 1e-6)
    agree(found.is_sound, found)
    inner = dolfinx.fem.locate_dofs_geometrical(V, lambda x: np.hypot(x[0], x[1]) < 1.01)
    u.x.array.reshape(-1, 2)[inner] *= -3.0
    found = problem.cell_volumes()
    agree(found.inverted > 0, found)
    agree(np.hypot(*found.worst) < 1.4, found)


@pytest.mark.parametrize(("degree", "inverted"), [(1, 1), (3, 2)])
def test_inversions_are_counted_for_other_degrees(degree, inverted):
    """An inversion is counted in each cell of the moved node, for P1 to P3."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 4, 4)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    u = dolfinx.fem.Function(V)
    problem = NonlinearProblem(Strip.density(u) * ufl.dx, u, subdomains=4, quadrature_degree=4)
    u.interpolate(lambda x: np.stack([0.5 * x[0], 0.0 * x[1]]))
    volumes = problem.cell_volumes()
    small(volumes.least - 1.5, 1e-9)
    small(volumes.greatest - 1.5, 1e-9)
    at = dolfinx.fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0] + x[1], 0.0))
    u.x.array.reshape(-1, 2)[at] += [3.0, 0.0]
    volumes = problem.cell_volumes()
    agree(volumes.inverted == inverted, volumes)
    agree(max(volumes.worst) < 0.25, volumes)


def test_swelling_is_no_distortion():
    """A uniform change of volume, of a body or by growth, is no distortion."""
    strip = Strip()
    for factor in (3.0, 0.3):
        strip.u.interpolate(lambda x, factor=factor: np.stack([(factor - 1) * x[0], 0 * x[1]]))
        found = strip.problem.cell_volumes()
        agree(found.is_sound, found)
        small(found.least - factor, 1e-9)


def test_elastic_part_is_looked_at():
    """Of a prestressed image the elastic part F G⁻¹ is checked, here inverted at x = 1."""
    mesh = dolfinx.mesh.create_rectangle(COMM, [(0, 0), (1, 1)], (1, ROWS))
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = dolfinx.fem.Function(V)
    G = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 1, (2, 2))))
    G.interpolate(lambda x: np.stack([1 - INVERTED * x[0], 0 * x[0], 0 * x[0], 1 + 0 * x[0]]))
    E = (ufl.Identity(2) + ufl.grad(u)) * ufl.inv(G)
    energy = (ufl.inner(E, E) - 2 * ufl.ln(ufl.det(E))) * ufl.det(G) * ufl.dx
    problem = NonlinearProblem(energy, u, subdomains=2, quadrature_degree=4)
    found = problem.cell_volumes()
    agree(found.inverted == found.cells == 2 * ROWS, found)
    G.interpolate(lambda x: np.stack([2 + 0 * x[0], 0 * x[0], 0 * x[0], 1 + 0 * x[0]]))
    found = problem.cell_volumes()
    small(found.least - 0.5, 1e-9)
    agree(found.is_sound, found)


def test_gradient_at_points_of_a_quadrature():
    """If G is known at quadrature points only, F is checked without it."""
    mesh = dolfinx.mesh.create_rectangle(COMM, [(0, 0), (1, 1)], (1, ROWS))
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = dolfinx.fem.Function(V)
    element = basix.ufl.quadrature_element("triangle", value_shape=(2, 2), degree=4)
    G = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))
    G.x.array.reshape(-1, 4)[:] = [2.0, 0.0, 0.0, 1.0]
    E = (ufl.Identity(2) + ufl.grad(u)) * ufl.inv(G)
    dx = ufl.dx(metadata={"quadrature_degree": 4, "quadrature_scheme": "default"})
    energy = (ufl.inner(E, E) - 2 * ufl.ln(ufl.det(E))) * dx
    problem = NonlinearProblem(energy, u, subdomains=2, quadrature_degree=4)
    u.interpolate(lambda x: np.stack([-INVERTED / 2 * x[0] ** 2, 0 * x[1]]))
    volumes = problem.cell_volumes()
    small(volumes.least - (1 - INVERTED), 1e-5)
    scalars = basix.ufl.quadrature_element("triangle", value_shape=(), degree=4)
    at_points = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, scalars))
    at_points.x.array[:] = 1.0
    problem = NonlinearProblem(
        Strip.density(u) * ufl.dx, u, subdomains=2, quadrature_degree=4, volume_ratio=at_points
    )
    agree(problem.cell_volumes() is None)
    problem.warn_of_cells()


def test_form_without_a_deformation():
    """Without a deformation no cells are checked and no warning is logged."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 3, 3)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = dolfinx.fem.Function(V)
    energy = ((1 + u**2) * ufl.inner(ufl.grad(u), ufl.grad(u)) - u) * ufl.dx
    problem = NonlinearProblem(energy, u, bcs=[dirichlet(V, left)], subdomains=2)
    problem.solve()
    agree(problem.cell_volumes() is None)
    agree(problem.diagnose().volumes is None)
