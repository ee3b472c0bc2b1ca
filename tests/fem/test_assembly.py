# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The torn matrix of a form sums over the subdomains to dolfinx's own matrix."""

from __future__ import annotations

import itertools

from petsc4py import PETSc

import numpy as np
import pytest
from cases import each
from collective import COMM, agree, dense, equal, small, whole
from problems import Cell, Problem, cube, elasticity, poisson

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti.fem import assembly
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import decompose, tear
from dolfinx_feti.fem.facets import one_side
from dolfinx_feti.fem.near_kernel import attach_near_kernel
from dolfinx_feti.fem.split_form import split_torn_form
from dolfinx_feti.fem.torn_matrix import create_matrix_on_torn_space, dirichlet_mask
from dolfinx_feti.torn.matrix import Torn

SEED = 27182


@pytest.fixture
def torn_matrix(lifetime):
    """Return a function that tears a space and assembles: the space, local and torn matrix."""

    def create(problem, subdomains=5):
        space = tear(problem.V, decompose(problem.V.mesh, subdomains))
        compiler = Compiler(COMM)
        K = assembly.create_local_matrix(space, compiler)
        lifetime.own(K.mat)
        assembly.assemble(K, split_torn_form(problem.a, space, compiler))
        return space, K.mat, lifetime.own(create_matrix_on_torn_space(space, K.mat, problem.bcs))

    return create


def entries(A):
    """Return all entries of a matrix, torn or not, or of the matrix of a form."""
    if isinstance(A, ufl.Form):
        A = dolfinx.fem.petsc.assemble_matrix(dolfinx.fem.form(A))
        A.assemble()
    assembled = A.convert("aij", PETSc.Mat())
    found = dense(assembled)
    assembled.destroy()
    return found


def two_components_in_space():
    """Create a problem with two components in three dimensions."""
    V = dolfinx.fem.functionspace(cube(3, 2), ("Lagrange", 1, (2,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    return Problem(V, ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, None, [])


PROBLEMS = {
    "Poisson, quadratic triangles": lambda: poisson(cube(2, 4), degree=2, stretched=True),
    "Poisson, tetrahedra": lambda: poisson(cube(3, 2), stretched=True),
    "elasticity, triangles": lambda: elasticity(cube(2, 4), stretched=True),
    "elasticity, quadratic quadrilaterals": lambda: elasticity(
        cube(2, 3, Cell.quadrilateral), degree=2, stretched=True
    ),
    "elasticity, hexahedra": lambda: elasticity(cube(3, 2, Cell.hexahedron), stretched=True),
    "two components in space": two_components_in_space,
}


@each("create", PROBLEMS)
def test_sum_of_the_subdomains_is_the_assembled_matrix(create, torn_matrix, lifetime):
    """The subdomains' matrices sum to dolfinx's matrix, and K R = 0 without springs.

    No Dirichlet dof is modified. Rotations are those of space, also for two components.
    """
    problem = create()
    _, _, A = torn_matrix(problem)
    equal(entries(A), entries(problem.a), 1e-14)
    cell_part = ufl.Form([i for i in problem.a.integrals() if i.integral_type() == "cell"])
    _, K, A = torn_matrix(Problem(problem.V, cell_part, problem.L, problem.bcs))
    attach_near_kernel(A, problem.V)
    torn = lifetime.own(Torn(A))
    R = torn.near_kernel()
    bs = problem.V.dofmap.index_map_bs
    dim = problem.V.mesh.geometry.dim
    agree(R.shape[1] == (bs * (bs + 1) // 2 if bs == dim else bs), R.shape)
    for mode in A.getNearNullSpace().getVecs():
        small(mode.norm() - 1.0, 1e-13)
    small(np.abs(torn.multiply(R)).max(initial=0.0), 1e-13 * COMM.allreduce(K.norm()))


def test_rotations_follow_the_deformed_body(torn_matrix):
    """With a displacement u the near kernel contains the rotations ω × (x + u)."""
    problem = elasticity(cube(3, 2))
    _, _, A = torn_matrix(problem)
    V = problem.V
    n = V.dofmap.index_map.size_local
    x = V.tabulate_dof_coordinates()[:n]
    u = 0.3 * np.stack([x[:, 1] ** 2, np.sin(x[:, 0]), x[:, 0] * x[:, 2]], axis=-1)
    attach_near_kernel(A, V, u)
    modes = np.column_stack([whole(mode.array_r) for mode in A.getNearNullSpace().getVecs()])
    for axis in np.eye(3):
        rotation = whole(np.cross(axis, x + u).ravel())
        equal(modes @ (modes.T @ rotation), rotation, 1e-12)
    undeformed = whole(np.cross([0.0, 0.0, 1.0], x).ravel())
    agree(np.linalg.norm(undeformed - modes @ (modes.T @ undeformed)) > 1e-2)


def test_values_are_overwritten_in_shared_memory():
    """The local matrix shares its values with PETSc, and assembling again overwrites them."""
    problem = poisson(cube(2, 4))
    factor = dolfinx.fem.Constant(problem.V.mesh, 1.0)
    space = tear(problem.V, decompose(problem.V.mesh, 3))
    K = assembly.create_local_matrix(space, Compiler(COMM))
    form = split_torn_form(factor * problem.a, space, Compiler(COMM))
    assembly.assemble(K, form)
    before = K.mat.copy()
    state = K.mat.stateGet()
    assembly.assemble(K, form)
    agree(K.mat.equal(before) and K.mat.stateGet() > state)
    factor.value = 3.0
    assembly.assemble(K, form)
    before.scale(3.0)
    before.axpy(-1.0, K.mat)
    small(before.norm(), 1e-14 * K.mat.norm())
    mat = K.mat
    values = K.csr.data.copy()
    mat.scale(2.0)
    equal(K.csr.data, 2.0 * values)
    del K
    equal(mat.getValuesCSR()[2], 2.0 * values)
    for made in (mat, before):
        made.destroy()


def test_pattern_is_complete(torn_matrix):
    """A second assembly allocates no entry, as the pattern contains all blocks of a cell."""
    problem = elasticity(cube(3, 2))
    space, K, _ = torn_matrix(problem)
    n = np.unique(space.V_torn.dofmap.list[: problem.V.mesh.topology.index_map(3).size_local]).size
    agree(K.getSize() == (3 * n, 3 * n) and K.getBlockSizes() == (3, 3))
    indptr, indices, _ = K.getValuesCSR()
    rows = [indices[a:b] for a, b in itertools.pairwise(indptr)]
    agree(all(np.array_equal(row // 3 * 3, np.repeat(row[::3], 3)) for row in rows))
    agree(all(np.all(np.diff(row) > 0) for row in rows))


def test_dirichlet_dofs_are_those_of_the_conditions(torn_matrix):
    """The mask of Dirichlet dofs has the prescribed dofs of each condition, by component."""
    problem = elasticity(cube(2, 4), stretched=True)
    V = problem.V
    n = V.dofmap.index_map.size_local
    x = V.tabulate_dof_coordinates()[:n]
    expected = np.zeros((n, 2), dtype=bool)
    expected[np.isclose(x[:, 0], 0.0)] = True
    expected[np.isclose(x[:, 0], 1.0), 1] = True
    equal(dirichlet_mask(V, problem.bcs), expected.ravel())
    agree(not dirichlet_mask(V, []).any())
    _, _, A = torn_matrix(problem)
    named = A.query("dirichlet").getIndices()
    first = V.dofmap.index_map.local_range[0] * 2
    equal(np.sort(named), first + np.flatnonzero(expected.ravel()))


def test_vector_is_assembled_with_the_shares_of_all_processes():
    """An assembled vector includes the contributions of other processes' cells."""
    problem = elasticity(cube(2, 5), stretched=True)
    form = dolfinx.fem.form(problem.L)
    b = dolfinx.fem.petsc.assemble_vector(form)
    b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
    equal(assembly.assemble_owned(form), b.array_r, 1e-14)
    b.destroy()


@pytest.mark.parametrize("cell", [Cell.triangle, Cell.quadrilateral, Cell.tetrahedron])
def test_surface_inside_from_one_side(cell, torn_matrix):
    """An integral over one side of inner facets is dolfinx's over both, for continuous values."""
    mesh = cube(3 if cell == Cell.tetrahedron else 2, 4, cell)
    problem = poisson(mesh, degree=2)
    u = ufl.TrialFunction(problem.V)
    v = ufl.TestFunction(problem.V)
    k = dolfinx.fem.Function(problem.V)
    k.interpolate(lambda x: 1.0 + x[1] ** 2)
    tdim = mesh.topology.dim
    facets = dolfinx.mesh.locate_entities(mesh, tdim - 1, lambda x: np.isclose(x[0], 0.5))
    tags = dolfinx.mesh.meshtags(mesh, tdim - 1, facets, np.full(len(facets), 1, dtype=np.int32))
    boundary = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    inside = ufl.Measure("dS", mesh, subdomain_data=tags)
    surfaces = [(n, one_side(mesh, which)) for n, which in ((1, facets), (2, boundary))]
    ds = ufl.Measure("ds", mesh, subdomain_data=surfaces)
    both_sides = problem.a + ufl.avg(k * u) * ufl.avg(v) * inside(1) + u * v * ufl.ds
    from_one_side = problem.a + k * u * v * ds(1) + u * v * ds(2)
    expected = entries(both_sides)
    _, _, A = torn_matrix(Problem(problem.V, from_one_side, None, []))
    equal(entries(A), expected, 1e-13)
    without = entries(problem.a + u * v * ufl.ds)
    agree(np.abs(without - expected).max() > 1e-2)
    agree(one_side(mesh, np.zeros(0, dtype=np.int32)).shape == (0,))
