# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Scalar unknowns of both problem classes, also on real spaces, agree with other solves."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from inflated import balloon, balloon_cavity, create_rubber_body
from newton_by_hand import newton_by_hand
from problems import cube, elasticity, left, owned, poisson

import dolfinx
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem
from dolfinx_feti.scalars import Cavity, ScalarEquation, mean_value, rigid_motions

EXACT = {"ksp_rtol": 1e-11, "snes_rtol": 1e-11}


def null_space_solution(free, b_form):
    """Solve with the null space given to A, as PETSc takes it; its part is taken out of b.

    Args:
        free: Problem that nothing holds.
        b_form: Linear form of its load.

    Returns:
        The linear problem, and the owned values of the solution, (N,).
    """
    linear = LinearProblem(free.a, b_form, subdomains=6, petsc_options={"ksp_rtol": 1e-12})
    A, b = linear.linear_system()
    space = PETSc.NullSpace().create(vectors=A.getNearNullSpace().getVecs(), comm=A.comm)
    A.setNullSpace(space)
    space.remove(b)
    x = A.createVecRight()
    linear.solver.solve(b, x)
    agree(linear.solver.getConvergedReason() > 0)
    return linear, x.array_r.copy()


def twisting_load(V):
    """Return a load without resultant and moment: opposite tractions on two faces."""
    x = ufl.SpatialCoordinate(V.mesh)
    v = ufl.TestFunction(V)
    force = ufl.as_vector([x[1] - 0.5, x[0] - 0.5, 0.0])
    return ufl.inner(force, v) * ufl.dx


@pytest.mark.parametrize("nonlinear", [False, True])
def test_rigid_motions_hold_a_free_body(nonlinear):
    """Six mean values give the solution with a null space, up to a rigid motion, without force."""
    free = elasticity(cube(3, 3), clamped=None)
    L = twisting_load(free.V)
    linear, expected = null_space_solution(free, L)
    u = dolfinx.fem.Function(free.V)
    motions = rigid_motions(u)
    if nonlinear:
        a = ufl.replace(free.a, {free.a.arguments()[1]: u})
        NonlinearProblem(a - L, u, subdomains=6, scalars=[motions], petsc_options=EXACT).solve()
    else:
        LinearProblem(free.a, L, u=u, subdomains=6, scalars=[motions], petsc_options=EXACT).solve()
    w = dolfinx.fem.Function(free.V)
    w.x.array[: len(expected)] = expected
    w.x.scatter_forward()
    difference = owned(u) - owned(w)
    for z in linear.A.getNearNullSpace().getVecs():
        difference -= z.array_r * COMM.allreduce(float(z.array_r @ difference))
    scale = np.sqrt(COMM.allreduce(float(owned(w) @ owned(w))))
    small(np.sqrt(COMM.allreduce(float(difference @ difference))) / scale, 1e-8)
    for c in motions.equations:
        small(abs(COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(c)))), 1e-8 * scale)
    small(np.abs(motions.unknown.value).max(), 1e-8)


def two_blocks():
    """Return two unit cubes that do not touch, and the measure of their cells, 1 and 2."""
    box = dolfinx.mesh.create_box(COMM, [(0.0, 0.0, 0.0), (3.0, 1.0, 1.0)], (6, 2, 2))
    outside = np.abs(midpoints(box)[:, 0] - 1.5) > 0.5
    mesh = dolfinx.mesh.create_submesh(box, 3, np.flatnonzero(outside).astype(np.int32))[0]
    body_of_cell = 1 + (midpoints(mesh)[:, 0] > 1.5).astype(np.int32)
    cells = np.arange(len(body_of_cell), dtype=np.int32)
    tags = dolfinx.mesh.meshtags(mesh, 3, cells, body_of_cell)
    return mesh, ufl.Measure("dx", mesh, subdomain_data=tags)


@pytest.mark.parametrize("clamped", [False, True])
@pytest.mark.parametrize("form", ["dual", "primal"])
def test_each_floating_body_has_its_rigid_motions(form, clamped):
    """Multipliers are the resultants of a load that is not balanced, also beside a clamped body."""
    mesh, dx = two_blocks()
    block = elasticity(mesh, clamped=left if clamped else None)
    u = dolfinx.fem.Function(block.V)
    v = ufl.TestFunction(block.V)
    x = ufl.SpatialCoordinate(mesh)
    force = np.array([0.0, 0.0, 0.1])
    L = ufl.inner(dolfinx.fem.Constant(mesh, force), v) * dx
    for k, middle in ((1, 0.5), (2, 2.5)):
        L += (x[0] - middle) * v[0] * dx(k)  # in balance
    all_motions = [rigid_motions(u, dx(k)) for k in ((2,) if clamped else (1, 2))]
    LinearProblem(
        block.a,
        L,
        bcs=block.bcs,
        u=u,
        subdomains=6,
        scalars=all_motions,
        petsc_options=EXACT | {"feti_formulation": form},
    ).solve()
    equal(all_motions[-1].unknown.value[:3], force, 1e-8)
    for motions in all_motions:
        means = [dolfinx.fem.assemble_scalar(dolfinx.fem.form(c)) for c in motions.equations]
        small(np.abs(COMM.allreduce(np.array(means))).max(), 1e-12)
    size = COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(ufl.inner(u, u) * dx(2))))
    agree(size > 1e-8)


def compressible(ball):
    """Return an energy without condensed pressure."""
    F = ufl.Identity(3) + ufl.grad(ball.u)
    J = ufl.det(F)
    return (0.5 * (ufl.inner(F, F) - 3.0 - 2.0 * ufl.ln(J)) + 5.0 * (J - 1.0) ** 2) * ufl.dx(
        metadata={"quadrature_degree": 4}
    )


def test_cavity_agrees_with_a_bordered_newton_solve():
    """The other solve has the matrix of dolfinx and a dense border."""
    ball = balloon(2)
    cavity = balloon_cavity(ball, 1.1)
    energy = compressible(ball)
    problem = NonlinearProblem(
        energy, ball.u, bcs=ball.bcs, subdomains=4, scalars=[cavity], petsc_options=EXACT
    )
    problem.solve()
    other = balloon(2)
    target = balloon_cavity(other, 1.1)
    F = ufl.derivative(compressible(other), other.u, ufl.TestFunction(other.u.function_space))
    (c,) = target.equation.equations
    newton_by_hand(F + target.work, other.u, other.bcs, target.pressure, c)
    equal(owned(ball.u), owned(other.u), 1e-8)
    small(abs(cavity.pressure.value / target.pressure.value - 1.0), 1e-8)


def block_with_two_cavities():
    """Return a block with two cubes left out: two closed cavities."""
    box = dolfinx.mesh.create_box(COMM, [(0.0, 0.0, 0.0), (5.0, 3.0, 3.0)], (5, 3, 3))
    centres = midpoints(box)
    inside = [np.abs(centres - c).max(axis=1) < 0.5 for c in ((1.5, 1.5, 1.5), (3.5, 1.5, 1.5))]
    cells = np.flatnonzero(~(inside[0] | inside[1])).astype(np.int32)
    mesh = dolfinx.mesh.create_submesh(box, 3, cells)[0]

    def around(place):
        centre = np.array([[place], [1.5], [1.5]])
        return lambda x: np.abs(x - centre).max(axis=0) < 0.51

    planes = [(axis, 0.0) for axis in range(3)]
    return create_rubber_body(mesh, planes, [around(1.5), around(3.5)], kappa=50.0)


def midpoints(mesh):
    """Return the midpoints of the cells on this process, (cells, 3)."""
    index_map = mesh.topology.index_map(3)
    cells = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    return dolfinx.mesh.compute_midpoints(mesh, 3, cells)


@pytest.mark.parametrize("form", ["dual", "primal"])
def test_two_cavities_have_their_volumes(form):
    """One grows, the other one shrinks; pressures are the same on any number of processes."""
    block = block_with_two_cavities()
    cavities = [Cavity(block.u, block.ds(i), volume=V) for i, V in ((1, 1.15), (2, 0.9))]
    small(max(abs(cavity.present_volume() - 1.0) for cavity in cavities), 1e-12)
    options = {"snes_rtol": 1e-10, "feti_formulation": form}
    problem = block.problem(cavities, petsc_options=options)
    problem.solve()
    for cavity in cavities:
        small(abs(cavity.present_volume() / cavity.volume.value - 1.0), 1e-8)
    small(problem.residual_norm(), 1e-8)  # pressures on areas of 1 mm²: forces of about 0.2
    pressures = [float(cavity.pressure.value) for cavity in cavities]
    equal(pressures, [0.17334586685, -0.13805268779], 1e-7)


def times(form, factor):
    """Multiply the integrands of a form."""
    return ufl.Form([i.reconstruct(integrand=factor * i.integrand()) for i in form.integrals()])


def test_scalars_on_a_real_space_agree_with_a_cavity():
    """A script for dolfinx and scifem has F in blocks, or a Lagrangian."""
    scifem = pytest.importorskip("scifem")
    results = []
    for kind in ("cavity", "blocks", "Lagrangian"):
        ball = balloon(2)
        cavity = balloon_cavity(ball, 1.15)
        energy = compressible(ball)
        V = ball.u.function_space
        R = scifem.create_real_functionspace(V.mesh)
        s = dolfinx.fem.Function(R)
        t = ufl.TestFunction(R)
        (c,) = cavity.equation.equations
        if kind == "cavity":
            F = energy
            u = ball.u
            scalars = [cavity]
        elif kind == "blocks":
            v = ufl.TestFunction(V)
            F_u = ufl.derivative(energy - times(cavity.form, s), ball.u, v)
            F = [F_u, times(c, t)]
            u = [ball.u, s]
            scalars = []
        else:
            F = energy - times(c, s)
            u = [ball.u, s]
            scalars = []
        problem = NonlinearProblem(
            F, u, bcs=ball.bcs, subdomains=4, scalars=scalars, petsc_options=EXACT
        )
        agree(problem.solve() is u)
        pressure = cavity.pressure.value if kind == "cavity" else s.x.array[0]
        results.append((owned(ball.u), float(pressure)))
    for u, pressure in results[1:]:
        equal(u, results[0][0], 1e-8)
        small(abs(pressure / results[0][1] - 1.0), 1e-8)


def test_mean_value_on_a_real_space_agrees_with_scalars():
    """Scifem's example −Δu = f in blocks is the same as LinearProblem with ``scalars=``."""
    scifem = pytest.importorskip("scifem")
    free = poisson(cube(2, 8), clamped=None)
    R = scifem.create_real_functionspace(free.V.mesh)
    u = dolfinx.fem.Function(free.V)
    s = dolfinx.fem.Function(R)
    v = ufl.TestFunction(free.V)
    t = ufl.TestFunction(R)
    f = (ufl.cos(ufl.pi * ufl.SpatialCoordinate(free.V.mesh)[0]) + 0.3) * v * ufl.dx
    a = ufl.replace(free.a, {free.a.arguments()[1]: u})
    F = [a - f + s * v * ufl.dx, (u - 0.7) * t * ufl.dx]
    problem = NonlinearProblem(F, [u, s], subdomains=6, petsc_options=EXACT)
    agree(problem.solve()[0] is u and len(problem.history) == 1, problem.history)
    small(abs(s.x.array[0] - 0.3), 1e-9)  # the load
    w = dolfinx.fem.Function(free.V)
    LinearProblem(
        free.a, f, u=w, subdomains=6, scalars=[mean_value(w, 0.7)], petsc_options=EXACT
    ).solve()
    equal(owned(u), owned(w), 1e-8)
    q = ufl.TrialFunction(R)
    z = free.a.arguments()[1]
    a = [[free.a, q * v * ufl.dx], [z * t * ufl.dx, None]]
    L = [f, 0.7 * t * ufl.dx(free.V.mesh)]
    for order in (1, -1):
        blocks = [row[::order] for row in a[::order]], L[::order]
        linear = LinearProblem(*blocks, subdomains=6, petsc_options=EXACT)
        solution = linear.solve()
        equal(owned(solution[::order][0]), owned(w), 1e-8)
        small(abs(solution[::order][1].x.array[0] - 0.3), 1e-9)
    with raises(ValueError, "There are 2 unknowns: give a as 2 × 2 blocks"):
        LinearProblem(free.a, f, u=[w, s])


@pytest.mark.parametrize("shape", [(), (2,)], ids=["scalar", "vector"])
def test_blocks_of_the_tangent_in_scalars_are_used(shape):
    """The force of the scalars, s + s³, is outside of UFL: the user's J has its derivative.

    The steps are those with the force in F.
    """
    scifem = pytest.importorskip("scifem")
    mesh = cube(2, 6)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, shape))
    R = scifem.create_real_functionspace(mesh, shape)
    v, t, du, ds = (make(W) for make in (ufl.TestFunction, ufl.TrialFunction) for W in (V, R))
    force = dolfinx.fem.Constant(mesh, np.zeros(shape))
    load = ufl.SpatialCoordinate(mesh)[0] * (v[1] if shape else v) * ufl.dx
    common = {"subdomains": 4, "petsc_options": EXACT}

    def solved(outside):
        u = dolfinx.fem.Function(V, name="u")
        s = dolfinx.fem.Function(R, name="s")
        cubes = ufl.as_vector([a**3 for a in s]) if shape else s**3
        inside = s + cubes

        def update(_):
            values = s.x.array[: force.value.size].reshape(shape)
            force.value = values + values**3

        F_u = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx - load
        F_u += ufl.inner(u, u) * ufl.inner(u, v) * ufl.dx
        F_u += ufl.inner(force if outside else inside, v) * ufl.dx
        F_s = ufl.inner(u, t) * ufl.dx + 0.1 * ufl.inner(cubes, t) * ufl.dx
        F_s -= 0.05 * (sum(t) if shape else t) * ufl.dx(mesh)
        if not outside:
            problem = NonlinearProblem([F_u, F_s], [u, s], **common)
        else:
            column = ufl.derivative(ufl.inner(inside, v) * ufl.dx, s, ds)
            J = [
                [ufl.derivative(F_u, u, du), column],
                [ufl.derivative(F_s, u, du), ufl.derivative(F_s, s, ds)],
            ]
            problem = NonlinearProblem([F_u, F_s], [u, s], J=J, before_assembly=update, **common)
        problem.solve()
        return owned(u), s.x.array.copy(), len(problem.history)

    u, s, steps = solved(outside=True)
    expected_u, expected_s, expected_steps = solved(outside=False)
    equal(u, expected_u, 1e-8)
    equal(s, expected_s, 1e-8)
    agree(steps == expected_steps and steps > 2, (steps, expected_steps))


def test_residuals_are_assigned_to_scalars_by_their_spaces():
    """Any order is allowed where each space occurs once; what does not fit is named."""
    scifem = pytest.importorskip("scifem")
    mesh = cube(2, 4)
    R1, R2 = (scifem.create_real_functionspace(mesh, shape) for shape in ((), (2,)))
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u, m, s = (dolfinx.fem.Function(W, name=n) for W, n in ((V, "u"), (R2, "m"), (R1, "s")))
    (v, t2, t1) = map(ufl.TestFunction, (V, R2, R1))
    x = ufl.SpatialCoordinate(mesh)
    F_u = ufl.inner(ufl.grad(u), ufl.grad(v)) + ufl.dot(m, v) + s * (x[1] * v[0] - x[0] * v[1])
    F_m = ufl.dot(u, t2)
    F_s = (x[1] * u[0] - x[0] * u[1] - 0.1) * t1
    F_u, F_m, F_s = (form * ufl.dx for form in (F_u, F_m, F_s))
    solutions = []
    common = {"subdomains": 4, "petsc_options": EXACT}
    for F in ([F_u, F_m, F_s], [F_u, F_s, F_m], [F_s, F_u, F_m]):
        for f in (u, m, s):
            f.x.array[:] = 0.0
        NonlinearProblem(F, [u, m, s], **common).solve()
        solutions.append(np.append(m.x.array, s.x.array))
    agree(np.abs(solutions[0]).min() > 1e-3, solutions)
    for other in solutions[1:]:
        equal(other, solutions[0], 1e-8)
    with raises(ValueError, "0 residuals tested in the space of the scalar 'm', but 1 scalars"):
        NonlinearProblem([F_u, F_s, F_s], [u, m, s], **common)
    with raises(ValueError, "1 residuals tested in real spaces for 2 scalars: give one for each"):
        NonlinearProblem([F_u, F_m], [u, m, s], **common)


def test_scalars_must_not_couple_with_condensed_fields():
    """A cell eliminates its fields alone: neither equation may contain the other's unknown."""
    octant = balloon(2)
    one = dolfinx.fem.Constant(octant.u.function_space.mesh, 0.0)
    dx = ufl.Measure("dx", octant.u.function_space.mesh)
    v, q = (ufl.TestFunction(f.function_space) for f in (octant.u, octant.p))
    mean = ScalarEquation(one, ((octant.p - 1.0) * dx,), one * ufl.div(v) * dx)
    with raises(ValueError, r"scalars\[0\] contains the condensed field p"):
        octant.problem([mean])
    volume = ScalarEquation(one, (ufl.div(octant.u) * dx,), one * ufl.div(v) * dx)
    residuals = [ufl.derivative(octant.energy, f, w) for f, w in ((octant.u, v), (octant.p, q))]
    residuals[1] += one * q * dx
    with raises(ValueError, r"condensed field p contains scalars\[0\]"):
        NonlinearProblem(
            residuals, octant.u, bcs=octant.bcs, condense=octant.p, scalars=[volume], subdomains=6
        )
