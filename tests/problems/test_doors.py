# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Features of dolfinx scripts: new conditions, null spaces, point loads, condensed blocks."""

from __future__ import annotations

from functools import partial

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small, uniform
from problems import (
    Cell,
    Problem,
    cube,
    dirichlet,
    elasticity,
    everywhere,
    left,
    owned,
    poisson,
    right,
)

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem
from dolfinx_feti.fem.elements import quadratic_with_bubbles
from dolfinx_feti.problems.forms import derive, volume_ratio_of
from dolfinx_feti.runtime.compat import has_vertex_integrals
from dolfinx_feti.scalars import ScalarEquation

RTOL = {"ksp_rtol": 1e-11, "snes_rtol": 1e-10}
KINDS = [{"feti_type": "all_floating"}, {"feti_type": "classical"}, {"feti_formulation": "primal"}]


def direct(a, L, bcs):
    """Solve by dolfinx and MUMPS, and return the owned values."""
    return Problem(L.arguments()[0].ufl_function_space(), a, L, bcs).solve_directly()


def create(a, L, *, nonlinear, **arguments):
    """Create a linear problem, or the nonlinear one with the same residual."""
    arguments = {"subdomains": 4, "petsc_options": RTOL} | arguments
    if not nonlinear:
        return LinearProblem(a, L, **arguments)
    u = dolfinx.fem.Function(L.arguments()[0].ufl_function_space())
    return NonlinearProblem(ufl.action(a, u) - L, u, **arguments)


@pytest.mark.parametrize("options", KINDS)
@pytest.mark.parametrize("make", [poisson, elasticity])
def test_conditions_are_replaced(make, options):
    """After ``bcs`` is replaced, solutions are those of the new conditions."""
    body = make(cube(2, 6))
    V = body.V
    first = [dirichlet(body.V, left)]
    common = {"bcs": first, "petsc_options": {**RTOL, **options}}
    problems = [create(body.a, body.L, nonlinear=kind, **common) for kind in (False, True)]
    second = [dirichlet(V, right)]
    component = [dirichlet(V, right, component=1)] if V.dofmap.bs == 2 else []
    for bcs in (first, [*first, *second], second, first + component, first):
        expected = direct(body.a, body.L, bcs)
        for problem in problems:
            problem.bcs = bcs
            agree(list(problem.bcs) == bcs)
            equal(owned(problem.solve()), expected, 1e-7)
    with raises(ValueError, r"bcs\[0\] lives on another function space"):
        problem.bcs = [dirichlet(poisson(cube(2, 2)).V, left)]
    agree(list(problem.bcs) == first)


def from_five_to_zero(unit, x):
    """Return the values 5 (1 − x₀) of u₀, times a unit, and 0 of u₁."""
    return 5.0 * unit * (1 - x[:2]) * [[1.0], [0.0]]


def test_vector_that_is_no_displacement():
    """A vector without kinematics is solved up to any size, as no det F is watched.

    (1 + |u|²) Δu = 0 with u₀ from 5 to 0: w + w³/3 is linear in x, in any unit of u.
    """
    mesh = cube(2, 8)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    v = ufl.TestFunction(V)
    x = V.tabulate_dof_coordinates()[:, 0]
    found = []
    for unit in (1.0, 1e-3, 1e3):
        u = dolfinx.fem.Function(V)
        bcs = [dirichlet(V, side, partial(from_five_to_zero, unit)) for side in (left, right)]
        k = 1 + ufl.inner(u, u) / unit**2
        form = k * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
        NonlinearProblem(form, u, bcs=bcs, subdomains=4).solve()
        found.append(u.x.array[::2] / unit)
        equal(found[-1], found[0], 1e-6)
    middle = found[0][np.isclose(x[: len(found[0])], 0.5)]
    agree(np.all(np.abs(middle - 3.8687) < 0.05), middle)


def test_volume_ratio_is_watched_only_with_finite_strain_kinematics():
    """Det F is watched if the forms contain kinematics of finite strain, and only then."""
    V = dolfinx.fem.functionspace(cube(2, 2), ("Lagrange", 1, (2,)))
    u = dolfinx.fem.Function(V)
    v = ufl.TestFunction(V)

    def watched(F):
        forms = derive(F, u, J=None, condense=(), energy=None, degree=None)
        return volume_ratio_of(forms) is not None

    H = ufl.grad(u)
    one = ufl.Identity(2)
    F = one + H
    E = H + H.T + H.T * H
    G = ufl.variable(F)
    ways = ufl.tr(F.T * F), ufl.ln(ufl.det(F)), ufl.inner(E, E), ufl.tr(H + one) ** 2
    for term in (*ways, ufl.inner(G, G)):
        agree(watched(term * ufl.dx), term)
        agree(watched(ufl.derivative(term * ufl.dx, u, v)), term)
    s = ufl.inner(H, H)
    eps = ufl.sym(ufl.grad(u))
    sigma = eps + 3 * ufl.tr(eps) * one
    for F in (s * ufl.dx, (1 + s) ** 1.5 * ufl.dx, ufl.inner(sigma, ufl.grad(v)) * ufl.dx):
        agree(not watched(F), F)


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("way", ["argument", "matrix"])
def test_near_null_space_is_the_users(way, nonlinear):
    """A near null space of the user is kept, passed as an argument or set on the matrix."""
    body = elasticity(cube(2, 6))
    x = body.V.tabulate_dof_coordinates()[: body.V.dofmap.index_map.size_local, :2]
    points = PETSc.Vec().createWithArray(x.ravel(), bsize=2, comm=COMM)
    given = PETSc.NullSpace().createRigidBody(points)
    argument = {"near_null_space": given} if way == "argument" else {}
    problem = create(body.a, body.L, nonlinear=nonlinear, bcs=body.bcs, **argument)
    if way == "matrix":
        problem.A.setNearNullSpace(given)
    for _ in range(2):
        found = owned(problem.solve())
        agree(problem.A.getNearNullSpace().handle == given.handle)
        equal(found, body.solve_directly(), 1e-7)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_null_space_gives_the_solution_of_mean_zero(nonlinear):
    """With ``null_space=`` a singular problem in balance has the solution of mean zero."""
    mesh = cube(2, 8)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    x = ufl.SpatialCoordinate(mesh)
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    L = ufl.cos(np.pi * x[0]) * v * ufl.dx
    constant = PETSc.NullSpace().create(constant=True, comm=COMM)
    found = create(a, L, nonlinear=nonlinear, null_space=constant).solve()
    points = V.tabulate_dof_coordinates()[:, 0]
    small(np.abs(found.x.array - np.cos(np.pi * points) / np.pi**2).max(), 3e-3)


def test_point_force_is_balanced_by_the_residual():
    """A force added to a dof of the vector is balanced by the residual of the solution."""
    body = elasticity(cube(2, 6))
    problem = create(body.a, body.L, nonlinear=False, bcs=body.bcs)
    corner = dolfinx.fem.locate_dofs_geometrical(
        body.V, lambda x: np.isclose(x[0], 1.0) & np.isclose(x[1], 1.0)
    )
    here = corner[corner < body.V.dofmap.index_map.size_local]
    A, b = problem.linear_system()
    b.array[2 * here + 1] += 0.25
    x = A.createVecRight()
    problem.solver.solve(b, x)
    r = A.createVecLeft()
    A.mult(x, r)
    error = r.array_r - b.array_r
    body.bcs[0].set(error, None, 0.0)
    uniform(error, 0.0, 1e-9)
    agree(COMM.allreduce(len(here)) == 1)
    for each in (b, x, r):
        each.destroy()


@pytest.mark.skipif(not has_vertex_integrals(), reason="dolfinx 0.9 has no vertex integrals")
def test_vertex_integrals_count_each_vertex_once():
    """Vertex integrals count each vertex once, whatever the decomposition."""
    mesh = cube(2, 6)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    mesh.topology.create_entities(0)
    points = dolfinx.mesh.locate_entities(mesh, 0, lambda x: x[0] + x[1] < 0.6)
    tags = dolfinx.mesh.meshtags(mesh, 0, points, np.full(len(points), 3, dtype=np.int32))
    vertices = ufl.Measure("dP", mesh, subdomain_data=tags)
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + 7.0 * ufl.inner(u, v) * vertices(3)
    L = v[1] * ufl.dx + v[0] * vertices(3)
    found = owned(LinearProblem(a, L, subdomains=5, petsc_options=RTOL).solve())
    equal(found, direct(a, L, []), 1e-7)


PAIRS = [
    ("triangle", ("DG", 0), 1),
    ("triangle", ("DG", 1), 1),
    ("quadrilateral", ("DPC", 1), 1),
    ("quadrilateral", ("DG", 0), 2),
]


@pytest.mark.parametrize("blocks", [False, True])
@pytest.mark.parametrize(("cell", "pressure", "fields"), PAIRS)
def test_condensed_linear_problem(cell, pressure, fields, blocks):
    """A condensed linear problem has the solution of the nonlinear problem's first Newton step."""
    mesh = cube(2, 5, getattr(Cell, cell))
    element = basix.ufl.element("Lagrange", cell, 2, shape=(2,))
    if pressure == ("DG", 1):
        element = basix.ufl.blocked_element(quadratic_with_bubbles(cell), shape=(2,))
    V = dolfinx.fem.functionspace(mesh, element)
    Q = [dolfinx.fem.functionspace(mesh, pressure) for _ in range(fields)]
    found = [dolfinx.fem.Function(space) for space in Q]
    bcs = [dirichlet(V, left)]
    f = ufl.as_vector([0.1, -1.0])

    def left_side(u, v, p, q, theta=None, eta=None):
        shear = 2 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx
        if theta is None:
            return shear + (p * ufl.div(v) + q * ufl.div(u) - p * q / 1e3) * ufl.dx
        volume = p * ufl.div(v) + q * (ufl.div(u) - theta) + eta * (1e3 * theta - p)
        return shear + volume * ufl.dx

    W = ufl.MixedFunctionSpace(V, *Q)
    trials = ufl.TrialFunctions(W)
    tests = ufl.TestFunctions(W)
    pairs = [part for pair in zip(trials, tests, strict=True) for part in pair]
    a = left_side(*pairs)
    L = ufl.inner(f, tests[0]) * ufl.dx
    if blocks:
        a = ufl.extract_blocks(a)
        L = [L, *[None] * fields]
    condense = found[0] if fields == 1 else found
    problem = LinearProblem(a, L, bcs=bcs, condense=condense, subdomains=4, petsc_options=RTOL)
    agree(problem.condenses)
    u = problem.solve()

    state = [dolfinx.fem.Function(space) for space in (V, *Q)]
    twice = [f for f in state for _ in range(2)]  # as in a(u, u)
    energy = 0.5 * left_side(*twice) - ufl.inner(f, state[0]) * ufl.dx
    common = {"bcs": bcs, "condense": state[1:], "subdomains": 3, "petsc_options": RTOL}
    NonlinearProblem(energy, state[0], **common).solve()
    for ours, theirs in zip([u, *found], state, strict=True):
        equal(ours.x.array, theirs.x.array, 1e-6)


def test_condensed_linear_problem_beside_scalars():
    """With a mean displacement prescribed, condensing p = κ div u equals substituting it."""
    mesh = cube(2, 4)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 1)), name="p")
    bcs = [dirichlet(V, left)]
    kappa = 1e2
    dx = ufl.Measure("dx", mesh)

    def shear(u, v):
        return 2 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v)))

    def solved(a, v, **condense):
        u = dolfinx.fem.Function(V)
        s = dolfinx.fem.Constant(mesh, 0.0)
        w = ufl.TestFunction(V)
        mean = ScalarEquation(s, ((u[1] - 0.1) * dx,), s * w[1] * dx)
        common = {"u": u, "bcs": bcs, "subdomains": 4, "petsc_options": RTOL, **condense}
        LinearProblem(a, v[0] * dx, scalars=[mean], **common).solve()
        found = COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(u[1] * dx)))
        small(found - 0.1, 1e-9)
        return u, s.value

    W = ufl.MixedFunctionSpace(V, p.function_space)
    (u, P) = ufl.TrialFunctions(W)
    (v, q) = ufl.TestFunctions(W)
    a = (shear(u, v) + P * ufl.div(v) + q * (ufl.div(u) - P / kappa)) * dx
    ours, force = solved(a, v, condense=p)
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    theirs, other = solved((shear(u, v) + kappa * ufl.div(u) * ufl.div(v)) * dx, v)
    equal(ours.x.array, theirs.x.array, 1e-7)
    small(force / other - 1.0, 1e-7)
    error = dolfinx.fem.form((p - kappa * ufl.div(theirs)) ** 2 * dx)
    small(COMM.allreduce(dolfinx.fem.assemble_scalar(error)), 1e-9)


def test_scalars_follow_replaced_conditions():
    """A problem with scalar unknowns uses replaced conditions, and refuses to have no free dof."""
    body = poisson(cube(2, 6))
    V = body.V
    some = [dirichlet(body.V, left)]
    u = dolfinx.fem.Function(V)
    s = dolfinx.fem.Constant(V.mesh, 0.0)
    dx = ufl.Measure("dx", V.mesh)
    mean = ScalarEquation(s, ((u - 0.2) * dx,), s * ufl.TestFunction(V) * dx)
    common = {"u": u, "scalars": [mean], "subdomains": 4, "petsc_options": RTOL}
    problem = LinearProblem(body.a, body.L, bcs=some, **common)
    first = problem.solve().x.array.copy()
    dofs = np.arange(len(first), dtype=np.int32)
    problem.bcs = [dolfinx.fem.dirichletbc(dolfinx.fem.Function(V), dofs)]
    with raises(ValueError, "depend neither on a free dof of u"):
        problem.solve()
    for bcs, expected in (([dirichlet(V, right)], None), (some, first)):
        problem.bcs = bcs
        again = problem.solve().x.array.copy()
        fresh = LinearProblem(body.a, body.L, bcs=bcs, **common).solve().x.array
        equal(again, fresh if expected is None else expected, 1e-7)


LENGTH = 2.5


@pytest.mark.parametrize("options", [{}, {"feti_formulation": "dual"}, {"feti_type": "classical"}])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("ends", ["held", "springs", "one held"])
def test_any_number_of_intervals(degree, ends, options):
    """Bars of any number of intervals have their closed forms, in any unit of k."""
    mesh = dolfinx.mesh.create_interval(COMM, 40, [0.0, LENGTH])
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    x = V.tabulate_dof_coordinates()[:, 0]
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    if ends == "springs":
        a += u * v * ufl.ds
    value = {"held": x * (LENGTH - x), "one held": x * (2 * LENGTH - x)}
    expected = value.get(ends, LENGTH + x * (LENGTH - x)) / 2
    held = {"held": everywhere, "one held": left}
    bcs = [dirichlet(V, held[ends])] if ends in held else []
    options = {"ksp_rtol": 1e-11, **options}
    for k in (1.0, 1e-9, 1e9):
        for n in (2, 3, 4, 5, 6, 7, 8, 10, 13):
            problem = LinearProblem(k * a, v * ufl.dx, bcs, subdomains=n, petsc_options=options)
            equal(k * problem.solve().x.array, expected, 1e-8)
