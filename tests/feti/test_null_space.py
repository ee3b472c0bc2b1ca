# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A null space given to the matrix: solved in its complement, or refused with what is wrong."""

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


def changed(free, form, *, add=True):
    """Add a form of u and v to the matrix of a problem, or put it in its place."""
    u = ufl.TrialFunction(free.V)
    v = ufl.TestFunction(free.V)
    return replace(free, a=form(u, v) * ufl.dx + (free.a if add else 0))


def vectors_laplacian(mesh):
    """Two constants, and no rotation, are the kernel."""
    free = elasticity(mesh, clamped=None)
    return changed(free, lambda u, v: ufl.inner(ufl.grad(u), ufl.grad(v)), add=False)


FREE = {
    "Poisson, P1": (lambda: poisson(cube(2, 7), clamped=None), 1),
    "Poisson, P2": (lambda: poisson(cube(2, 5), degree=2, clamped=None), 1),
    "elasticity, P1": (lambda: elasticity(cube(2, 7), clamped=None), 3),
    "elasticity, P2": (lambda: elasticity(cube(2, 4), degree=2, clamped=None), 3),
    "elasticity in space": (lambda: elasticity(cube(3, 2), clamped=None), 6),
    "Laplacian of a vector": (lambda: vectors_laplacian(cube(2, 6)), 2),
}


def linear_problem(problem, options, subdomains=6):
    return torn(problem, subdomains, **{"ksp_rtol": RTOL, **options})


def give(linear, count=None, scale=1.0):
    """Attach the first vectors of the near kernel to the matrix as its null space."""
    A, b = linear.linear_system()
    b.destroy()
    vectors = [scale * z for z in A.getNearNullSpace().getVecs()[:count]]
    space = PETSc.NullSpace().create(vectors=vectors, comm=A.comm)
    A.setNullSpace(space)
    return space


def least_squares(linear, b):
    """Return the shortest solution of the assembled system, whole."""
    K, f = assembled_system(linear.A, b)
    x = np.linalg.lstsq(dense(K), whole(f.array_r), rcond=1e-11)[0]
    K.destroy()
    f.destroy()
    return x


@every_method
@each(("create", "dimension"), FREE)
def test_pure_neumann_problems(create, dimension, options):
    """PETSc's way: the null space is given to A and removed from b; x is orthogonal to it."""
    problem = create()
    linear = linear_problem(problem, options)
    space = give(linear, dimension)
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
def test_against_mumps_with_a_dof_prescribed(formulation):
    """Without a number of subdomains there are two at least; PETSc's null space of constants."""
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
def test_what_a_condition_leaves(options):
    """A plate on rollers: prescribed on one side, in one direction; free in the other."""
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
def test_two_bodies(formulation):
    """Each has its constant; the sum of both is only a part of the null space."""
    halves = without(cube(2, 8), lambda x: (x[0] > 0.37) & (x[0] < 0.63))
    problem = poisson(halves, clamped=None)
    linear = linear_problem(problem, {"feti_formulation": formulation}, subdomains=12)
    A = linear.A
    constants = linear.A.createVecs()
    x = problem.V.tabulate_dof_coordinates()[: constants[0].getLocalSize(), 0]
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
    equal(whole(u), least_squares(linear, linear.b), TOLERANCE)


@every_formulation
def test_slender_and_free(formulation):
    """Bending takes little energy; rounding errors along the null space must not grow."""
    mesh = dolfinx.mesh.create_rectangle(COMM, [(0, 0), (100, 1)], (200, 2))
    options = {"feti_formulation": formulation, "ksp_rtol": 1e-8}
    linear = linear_problem(elasticity(mesh, clamped=None), options, subdomains=20)
    linear.A.setTransposeNullSpace(give(linear))
    linear.solve()
    agree(linear.solver.getIterationNumber() < 20, linear.solver.getIterationNumber())


@every_formulation
def test_messages_name_the_remedy(formulation):
    """Without a null space, or an empty one; with a load that nothing balances; and none after."""
    problem = elasticity(cube(2, 5), clamped=None)
    linear = linear_problem(problem, {"feti_formulation": formulation})
    said = r"dimension 3: .* leave 2 translations and 1 rotation free.*A\.setNullSpace"
    with raises(ConvergenceError, said):
        linear.solve()
    space = give(linear)
    with raises(ConvergenceError, "not orthogonal to the null space of A.*setTransposeNullSpace"):
        linear.solve()
    agree(linear.solver.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_NULL)
    linear.A.setTransposeNullSpace(space)
    u = owned(linear.solve())
    equal(whole(u), least_squares(linear, linear.b), TOLERANCE)
    linear.A.setNullSpace(PETSc.NullSpace().create(comm=linear.A.comm))  # empty
    with raises(ConvergenceError, said):
        linear.solve()


def scalar(**clamped):
    return poisson(cube(2, 5), **clamped)


REFUSED = {
    "A resists it": (
        lambda: changed(scalar(clamped=None), lambda u, v: 1e-3 * ufl.inner(u, v)),
        {},
        "is not a null vector, A resists it",
    ),
    "unsymmetric": (
        lambda: changed(scalar(clamped=None), lambda u, v: u.dx(0) * v),
        {},
        "symmetric",
    ),
    "moves Dirichlet dofs": (scalar, {}, "is not a null vector, it moves Dirichlet dofs"),
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
@each(("create", "how", "message"), REFUSED)
def test_vectors_that_are_no_null_space(create, how, message, formulation):
    linear = linear_problem(create(), {"feti_formulation": formulation})
    give(linear, **how)
    with raises(ConvergenceError, message):
        linear.solve()


@every_formulation
@pytest.mark.serial
def test_body_in_one_subdomain(formulation):
    """The kernel is that of an eliminated interior; the message asks for two subdomains."""
    problem = poisson(cube(2, 5), clamped=None)
    options = {"feti_formulation": formulation, "feti_interior": "eliminate"}
    linear = linear_problem(problem, options, subdomains=1)
    give(linear)
    with raises(ConvergenceError, "two subdomains, at least"):
        linear.solve()


def opposed_springs(share, component, components):
    """Add springs to one copy of a dof, and subtract them from another: their sum is zero.

    Args:
        share: Stiffness of the springs, relative to the largest entry of K_i.
        component: Component of the dofs that have springs.
        components: Number of components of a node.
    """

    def change(K, dofs):
        stiffness = share * np.abs(K[0]).max()
        copies = {}
        for i, of_subdomain in enumerate(dofs):
            for row, dof in enumerate(of_subdomain):
                if dof % components == component:
                    copies.setdefault(dof, []).append((i, row))
        for of_dof in copies.values():
            if len(of_dof) > 1:
                for sign, (i, row) in zip((1.0, -1.0), of_dof, strict=False):
                    K[i][row, row] += sign * stiffness

    return change


@every_formulation
@pytest.mark.parametrize("share", [1e-6, 1e-2, 1.0])
@pytest.mark.parametrize("components", [1, 2])
def test_subdomains_that_resist_the_null_space(
    components, share, formulation, torn_grid, create_ksp
):
    """A Z = 0, but K_i Z ≠ 0: the primal form solves, and the dual one names it.

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
    equal(x, np.linalg.pinv(problem.matrix, rcond=1e-11) @ b, TOLERANCE)
