# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Recovered fields reproduce linear ones, jump at interfaces, and ignore the partition."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import pytest
from cases import each
from collective import COMM, agree, equal, raises, small, whole
from problems import cube
from walls import INTERFACE, create_mesh, tube

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.meshes.bricks import create_brick_tube
from dolfinx_feti.output import Patches, balanced_stress, create_patches, recovered_field

Array = npt.NDArray[np.float64]

# The covariance of a patch is a difference of squares of coordinates: (L/h)² eps.
ROUNDING = 1e4 * np.finfo(float).eps


def mesh_of(dim: int, comm: MPI.Comm = COMM) -> dolfinx.mesh.Mesh:
    """Return a square, or a quarter tube of two layers, one of them one element thick."""
    if dim == 2:
        return cube(2, 6, comm=comm)
    return tube(comm, media=2, adventitia=1, around=5, along=2, quarter=True)


def split(mesh: dolfinx.mesh.Mesh) -> dolfinx.mesh.MeshTags:
    """Return the tags 7 and 3 of an inner and an outer layer."""
    dim = mesh.topology.dim
    cells = mesh.topology.index_map(dim)
    every = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    x = dolfinx.mesh.compute_midpoints(mesh, dim, every)
    inner = x[:, 0] < 0.5 if dim == 2 else np.hypot(x[:, 0], x[:, 1]) < INTERFACE
    return dolfinx.mesh.meshtags(mesh, dim, every, np.where(inner, 7, 3).astype(np.int32))


def step(layers: dolfinx.mesh.MeshTags, mesh: dolfinx.mesh.Mesh) -> dolfinx.fem.Function:
    """Return the function that is zero in the one layer and one in the other."""
    Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
    f = dolfinx.fem.Function(Q)
    f.x.array[Q.dofmap.list[layers.find(3), 0]] = 1.0
    return f


def linear(mesh: dolfinx.mesh.Mesh, jump: Expr) -> Expr:
    """Return a stress that is linear in each layer and jumps between them."""
    dim = mesh.geometry.dim
    x = ufl.SpatialCoordinate(mesh)
    one = np.arange(1.0, dim**2 + 1).reshape(dim, dim)
    A, B, C = (ufl.as_matrix(m.tolist()) for m in (one, one.T**2, np.eye(dim) - one / 3))
    return A + x[0] * B - 2 * x[1] * C + jump * (40 * C + x[dim - 1] * A)


def nodes(expression: Expr, mesh: dolfinx.mesh.Mesh) -> Array:
    """Return values at the nodes of the quadratic element in owned cells, (cells, nodes, …)."""
    dim = mesh.topology.dim
    corners = np.vstack([np.zeros(dim), np.eye(dim)])
    edges = [(corners[i] + corners[j]) / 2 for i in range(dim + 1) for j in range(i)]
    points = np.vstack([corners, edges])
    cells = np.arange(mesh.topology.index_map(dim).size_local, dtype=np.int32)
    values = dolfinx.fem.Expression(expression, points).eval(mesh, cells)
    return np.asarray(values).reshape(len(cells), len(points), *expression.ufl_shape)


def patches_of(mesh: dolfinx.mesh.Mesh) -> tuple[Patches, Expr]:
    layers = split(mesh)
    return create_patches(mesh, layers), step(layers, mesh)


# -- what is reproduced


@pytest.mark.parametrize("with_normal", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_linear_stresses_with_a_jump(dim, with_normal):
    """Stresses that are linear in each layer, with a jump between them, are reproduced."""
    mesh = mesh_of(dim)
    patches, jump = patches_of(mesh)
    stress = linear(mesh, jump)
    normal = ufl.SpatialCoordinate(mesh) + ufl.as_vector([1.0] * dim) if with_normal else None
    recovered = recovered_field(stress, patches, normal=normal, name="sigma")
    agree(recovered.name == "sigma" and recovered.ufl_shape == (dim, dim))
    equal(nodes(recovered, mesh), nodes(stress, mesh), ROUNDING)


@pytest.mark.parametrize("dim", [2, 3])
def test_linear_pressure_from_its_means(dim):
    """A linear pressure is recovered from its means over the elements."""
    mesh = mesh_of(dim)
    patches, jump = patches_of(mesh)
    x = ufl.SpatialCoordinate(mesh)
    pressure = 3 - x[0] + 2 * x[dim - 1] + jump * (5 + x[1])
    Q = jump.function_space
    p = dolfinx.fem.Function(Q)
    q = ufl.TestFunction(Q)
    means, size = (
        dolfinx.fem.assemble_vector(dolfinx.fem.form(f * q * ufl.dx(mesh))).array
        for f in (pressure, 1.0)
    )
    owned = size > 0  # the integrals are those of the owned cells
    p.x.array[owned] = means[owned] / size[owned]
    p.x.scatter_forward()
    equal(nodes(recovered_field(p, patches), mesh), nodes(pressure, mesh), ROUNDING)
    blurred = recovered_field(p, create_patches(mesh))
    agree(COMM.allreduce(np.abs(nodes(blurred - pressure, mesh)).max(initial=0), op=MPI.MAX) > 0.5)


def test_smooth_fields_with_the_second_power_of_the_size():
    """Smooth fields are recovered to second order in the cell size, after later sweeps too."""
    errors = []
    for n in (6, 12):
        mesh = cube(2, n)
        x = ufl.SpatialCoordinate(mesh)
        f = ufl.as_vector([ufl.sin(3 * x[0]) * ufl.exp(x[1]), ufl.cos(2 * x[0] * x[1])])
        e = nodes(recovered_field(f, create_patches(mesh)) - f, mesh)
        errors.append(np.sqrt(COMM.allreduce((e**2).sum()) / COMM.allreduce(e.size)))
    agree(errors[0] > 2**1.9 * errors[1] and errors[1] < 0.005, errors)


def test_a_field_is_continuous_in_each_layer():
    """A recovered field is continuous in each layer, even from noise, and jumps between layers."""
    mesh = mesh_of(3)
    patches, jump = patches_of(mesh)
    noise = dolfinx.fem.Function(jump.function_space)
    noise.interpolate(lambda x: np.sin(1e4 * (x[0] + 2 * x[1] + 3 * x[2])))
    x, layer, values = (
        whole(nodes(f, mesh))
        for f in (ufl.SpatialCoordinate(mesh), jump, recovered_field(noise, patches))
    )
    places = np.round(np.concatenate([x, layer[..., None]], axis=2).reshape(-1, 4), 8)
    spread = spread_at(places, values.ravel())
    agree(spread.max() < 1e-11 and len(spread) < values.size / 4, spread.max())
    agree(spread_at(places[:, :3], values.ravel()).max() > 0.1)


def spread_at(places: Array, values: Array) -> Array:
    """Return greatest minus smallest value at each place."""
    _, index = np.unique(places, axis=0, return_inverse=True)
    count = index.max() + 1
    high = np.full(count, -np.inf)
    low = np.full(count, np.inf)
    np.maximum.at(high, index.ravel(), values)
    np.minimum.at(low, index.ravel(), values)
    return high - low


@pytest.mark.parametrize("with_normal", [False, True])
def test_processes_do_not_matter(with_normal):
    """Recovered fields do not depend on the partition."""
    found = []
    for comm in (COMM, MPI.COMM_SELF):
        mesh = mesh_of(3, comm)
        patches, jump = patches_of(mesh)
        x = ufl.SpatialCoordinate(mesh)
        noise = dolfinx.fem.Function(jump.function_space)
        noise.interpolate(lambda x: np.sin(1e3 * (x[0] + 2 * x[1] + 3 * x[2])))
        stress = ufl.outer(x, x) * noise + jump * ufl.Identity(3)
        recovered = recovered_field(stress, patches, normal=x if with_normal else None)
        centroids = (nodes(x, mesh)[:, :4].mean(axis=1)[:, None]) + 0 * nodes(x, mesh)
        parts = (centroids, nodes(x, mesh), nodes(recovered, mesh).reshape(*centroids.shape[:2], 9))
        rows = np.concatenate(parts, axis=2).reshape(-1, 15)
        rows = whole(rows) if comm is COMM else rows
        found.append(rows[np.lexsort(np.round(rows[:, :6], 7).T)])
    equal(found[0], found[1], 1e-10)


def test_one_cell():
    """On a mesh of one cell, whose patches have no extent, the mean is recovered."""
    mesh = create_mesh(COMM, np.vstack([np.zeros(3), np.eye(3)]), np.arange(4)[None])
    x = ufl.SpatialCoordinate(mesh)
    patches = create_patches(mesh)
    equal(nodes(recovered_field(x, patches), mesh), nodes(x, mesh), ROUNDING)
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    p.x.array[:] = 3.0
    equal(nodes(recovered_field(p, patches), mesh), 3 + 0 * nodes(x[0], mesh), ROUNDING)


def test_with_a_normal_means_count_along_the_wall_only():
    """With a normal, in-plane stresses are fitted to the cells' means, and others to all values."""
    mesh = mesh_of(2)
    patches, jump = patches_of(mesh)
    x = ufl.SpatialCoordinate(mesh)
    centroid = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0, (2,))))
    centroid.interpolate(dolfinx.fem.Expression(x, np.full((1, 2), 1 / 3)))
    stress = linear(mesh, jump)
    wrong = stress + (x - centroid)[0] * ufl.as_matrix([[5.0, 4.0], [4.0, 3.0]])
    normal = ufl.as_vector([0.0, -2.0])
    exact = nodes(stress, mesh)
    error = nodes(recovered_field(wrong, patches, normal=normal), mesh) - exact
    small(np.abs(error[..., 0, 0]).max(initial=0), 1e-10)
    inside = nodes(recovered_field(wrong, patches), mesh) - exact
    equal(error[..., 1, :], inside[..., 1, :], 1e-10)
    agree(whole(np.abs(inside[..., 0, 0]).ravel()).max() > 0.1)


# -- what is refused


class Plane:
    """A square, its patches, and data that do not fit them."""

    def __init__(self):
        self.mesh = mesh_of(2)
        self.patches, self.jump = patches_of(self.mesh)
        self.x = ufl.SpatialCoordinate(self.mesh)
        self.σ = ufl.outer(self.x, self.x)
        V = dolfinx.fem.functionspace(self.mesh, ("Lagrange", 2, (2,)))
        self.zero = dolfinx.fem.Function(V)

    def tags_of_facets(self):
        one = np.ones(1, dtype=np.int32)
        return dolfinx.mesh.meshtags(self.mesh, 1, one - 1, one)

    def tags_of_one_layer(self):
        cells = split(self.mesh).find(7)
        return dolfinx.mesh.meshtags(self.mesh, 2, cells, np.full(len(cells), 7, dtype=np.int32))


QUADRILATERAL = dolfinx.mesh.CellType.quadrilateral
#: A call with wrong arguments, the error, and its message.
REFUSED = {
    "cells": (
        lambda b: create_patches(cube(2, 2, QUADRILATERAL)),
        TypeError,
        "quadrilateral with 4 nodes in 2",
    ),
    "degree": (
        lambda b: create_patches(b.mesh, degree=2),
        ValueError,
        "degree=2: give a quadrature degree",
    ),
    "layers-of-another-mesh": (
        lambda b: create_patches(b.mesh, split(cube(2, 6))),
        ValueError,
        "tags of dimension 2, or",
    ),
    "layers-of-facets": (
        lambda b: create_patches(b.mesh, b.tags_of_facets()),
        ValueError,
        "tags of dimension 1, or",
    ),
    "cells-without-a-layer": (
        lambda b: create_patches(b.mesh, b.tags_of_one_layer()),
        ValueError,
        "layers: 36 cells have no tag",
    ),
    "field-of-another-mesh": (
        lambda b: recovered_field(ufl.SpatialCoordinate(mesh_of(2)), b.patches),
        ValueError,
        "does not live on the mesh",
    ),
    "infinite-field": (
        lambda b: recovered_field(b.x / (b.jump * b.x[0]), b.patches),
        ArithmeticError,
        "in 36 cells",
    ),
    "normal-of-a-vector": (
        lambda b: recovered_field(b.x, b.patches, normal=b.x),
        ValueError,
        "give a vector of 2",
    ),
    "scalar-as-a-normal": (
        lambda b: recovered_field(b.σ, b.patches, normal=b.x[0]),
        ValueError,
        "give a vector of 2",
    ),
    "zero-as-a-normal": (
        lambda b: recovered_field(b.σ, b.patches, normal=0 * b.x),
        ArithmeticError,
        "vanishes at 432",
    ),
    "scalar-as-a-stress": (
        lambda b: balanced_stress(b.x[0], b.zero, normal=b.x),
        ValueError,
        r"A stress of shape \(\) with",
    ),
    "zero-as-a-normal-of-a-balanced-stress": (
        lambda b: balanced_stress(b.σ, b.zero, normal=b.zero),
        ArithmeticError,
        "nowhere zero",
    ),
}


@each(("call", "error", "message"), REFUSED)
def test_bad_input(call, error, message):
    """Data, tags and normals that do not fit the patches are refused."""
    with raises(error, message):
        call(Plane())


def test_patches_follow_a_mesh_that_moves():
    """Patches follow a mesh that ``unload`` moves, so that linear fields stay exact."""
    mesh = mesh_of(3)
    layers = split(mesh)
    patches = create_patches(mesh, layers)
    x = mesh.geometry.x
    x[:] = (
        x @ np.array([[1.3, 0.2, 0.0], [0.1, 0.8, 0.3], [0.0, 0.4, 1.1]]) + 0.05 * x[:, ::-1] ** 2
    )
    expression = linear(mesh, step(layers, mesh))
    moved, fresh = (recovered_field(expression, p) for p in (patches, create_patches(mesh, layers)))
    equal(moved.x.array, fresh.x.array, 1e-14)


# -- stresses in balance


@pytest.fixture(scope="module", params=["tetrahedron", "hexahedron", "curved", "triangle"])
def u(request) -> dolfinx.fem.Function:
    """A displacement that is zero."""
    if request.param == "curved":
        mesh = create_brick_tube(COMM, length=0.3, size=0.3, quarter=True).mesh
    elif request.param == "triangle":
        mesh = dolfinx.mesh.create_unit_square(COMM, 4, 4)
    else:
        kind = getattr(dolfinx.mesh.CellType, request.param)
        mesh = dolfinx.mesh.create_unit_cube(COMM, 3, 3, 3, cell_type=kind)
    dim = mesh.geometry.dim
    return dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (dim,))))


def steady(u: dolfinx.fem.Function) -> tuple[Expr, Expr]:
    """Return a stress whose traction on surfaces along the normal is constant, and the normal."""
    dim = len(u)
    x = ufl.SpatialCoordinate(u.function_space.mesh)
    n = ufl.as_vector([1.0, 2.0, 2.0][:dim])
    along = ufl.Identity(dim) - ufl.outer(n, n) / ufl.inner(n, n)
    return 3.0 * ufl.Identity(dim) + x[0] * along, n


def norm(u: dolfinx.fem.Function, f: Expr) -> float:
    """Return the L2 norm of a field."""
    mesh = u.function_space.mesh
    dx = ufl.dx(mesh, metadata={"quadrature_degree": 6})
    square = dolfinx.fem.assemble_scalar(dolfinx.fem.form(ufl.inner(f, f) * dx))
    return float(np.sqrt(mesh.comm.allreduce(square)))


def test_accurate_stress_stays(u):
    """A stress with constant tractions along the normal is not changed."""
    stress, n = steady(u)
    small(norm(u, balanced_stress(stress, u, normal=n) - stress), 1e-12)


def test_pressure_that_is_off_is_put_right(u):
    """A pressure error without a linear part in any cell is removed."""
    stress, n = steady(u)
    mesh = u.function_space.mesh
    wave = ufl.cos(5.0 * ufl.SpatialCoordinate(mesh)[0])
    zero = balanced_stress(0.0 * stress, u, normal=n)
    off = wave * ufl.Identity(len(u))
    ripple = -balanced_stress(off, u, normal=n) + off  # (1 − Π) wave
    small(norm(u, zero), 1e-14)
    found = balanced_stress(stress + ripple, u, normal=-7.0 * n)
    small(norm(u, found - stress), 1e-12)
    assert norm(u, ripple) > 1e-3
