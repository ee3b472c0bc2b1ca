# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Reactions on surfaces agree with loads, closed forms, and the balance of forces and moments."""

from mpi4py import MPI

import numpy as np
import pytest
from collective import COMM, equal, raises, small

import dolfinx
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.fem.facets import one_side

#: Newton's and FETI's tolerances of these tests: the balance is as accurate as the solve.
TIGHT = {"ksp_rtol": 1e-12, "snes_rtol": 1e-12}


def boundary(mesh, marker=lambda x: np.ones(x.shape[1], dtype=bool)):
    """Return the boundary facets whose points fulfil a condition."""
    return dolfinx.mesh.locate_entities_boundary(mesh, mesh.topology.dim - 1, marker)


def face(mesh, axis, value):
    """Return the boundary facets on a coordinate plane."""
    return boundary(mesh, lambda x: np.isclose(x[axis], value))


def tagged_measure(mesh, surfaces, metadata=None):
    """Return the measure ds in which the k-th surface has the number k + 1."""
    fdim = mesh.topology.dim - 1
    facets = np.concatenate(surfaces)
    numbers = np.repeat(np.arange(1, 1 + len(surfaces)), [len(each) for each in surfaces])
    order = np.argsort(facets)
    tags = dolfinx.mesh.meshtags(mesh, fdim, facets[order], numbers[order].astype(np.int32))
    return ufl.Measure("ds", mesh, subdomain_data=tags, metadata=metadata)


def clamp(V, facets, component=None):
    """Return the zero condition on facets, of all components or of one."""
    fdim = V.mesh.topology.dim - 1
    if component is None:
        dofs = dolfinx.fem.locate_dofs_topological(V, fdim, facets)
        return dolfinx.fem.dirichletbc(np.zeros(V.value_shape), dofs, V)
    space = V.sub(component)
    return dolfinx.fem.dirichletbc(
        0.0, dolfinx.fem.locate_dofs_topological(space, fdim, facets), space
    )


def elastic(u, v, young=1.0):
    """Return a(u, v) of an isotropic solid with ν = 0.3."""
    strain = ufl.sym(ufl.grad(u))
    dim = len(u)
    lam = young * 0.3 / (1.3 * 0.4)
    mu = young / 2.6
    stress = 2 * mu * strain + lam * ufl.tr(strain) * ufl.Identity(dim)
    return ufl.inner(stress, ufl.grad(v)) * ufl.dx


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_supports_balance_body_force_and_traction(cell, degree):
    """R is minus the sum of body force and traction, and M minus that of their moments."""
    kind = getattr(dolfinx.mesh.CellType, cell)
    mesh = dolfinx.mesh.create_unit_cube(COMM, 3, 3, 3, kind)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    left = face(mesh, 0, 0.0)
    right = face(mesh, 0, 1.0)
    ds = tagged_measure(mesh, [right])
    body = np.array([0.3, -0.2, 0.5])
    traction = np.array([1.0, 2.0, -0.7])
    L = ufl.inner(ufl.as_vector(body), v) * ufl.dx + ufl.inner(ufl.as_vector(traction), v) * ds(1)
    problem = LinearProblem(
        elastic(u, v), L, bcs=[clamp(V, left)], subdomains=4, petsc_options=TIGHT
    )
    problem.solve()
    point = np.array([0.1, 0.2, 0.3])
    support = problem.reaction(left, point=point)
    equal(support.force, -(body + traction), 1e-10)
    arms = np.cross([0.5, 0.5, 0.5] - point, body) + np.cross([1.0, 0.5, 0.5] - point, traction)
    equal(support.moment, -arms, 1e-10)
    equal(problem.reaction(right).force, traction, 1e-10)
    equal(problem.reaction(boundary(mesh)).force, -body, 1e-10)


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("stiffness", [1e-6, 1.0, 1e6])
def test_springs_carry_what_supports_do_not(stiffness, length):
    """The springs at one end of a bar carry the force of the prescribed shift at the other."""
    mesh = dolfinx.mesh.create_rectangle(COMM, [[0.0, 0.0], [2 * length, length]], [8, 4])
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    left = face(mesh, 0, 0.0)
    right = face(mesh, 0, 2 * length)
    below = face(mesh, 1, 0.0)
    ds = tagged_measure(mesh, [left])
    a = elastic(u, v, stiffness) + stiffness / length * u[0] * v[0] * ds(1)
    dofs = dolfinx.fem.locate_dofs_topological(V.sub(0), 1, right)
    moved = dolfinx.fem.dirichletbc(0.1 * length, dofs, V.sub(0))
    zero = dolfinx.fem.Constant(mesh, np.zeros(2))
    problem = LinearProblem(
        a,
        ufl.inner(zero, v) * ufl.dx,
        bcs=[moved, clamp(V, below, 1)],
        subdomains=4,
        petsc_options=TIGHT,
    )
    uh = problem.solve()
    spring = problem.reaction(left).force
    held = problem.reaction(right).force
    own = dolfinx.fem.assemble_scalar(dolfinx.fem.form(-stiffness / length * uh[0] * ds(1)))
    exact = COMM.allreduce(own, op=MPI.SUM)
    equal(spring[:1], [exact], 1e-10)
    equal(held[:1], -spring[:1], 1e-8)


def test_flux_of_a_scalar_unknown():
    """All heat of a source in the unit square leaves through its one cold side."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 8, 8)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    left = face(mesh, 0, 0.0)
    problem = LinearProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        v * ufl.dx,
        bcs=[clamp(V, left)],
        subdomains=4,
        petsc_options=TIGHT,
    )
    problem.solve()
    found = problem.reaction(left)
    equal(found.force, [-1.0], 1e-10)
    assert found.moment is None


@pytest.mark.parametrize("compressible", [True, False], ids=["compressible", "condensed"])
def test_large_deformation_balances_forces_and_moments(compressible):
    """In the deformed state, forces and moments of a follower pressure sum to zero."""
    mesh = dolfinx.mesh.create_box(COMM, [[0, 0, 0], [1, 1, 2]], [2, 2, 4])
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u = dolfinx.fem.Function(V)
    v = ufl.TestFunction(V)
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    metadata = {"quadrature_degree": 4}
    dx = ufl.dx(metadata=metadata)
    F = kinematics.deformation_gradient(u)
    C = kinematics.right_cauchy_green(F)
    J = kinematics.jacobian(F)
    if compressible:
        energy = (materials.neo_hookean(C, c=1.0, J=J) + 5 * (J - 1) ** 2) * dx
        residuals = ufl.derivative(energy, u, v)
    else:
        psi = materials.neo_hookean(C, c=1.0, J=J) + materials.perturbed_lagrangian(
            J, p, kappa=100.0
        )
        residuals = [
            ufl.derivative(psi * dx, u, v),
            ufl.derivative(psi * dx, p, ufl.TestFunction(p.function_space)),
        ]
    foot = face(mesh, 2, 0.0)
    side = face(mesh, 0, 1.0)
    ds = tagged_measure(mesh, [side], metadata)
    load = loads.follower_pressure(dolfinx.fem.Constant(mesh, 0.05), u, v, ds(1))
    if compressible:
        residuals += load
    else:
        residuals[0] += load
    problem = NonlinearProblem(
        residuals,
        u,
        bcs=[clamp(V, foot)],
        condense=None if compressible else p,
        subdomains=4,
        petsc_options=TIGHT,
    )
    problem.solve()
    point = [0.3, -0.2, 0.1]
    support = problem.reaction(foot, point=point)
    pressed = problem.reaction(side, point=point)
    scale = np.abs(pressed.force).max()
    small(np.abs(support.force + pressed.force).max() / scale, 1e-9)
    small(np.abs(support.moment + pressed.moment).max() / scale, 1e-9)
    small(np.abs(problem.reaction(boundary(mesh)).force).max() / scale, 1e-9)


def reactions_with_springs(where, side=None):
    """Return the sum of the reactions of a support and of springs inside; the load is 1.

    Args:
        where: Marker of the facets with springs.
        side: The side of each facet that the integral takes, see ``one_side``.
    """
    mesh = dolfinx.mesh.create_unit_square(COMM, 8, 8)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    inside = dolfinx.mesh.locate_entities(mesh, 1, where)
    ds = ufl.Measure("ds", mesh, subdomain_data=[(1, one_side(mesh, inside, side=side))])
    left = face(mesh, 0, 0.0)
    problem = LinearProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + 3.0 * u * v * ds(1),
        v * ufl.dx,
        bcs=[clamp(V, left)],
        subdomains=4,
        petsc_options=TIGHT,
    )
    problem.solve()
    return problem.reaction(left).force + problem.reaction(inside).force


def test_surface_inside_the_mesh_given_by_pairs():
    """Springs on an inner line, facets with a side, balance the load together with the support."""
    total = reactions_with_springs(lambda x: np.isclose(x[0], 0.5))
    equal(total, [-1.0], 1e-10)


def test_surface_inside_that_branches():
    """Springs on a cross, which has no outer side, balance the load with the support."""

    def on_cross(x):
        return np.isclose(x[0], 0.5) | np.isclose(x[1], 0.5)

    equal(reactions_with_springs(on_cross, side="any"), [-1.0], 1e-10)


@pytest.mark.parametrize(
    ("facets", "message"),
    [
        (np.array([], dtype=np.int32), "facets is empty on all processes"),
        (np.array([0.5]), "give an array of numbers of facets"),
        (np.array([10**6]), "facets contains 1000000"),
    ],
    ids=["none", "no-numbers", "too-large"],
)
def test_wrong_facets_are_named(facets, message):
    """Wrong facets raise an error on all processes."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 4, 4)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    problem = LinearProblem(
        u * v * ufl.dx, v * ufl.dx, subdomains=4, petsc_options_prefix="wrong_facets_"
    )
    problem.solve()
    with raises(ValueError, message):
        problem.reaction(facets)
