# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Problems with a null space are solved in its complement; a wrong one is refused by its fault."""

from dataclasses import replace

from petsc4py import PETSc

import numpy as np
import pytest
from cases import each, every_formulation
from collective import COMM, agree, dense, equal, norm, raises, small, whole
from hand_torn import nowhere, random_values, solve
from problems import cube, dirichlet, elasticity, left, owned, poisson, torn, without

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError
from dolfinx_feti.comparison import assembled_system

RTOL = 1e-10

#: For a residual of 1e-10 and condition numbers up to 1e3 on the complement.
TOLERANCE = 1e-7

METHODS = {
    "dual, all-floating": {"feti_formulation": "dual", "feti_type": "all_floating"},
    "dual, classical, Q = I": {
        "feti_formulation": "dual",
        "feti_type": "classical",
        "feti_coarse_q": "identity",
    },
    "dual, GMRES, lumped": {
        "feti_formulation": "dual",
        "feti_pc_type": "lumped",
        "feti_dual_ksp_type": "gmres",
    },
    "primal": {"feti_formulation": "primal"},
    "interior kept": {"feti_interior": "keep"},
    "the defaults": {},
}
every_method = each("options", METHODS)


def with_form(free, form, *, add=True):
    """Return the problem with a form of u and v added to its bilinear form, or in its place."""
    u = ufl.TrialFunction(free.V)
    v = ufl.TestFunction(free.V)
    return replace(free, a=form(u, v) * ufl.dx + (free.a if add else 0))


def vector_laplacian(mesh):
    """Return a problem whose kernel is two constants, without the rotation."""
    free = elasticity(mesh, clamped=None)
    return with_form(free, lambda u, v: ufl.inner(ufl.grad(u), ufl.grad(v)), add=False)


FREE = {
    "Poisson, P1": (lambda: poisson(cube(2, 7), clamped=None), 1),
    "Poisson, P2": (lambda: poisson(cube(2, 5), degree=2, clamped=None), 1),
    "elasticity, P1": (lambda: elasticity(cube(2, 7), clamped=None), 3),
    "elasticity, P2": (lambda: elasticity(cube(2, 4), degree=2, clamped=None), 3),
    "elasticity in space": (lambda: elasticity(cube(3, 2), clamped=None), 6),
    "Laplacian of a vector": (lambda: vector_laplacian(cube(2, 6)), 2),
}


def linear_problem(problem, options, subdomains=6):
    """Tear a problem, with a tight tolerance and further PETSc options."""
    return torn(problem, subdomains, **{"ksp_rtol": RTOL, **options})


def attach_null_space(linear, count=None, scale=1.0):
    """Attach the first vectors of the near kernel to the matrix as its null space; return it."""
    A, b = linear.linear_system()
    b.destroy()
    vectors = [scale * z for z in A.getNearNullSpace().getVecs()[:count]]
    space = PETSc.NullSpace().create(vectors=vectors, comm=A.comm)
    A.setNullSpace(space)
    return space


def least_squares(linear, b):
    """Return the least-squares solution with the smallest norm, (N,) on each process."""
    K, f = assembled_system(linear.A, b)
    x = np.linalg.lstsq(dense(K), whole(f.array_r), rcond=1e-11)[0]
    K.destroy()
    f.destroy()
    return x


@every_method
@each(("create", "dimension"), FREE)
def test_pure_neumann_problems_have_the_least_squares_solution(create, dimension, options):
    """As PETSc documents it: A has the null space, b is made orthogonal to it, and so is x."""
    problem = create()
    linear = linear_problem(problem, options)
    space = attach_null_space(linear, dimension)
    A, b = linear.linear_system()
    space.remove(b)
    x = A.createVecRight()
    linear.solver.solve(b, x)
    agree(linear.solver.getConvergedReason() > 0, linear.solver.getPythonContext().message)
    equal(whole(x.array_r), least_squares(linear, b), TOLERANCE)
    for z in space.getVecs():
        small(z.dot(x), 1e-14 * x.norm() * np.sqrt(x.getSize()))
    b.destroy()
    x.destroy()


@every_formulation
def test_constant_null_space_agrees_with_a_prescribed_corner(formulation):
    """MUMPS's solution with one dof prescribed is the same up to its mean value.

    Without a number of subdomains there are at least two, as a null space requires.
    """
    mesh = cube(2, 20)
    free = poisson(mesh, degree=2, clamped=None)
    x = ufl.SpatialCoordinate(mesh)
    v = ufl.TestFunction(free.V)
    problem = replace(free, L=(x[0] - 0.5) * v * ufl.dx)
    linear = linear_problem(problem, {"feti_formulation": formulation}, subdomains=None)
    linear.A.setNullSpace(PETSc.NullSpace().create(constant=True, comm=mesh.comm))
    u = owned(linear.solve())
    first = dolfinx.fem.locate_dofs_geometrical(free.V, lambda x: x[0] + x[1] < 1e-8)
    corner = dolfinx.fem.dirichletbc(0.0, first, free.V)
    expected = replace(problem, bcs=[corner]).solve_directly()
    expected -= whole(expected).mean()
    small(norm(u - expected) / norm(expected), TOLERANCE)


@every_method
def test_null_space_may_be_a_part_of_the_rigid_motions(options):
    """A plate on rollers is fixed in one direction, and free to translate in the other."""
    free = elasticity(cube(2, 6), degree=2, clamped=None)
    roll = dirichlet(free.V, left, lambda x: 0.1 + 0.2 * x[1], component=0)
    v = ufl.TestFunction(free.V)
    mesh = free.V.mesh
    x = ufl.SpatialCoordinate(mesh)
    force = ufl.as_vector([x[1], x[0] - 0.5])
    problem = replace(free, L=ufl.inner(force, v) * ufl.dx, bcs=[roll])
    linear = linear_problem(problem, options)
    z = linear.A.createVecRight()
    z.array[1::2] = 1.0
    z.normalize()
    linear.A.setNullSpace(PETSc.NullSpace().create(vectors=[z], comm=mesh.comm))
    u = owned(linear.solve())
    equal(whole(u), least_squares(linear, linear.b), TOLERANCE)
    z.destroy()


@every_formulation
def test_null_space_needs_a_constant_for_each_body(formulation):
    """The sum of both constants is only a part of the null space."""
    halves = without(cube(2, 8), lambda x: (x[0] > 0.37) & (x[0] < 0.63))
    problem = poisson(halves, clamped=None)
    linear = linear_problem(problem, {"feti_formulation": formulation}, subdomains=12)
    A = linear.A
    constants = linear.A.createVecs()
    x = problem.V.tabulate_dof_coordinates()[: constants[0].getLocalSize(), 0]
    for z, is_in_body in zip(constants, (x < 0.5, x > 0.5), strict=True):
        z.array[:] = is_in_body
        z.normalize()
    sum_of_constants = constants[0] + constants[1]
    sum_of_constants.normalize()
    A.setNullSpace(PETSc.NullSpace().create(vectors=[sum_of_constants], comm=A.comm))
    with raises(ConvergenceError, "singular, with a kernel of dimension 2"):
        linear.solve()
    space = PETSc.NullSpace().create(vectors=constants, comm=A.comm)
    A.setNullSpace(space)
    A.setTransposeNullSpace(space)
    u = owned(linear.solve())
    equal(whole(u), least_squares(linear, linear.b), TOLERANCE)


@every_formulation
def test_slender_free_body_takes_few_iterations(formulation):
    """Bending takes little energy; rounding errors along the null space must not grow."""
    mesh = dolfinx.mesh.create_rectangle(COMM, [(0, 0), (100, 1)], (200, 2))
    options = {"feti_formulation": formulation, "ksp_rtol": 1e-8}
    linear = linear_problem(elasticity(mesh, clamped=None), options, subdomains=20)
    linear.A.setTransposeNullSpace(attach_null_space(linear))
    linear.solve()
    agree(linear.solver.getIterationNumber() < 20)


@every_formulation
def test_errors_of_a_free_body_name_the_remedy(formulation):
    """The null space may be missing or empty, or the load unbalanced."""
    problem = elasticity(cube(2, 5), clamped=None)
    linear = linear_problem(problem, {"feti_formulation": formulation})
    remedy = r"dimension 3: .* leave 2 translations and 1 rotation free.*A\.setNullSpace"
    with raises(ConvergenceError, remedy):
        linear.solve()
    space = attach_null_space(linear)
    with raises(ConvergenceError, "not orthogonal to the null space of A.*setTransposeNullSpace"):
        linear.solve()
    agree(linear.solver.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_NULL)
    linear.A.setTransposeNullSpace(space)
    u = owned(linear.solve())
    equal(whole(u), least_squares(linear, linear.b), TOLERANCE)
    linear.A.setNullSpace(PETSc.NullSpace().create(comm=linear.A.comm))  # empty
    with raises(ConvergenceError, remedy):
        linear.solve()


def small_poisson(**clamped):
    """Return a Poisson problem on 5 × 5 squares, clamped on the left if not given otherwise."""
    return poisson(cube(2, 5), **clamped)


REFUSED = {
    "A resists it": (
        lambda: with_form(small_poisson(clamped=None), lambda u, v: 1e-3 * ufl.inner(u, v)),
        {},
        "is not a null vector, A resists it",
    ),
    "unsymmetric": (
        lambda: with_form(small_poisson(clamped=None), lambda u, v: u.dx(0) * v),
        {},
        "symmetric",
    ),
    "moves Dirichlet dofs": (small_poisson, {}, "is not a null vector, it moves Dirichlet dofs"),
    "not all of it": (
        lambda: elasticity(cube(2, 5), clamped=None),
        {"count": 2},
        "singular, with a kernel of dimension 3",
    ),
    "not orthonormal": (
        lambda: elasticity(cube(2, 5), clamped=None),
        {"scale": 2.0},
        "not orthonormal",
    ),
}


@every_formulation
@each(("create", "arguments", "message"), REFUSED)
def test_vectors_that_are_no_null_space_are_refused(create, arguments, message, formulation):
    """The error says what is wrong with them."""
    linear = linear_problem(create(), {"feti_formulation": formulation})
    attach_null_space(linear, **arguments)
    with raises(ConvergenceError, message):
        linear.solve()


@every_formulation
@pytest.mark.serial
def test_null_space_requires_two_subdomains(formulation):
    """In a single one the kernel would be that of the eliminated interior."""
    problem = poisson(cube(2, 5), clamped=None)
    options = {"feti_formulation": formulation, "feti_interior": "eliminate"}
    linear = linear_problem(problem, options, subdomains=1)
    attach_null_space(linear)
    with raises(ConvergenceError, "two subdomains, at least"):
        linear.solve()


def opposed_springs(share, component, components):
    """Return a change that adds springs to one copy of a dof and subtracts them from another.

    The springs vanish from the assembled matrix.
    """

    def change(K, dofs):
        stiffness = share * np.abs(K[0]).max()
        copies = {}
        for i, of_subdomain in enumerate(dofs):
            for row, dof in enumerate(of_subdomain):
                if dof % components == component:
                    copies.setdefault(dof, []).append((i, row))
        for copies_of_dof in copies.values():
            if len(copies_of_dof) > 1:
                for sign, (i, row) in zip((1.0, -1.0), copies_of_dof, strict=False):
                    K[i][row, row] += sign * stiffness

    return change


@every_formulation
@pytest.mark.parametrize("share", [1e-6, 1e-2, 1.0])
@pytest.mark.parametrize("components", [1, 2])
def test_single_subdomains_may_resist_the_null_space(
    components, share, formulation, torn_grid, create_ksp
):
    """If A Z = 0 but K_i Z ≠ 0, the primal form solves, and the dual form reports it.

    With two components the other translation has no springs: a part of the null space is resisted.
    """
    springs = opposed_springs(share, 0, components)
    problem = torn_grid((3, 2), (3, 3), components=components, fixed=nowhere, change=springs)
    A = problem.A
    Z = np.linalg.qr(problem.modes)[0]
    vectors = [problem.vector(z) for z in Z.T]
    A.setNullSpace(PETSc.NullSpace().create(vectors=vectors, comm=COMM))
    b = random_values(problem)
    b -= Z @ (Z.T @ b)
    ksp = create_ksp(A, feti_formulation=formulation, ksp_rtol=RTOL)
    reason, x = solve(ksp, problem, b)
    message = ksp.getPythonContext().message
    if formulation == "dual":
        agree("Single subdomains resist the null space of A" in message, message)
        return
    agree(reason > 0, message)
    if share > 1e-3:
        agree(ksp.getIterationNumber() <= 20)  # no soft field that mixes with Z is deflated
    equal(x, np.linalg.pinv(problem.matrix, rcond=1e-11) @ b, TOLERANCE)


@every_formulation
def test_processes_without_subdomains_solve_beside_a_null_space(formulation, torn_grid, create_ksp):
    """They have no entry of the null vectors, and take part in the same reductions."""
    problem = torn_grid((2, 1), (3, 3), fixed=nowhere)
    Z = np.linalg.qr(problem.modes)[0]
    vectors = [problem.vector(z) for z in Z.T]
    problem.A.setNullSpace(PETSc.NullSpace().create(vectors=vectors, comm=COMM))
    b = random_values(problem)
    b -= Z @ (Z.T @ b)
    ksp = create_ksp(problem.A, feti_formulation=formulation, ksp_rtol=RTOL)
    reason, x = solve(ksp, problem, b)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, np.linalg.pinv(problem.matrix, rcond=1e-11) @ b, TOLERANCE)
