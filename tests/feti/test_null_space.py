# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A null space given to the matrix: solved in its complement, or refused with what is wrong."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, dense, equal, norm, raises, small, whole
from problems import Problem, cube, dirichlet, elasticity, left, owned, poisson

import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import ConvergenceError, LinearProblem

RTOL = 1e-10

#: For a residual of 1e-10 and condition numbers up to 1e3 on the complement.
TOLERANCE = 1e-7

METHODS = {
    "dual, all-floating": {"feti_formulation": "dual", "feti_type": "all_floating"},
    "dual, classical, Q = I": {
        "feti_formulation": "dual", "feti_type": "classical", "feti_coarse_q": "identity",
    },
    "dual, GMRES, lumped": {
        "feti_formulation": "dual", "feti_pc_type": "lumped", "feti_dual_ksp_type": "gmres",
    },
    "primal": {"feti_formulation": "primal"},
    "interior kept": {"feti_interior": "keep"},
    "the defaults": {},
}  # fmt: skip
every_method = pytest.mark.parametrize("options", METHODS.values(), ids=METHODS)


def vectors_laplacian(mesh):
    """Two constants, and no rotation, are the kernel."""
    free = elasticity(mesh, clamped=None)
    u, v = ufl.TrialFunction(free.V), ufl.TestFunction(free.V)
    return Problem(free.V, ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, free.L, [])


FREE = {
    "Poisson, P1": (lambda: poisson(cube(2, 7), clamped=None), 1),
    "Poisson, P2": (lambda: poisson(cube(2, 5), degree=2, clamped=None), 1),
    "elasticity, P1": (lambda: elasticity(cube(2, 7), clamped=None), 3),
    "elasticity, P2": (lambda: elasticity(cube(2, 4), degree=2, clamped=None), 3),
    "elasticity in space": (lambda: elasticity(cube(3, 2), clamped=None), 6),
    "Laplacian of a vector": (lambda: vectors_laplacian(cube(2, 6)), 2),
}


def torn(problem, options=None, subdomains=6):
    return LinearProblem(
        problem.a,
        problem.L,
        bcs=problem.bcs,
        subdomains=subdomains,
        petsc_options={"ksp_rtol": RTOL, **(options or {})},
    )


def give(linear, count=None):
    """Give the first vectors of the near kernel to the matrix as its null space."""
    A, b = linear.linear_system()
    b.destroy()
    space = PETSc.NullSpace().create(vectors=A.getNearNullSpace().getVecs()[:count], comm=A.comm)
    A.setNullSpace(space)
    return space


def least_squares(problem, b):
    """Return the shortest solution of the assembled system without conditions, whole."""
    A = dolfinx.fem.petsc.assemble_matrix(dolfinx.fem.form(problem.a))
    A.assemble()
    x = np.linalg.lstsq(dense(A), whole(b.array_r), rcond=1e-11)[0]
    A.destroy()
    return x


@every_method
@pytest.mark.parametrize(("create", "dimension"), FREE.values(), ids=FREE)
def test_pure_neumann_problems(create, dimension, options):
    """PETSc's way: the null space is given to A and removed from b; x is orthogonal to it."""
    problem = create()
    linear = torn(problem, options)
    space = give(linear, dimension)
    A, b = linear.linear_system()
    space.remove(b)
    x = A.createVecRight()
    linear.solver.solve(b, x)
    agree(linear.solver.getConvergedReason() > 0, linear.solver.getPythonContext().message)
    expected = least_squares(problem, b)
    small(np.linalg.norm(whole(x.array_r) - expected) / np.linalg.norm(expected), TOLERANCE)
    for z in space.getVecs():
        small(z.dot(x), 1e-14 * x.norm() * np.sqrt(x.getSize()))
    b.destroy()
    x.destroy()


@pytest.mark.parametrize("formulation", ["dual", "primal"])
def test_against_mumps_with_a_dof_prescribed(formulation):
    """Without a number of subdomains there are two at least; PETSc's null space of constants."""
    mesh = cube(2, 20)
    free = poisson(mesh, degree=2, clamped=None)
    x = ufl.SpatialCoordinate(mesh)
    v = ufl.TestFunction(free.V)
    problem = Problem(free.V, free.a, (x[0] - 0.5) * v * ufl.dx, [])
    linear = torn(problem, {"feti_formulation": formulation}, subdomains=None)
    linear.A.setNullSpace(PETSc.NullSpace().create(constant=True, comm=mesh.comm))
    u = owned(linear.solve())
    first = dolfinx.fem.locate_dofs_geometrical(free.V, lambda x: x[0] + x[1] < 1e-8)
    corner = dolfinx.fem.dirichletbc(0.0, first, free.V)
    expected = Problem(free.V, free.a, problem.L, [corner]).solve_directly()
    expected -= whole(expected).mean()
    small(norm(u - expected) / norm(expected), TOLERANCE)


@every_method
def test_what_a_condition_leaves(options):
    """A plate on rollers: prescribed on one side, in one direction; free in the other."""
    free = elasticity(cube(2, 6), degree=2, clamped=None)
    roll = dirichlet(free.V, left, lambda x: 0.1 + 0.2 * x[1], component=0)
    v = ufl.TestFunction(free.V)
    mesh = free.V.mesh
    x = ufl.SpatialCoordinate(mesh)
    force = ufl.as_vector([x[1], x[0] - 0.5])
    problem = Problem(free.V, free.a, ufl.inner(force, v) * ufl.dx, [roll])
    linear = torn(problem, options)
    z = linear.A.createVecRight()
    z.array[1::2] = 1.0
    z.normalize()
    linear.A.setNullSpace(PETSc.NullSpace().create(vectors=[z], comm=mesh.comm))
    u = owned(linear.solve())
    corner = dolfinx.fem.locate_dofs_geometrical(
        (free.V.sub(1), free.V.sub(1).collapse()[0]), lambda x: x[0] + x[1] < 1e-8
    )
    pin = dolfinx.fem.Function(free.V.sub(1).collapse()[0])
    bcs = [roll, dolfinx.fem.dirichletbc(pin, corner, free.V.sub(1))]
    expected = Problem(free.V, free.a, problem.L, bcs).solve_directly()
    expected -= z.array_r * whole(z.array_r * expected).sum()
    small(norm(u - expected) / norm(expected), TOLERANCE)
    z.destroy()


@pytest.mark.parametrize("formulation", ["dual", "primal"])
def test_two_bodies(formulation):
    """Each has a constant of its own; the sum of both is only a part of the null space."""
    mesh = cube(2, 8)
    cells = mesh.topology.index_map(2).size_local + mesh.topology.index_map(2).num_ghosts
    gap = dolfinx.mesh.locate_entities(mesh, 2, lambda x: (x[0] > 0.37) & (x[0] < 0.63))
    kept = np.setdiff1d(np.arange(cells), gap).astype(np.int32)
    problem = poisson(dolfinx.mesh.create_submesh(mesh, 2, kept)[0], clamped=None)
    linear = torn(problem, {"feti_formulation": formulation}, subdomains=12)
    A, b = linear.linear_system()
    x = problem.V.tabulate_dof_coordinates()[: b.getLocalSize(), 0]
    constants = [A.createVecRight(), A.createVecRight()]
    for z, of_body in zip(constants, (x < 0.5, x > 0.5), strict=True):
        z.array[:] = of_body
        z.normalize()
    both = constants[0] + constants[1]
    both.normalize()
    A.setNullSpace(PETSc.NullSpace().create(vectors=[both], comm=A.comm))
    with raises(ConvergenceError, "singular, with a kernel of dimension 2"):
        linear.solve()
    space = PETSc.NullSpace().create(vectors=constants, comm=A.comm)
    A.setNullSpace(space)
    A.setTransposeNullSpace(space)
    u = owned(linear.solve())
    space.remove(b)
    equal(whole(u), least_squares(problem, b), TOLERANCE)
    b.destroy()


@pytest.mark.parametrize("formulation", ["dual", "primal"])
def test_slender_and_free(formulation):
    """Bending costs next to nothing: what rounding leaves along the null space must not grow."""
    mesh = dolfinx.mesh.create_rectangle(COMM, [(0, 0), (100, 1)], (200, 2))
    linear = torn(
        elasticity(mesh, clamped=None),
        {"feti_formulation": formulation, "ksp_rtol": 1e-8},
        subdomains=20,
    )
    linear.A.setTransposeNullSpace(give(linear))
    linear.solve()
    agree(linear.solver.getIterationNumber() < 20, linear.solver.getIterationNumber())


@pytest.mark.parametrize("formulation", ["dual", "primal"])
def test_load_that_nothing_balances(formulation):
    """Poisson with a source and no sink; PETSc takes the source out if it is told to."""
    problem = poisson(cube(2, 6), clamped=None)
    linear = torn(problem, {"feti_formulation": formulation})
    space = give(linear)
    with raises(ConvergenceError, "not orthogonal to the null space of A.*setTransposeNullSpace"):
        linear.solve()
    agree(linear.solver.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_NULL)
    linear.A.setTransposeNullSpace(space)
    u = owned(linear.solve())
    b = linear.b.copy()
    space.remove(b)
    equal(whole(u), least_squares(problem, b), TOLERANCE)
    b.destroy()


@pytest.mark.parametrize("formulation", ["dual", "primal"])
def test_message_without_a_null_space(formulation):
    """It names the remedy, and the same solver takes it."""
    problem = elasticity(cube(2, 5), clamped=None)
    linear = torn(problem, {"feti_formulation": formulation})
    said = r"dimension 3: .* leave 2 translations and 1 rotation free.*A\.setNullSpace"
    with raises(ConvergenceError, said):
        linear.solve()
    linear.A.setTransposeNullSpace(give(linear))
    linear.solve()
    linear.A.setNullSpace(PETSc.NullSpace().create(comm=linear.A.comm))  # empty
    with raises(ConvergenceError, said):
        linear.solve()


def mass(free):
    u, v = ufl.TrialFunction(free.V), ufl.TestFunction(free.V)
    return Problem(free.V, free.a + 1e-3 * ufl.inner(u, v) * ufl.dx, free.L, [])


def convection(free):
    u, v = ufl.TrialFunction(free.V), ufl.TestFunction(free.V)
    return Problem(free.V, free.a + u.dx(0) * v * ufl.dx, free.L, [])


@pytest.mark.parametrize("formulation", ["dual", "primal"])
@pytest.mark.parametrize(
    ("change", "message"), [(mass, "no null vector, A resists it"), (convection, "symmetric")]
)
def test_matrices_with_another_null_space(change, message, formulation):
    linear = torn(change(poisson(cube(2, 5), clamped=None)), {"feti_formulation": formulation})
    give(linear)
    with raises(ConvergenceError, message):
        linear.solve()


@pytest.mark.parametrize("formulation", ["dual", "primal"])
def test_vectors_that_are_no_null_space(formulation):
    """Not orthonormal; not zero where a value is prescribed; not all of it."""
    linear = torn(elasticity(cube(2, 5), clamped=None), {"feti_formulation": formulation})
    give(linear, 2)
    with raises(ConvergenceError, "singular, with a kernel of dimension 3"):
        linear.solve()
    twice = [2.0 * z for z in linear.A.getNearNullSpace().getVecs()]
    linear.A.setNullSpace(PETSc.NullSpace().create(vectors=twice, comm=linear.A.comm))
    with raises(ConvergenceError, "not orthonormal"):
        linear.solve()
    clamped = torn(poisson(cube(2, 5)), {"feti_formulation": formulation})
    give(clamped)
    with raises(ConvergenceError, "no null vector, it moves Dirichlet dofs"):
        clamped.solve()


@pytest.mark.parametrize("formulation", ["dual", "primal"])
@pytest.mark.serial
def test_body_in_one_subdomain(formulation):
    """Its kernel lies inside, where no interface feels it; kept interiors have none."""
    problem = poisson(cube(2, 5), clamped=None)
    options = {"feti_formulation": formulation, "feti_interior": "eliminate"}
    linear = torn(problem, options, subdomains=1)
    give(linear)
    with raises(ConvergenceError, "two subdomains, at least"):
        linear.solve()
