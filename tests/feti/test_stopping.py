# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A linear solve converges by residual and estimated error, which a penalty cannot hide."""

from __future__ import annotations

import logging

from petsc4py import PETSc

import numpy as np
import pytest
from cases import case, each, every_formulation, every_type
from collective import COMM, agree, equal, logged_messages, small, whole
from hand_torn import random_values, solve, unsymmetric
from penalty import (
    bar_mesh,
    direct_solution,
    far,
    heavy_bar,
    jump_bar,
    nitsche_bar,
    off_by,
    spring_bar,
)
from problems import Problem, cube, dirichlet, elasticity, left, owned, poisson, tagged, torn

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, LinearProblem
from dolfinx_feti.feti.accuracy import ComponentNorms
from dolfinx_feti.feti.report import format_report
from dolfinx_feti.scalars.border import Border
from dolfinx_feti.scalars.bordered import BorderedSolver

Reason = PETSc.KSP.ConvergedReason
HEXAHEDRON = dolfinx.mesh.CellType.hexahedron
QUADRILATERAL = dolfinx.mesh.CellType.quadrilateral

#: Difference to a direct solution that the default tolerance of 1e-8 allows: η is the error within
#: a factor of ten in l2, and its greatest entry is off by no more than ten times that.
ACCURATE = 1e-6


def check_against_mumps(problem, tolerance=ACCURATE):
    """Assert that a solution agrees with MUMPS, and η with its error; return the FETI context."""
    u = problem.solve()
    exact = direct_solution(problem)
    small(off_by(owned(u), exact), tolerance)
    feti = problem.solver.getPythonContext()
    error = np.sqrt(COMM.allreduce(np.sum((owned(u) - exact) ** 2)))
    size = np.sqrt(COMM.allreduce(np.sum(exact**2)))
    if np.isnan(feti.floor):  # else the direct solution is off by rounding, too
        allowed = (10.0 * feti.error_estimate + 1e-12) * size
        agree(error <= allowed, (error / size, feti.error_estimate))
    agree(feti.error_estimate <= 1e-8 or feti.error_floor > 0.0, feti.error_estimate)
    return feti


# ---- penalties ------------------------------------------------------------------------------


@every_formulation
@pytest.mark.parametrize("ratio", [1e2, 1e4, 1e6, 1e8, 1e10], ids="{:g}".format)
def test_iterations_do_not_grow_with_a_penalty(ratio, formulation):
    """The residual is relative to the penalty, so the estimated error ends the solve."""
    problem = torn(spring_bar(bar_mesh(2), ratio), 6, feti_formulation=formulation)
    feti = check_against_mumps(problem)
    agree(feti.iterations <= 20)


MESHES = {
    "P1 triangles": (2, None, 4, 1),
    "P2 triangles": (2, None, 3, 2),
    "Q2 quadrilaterals": (2, QUADRILATERAL, 3, 2),
    "P1 tetrahedra": (3, None, 3, 1),
    "P2 tetrahedra": (3, None, 2, 2),
    "Q1 hexahedra": (3, HEXAHEDRON, 3, 1),
}


@every_formulation
@pytest.mark.parametrize("body", [spring_bar, nitsche_bar, heavy_bar, jump_bar])
@each("mesh", MESHES)
def test_penalties_are_solved_accurately_with_every_element(mesh, body, formulation):
    """Springs, Nitsche's method, heavy ends and stiffness jumps hide errors from the residual."""
    dim, cell, cells, degree = mesh
    ratio = 1e4 if body is jump_bar else 1e7
    problem = torn(body(bar_mesh(dim, cell, cells), ratio, degree), 6, feti_formulation=formulation)
    check_against_mumps(problem)


@every_formulation
def test_large_heat_transfer_coefficient_is_solved_accurately(formulation):
    """Heat conduction with a coefficient of 1e8 to a temperature of 20."""
    mesh = cube(3, 6)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    T = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    ds = tagged(mesh, lambda x: np.isclose(x[0], 1.0))(1)
    a = ufl.inner(ufl.grad(T), ufl.grad(v)) * ufl.dx + 1e8 * T * v * ds
    L = v * ufl.dx + 1e8 * 20.0 * v * ds
    check_against_mumps(
        torn(Problem(V, a, L, [dirichlet(V, left)]), 6, feti_formulation=formulation)
    )


METHODS = {
    "dual cg": (0.0, {"feti_formulation": "dual"}),
    "dual gmres": (0.0, {"feti_formulation": "dual", "feti_dual_ksp_type": "gmres"}),
    "dual lumped": (0.0, {"feti_formulation": "dual", "feti_pc_type": "lumped"}),
    "dual identity Q": (0.0, {"feti_formulation": "dual", "feti_coarse_q": "identity"}),
    "primal cg": (0.0, {"feti_formulation": "primal"}),
    "primal cg, interior kept": (0.0, {"feti_formulation": "primal", "feti_interior": "keep"}),
    "primal cg, E alone": (0.0, {"feti_formulation": "primal", "feti_coarse_adaptive": 0}),
    "primal gmres": (0.01, {"feti_formulation": "primal"}),
    "primal gmres, E alone": (0.01, {"feti_formulation": "primal", "feti_coarse_adaptive": 0}),
}


@every_type
@each(("share", "options"), METHODS)
def test_every_method_is_accurate_beside_a_penalty(share, options, kind, torn_grid, create_ksp):
    """A thousand million times the stiffness is added to the diagonal at one end.

    A share of the entries of an unsymmetric matrix is random.
    """
    k = 1e9
    ends = np.arange(63, 70)  # the nodes with the largest x₀ of 10 × 7
    disturb = unsymmetric(share)

    def change(K, dofs):
        disturb(K, dofs)
        for K_i, own in zip(K, dofs, strict=True):
            at_end = np.isin(own // 2, ends)
            K_i[at_end, at_end] += k

    problem = torn_grid(change=change, **case((3, 2), (3, 3), 2))
    values = random_values(problem)
    values[np.isin(np.arange(len(values)) // 2, ends)] *= k
    ksp = create_ksp(problem.A, feti_type=kind, **options)
    reason, x = solve(ksp, problem, values)
    context = ksp.getPythonContext()
    agree(reason > 0, context.message)
    exact = problem.solve(values)
    small(np.abs(x - exact).max() / np.abs(exact).max(), ACCURATE)
    if share:
        agree(context.method == "gmres")


@every_formulation
def test_condensed_problem_is_accurate_beside_a_penalty(formulation):
    """A nearly incompressible bar on springs has a pressure in each cell."""
    mesh = bar_mesh(3, None, 2)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    Q = dolfinx.fem.functionspace(mesh, ("DG", 0))
    (u, p), (v, q) = ((kind(V), kind(Q)) for kind in (ufl.TrialFunction, ufl.TestFunction))
    ds = tagged(mesh, far)(1)
    k = 1e8
    kappa = 1e4
    a_uu = 2 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(v)) * ufl.dx + k * ufl.inner(u, v) * ds
    a = [[a_uu, p * ufl.div(v) * ufl.dx], [q * ufl.div(u) * ufl.dx, -p * q / kappa * ufl.dx]]
    g = ufl.as_vector([0.1, 0.2, -0.1])
    L = [k * ufl.inner(g, v) * ds - 0.01 * v[1] * ufl.dx, None]
    L[1] = dolfinx.fem.Constant(mesh, 0.0) * q * ufl.dx
    pressure = dolfinx.fem.Function(Q)
    problem = LinearProblem(
        a,
        L,
        bcs=[dirichlet(V, left)],
        condense=pressure,
        subdomains=6,
        petsc_options={"feti_formulation": formulation},
    )
    check_against_mumps(problem)


# ---- components -----------------------------------------------------------------------------


def two_fields(units, h=1e6):
    """Return two uncoupled Poisson problems, one with a stiff Robin term, as one problem.

    Args:
        units: For each field, factors of its unknown and of its equation.
        h: Coefficient of the stiff Robin term.
    """
    mesh = cube(2, 12)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    ds = tagged(mesh, lambda x: np.isclose(x[0], 1.0))(1)
    a = []
    L = []
    for c, (s, t) in enumerate(units):  # unknown c is s times, equation c t times another
        stiff = h if c == 0 else 1e-3
        a.append(
            t * s * (ufl.inner(ufl.grad(u[c]), ufl.grad(v[c])) * ufl.dx + stiff * u[c] * v[c] * ds)
        )
        L.append(t * (stiff * 3.0 * v[c] * ds + (1.0 + c) * v[c] * ufl.dx))
    return Problem(V, sum(a), sum(L), [dirichlet(V, left)])


@every_formulation
@pytest.mark.parametrize(
    "units",
    [((1, 1), (1, 1)), ((1, 1), (1e6, 1e6)), ((1e4, 1e4), (1, 1)), ((1, 1), (1e-4, 1e7))],
    ids=["equal", "second-small", "first-small", "other-equations"],
)
def test_no_component_hides_another(units, formulation):
    """The error of each component is small relative to that component, in any units."""
    problem = torn(two_fields(units), 6, feti_formulation=formulation)
    u = owned(problem.solve()).reshape(-1, 2)
    exact = direct_solution(problem).reshape(-1, 2)
    for c in range(2):
        small(off_by(u[:, c], exact[:, c]), ACCURATE)


@pytest.mark.parametrize("body", [two_fields, elasticity])
@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_error_estimate_does_not_depend_on_units(unit, body):
    """η of any z and x is the same after one component and one equation have another unit."""
    problem = torn(body([(1, 1), (1, 1)]) if body is two_fields else body(cube(2, 8)), 4)
    _, b = problem.linear_system()
    feti = problem.create_linear_solver()
    feti.setUp()
    form_torn = feti.getPythonContext().formulation.pattern.torn
    rng = np.random.default_rng(COMM.rank)
    z, x = rng.standard_normal((2, form_torn.N)) * np.tile([1e-3, 1.0], form_torn.N // 2)
    before, _ = ComponentNorms(form_torn).ratios_of_correction(z, [x])
    unknown, equation = form_torn.K.createVecs()
    unknown.array[:] = np.tile([1.0, 1.0 / unit], form_torn.n // 2)
    equation.array[:] = np.tile([1.0, unit**0.5], form_torn.n // 2)
    form_torn.K.diagonalScale(equation, unknown)
    scale = np.tile([1.0, unit], form_torn.N // 2)
    after, _ = ComponentNorms(form_torn).ratios_of_correction(scale * z, [scale * x])
    equal(after, before, 1e-10 * before)
    for used in (feti, b):
        used.destroy()


def test_component_without_load_counts_once_in_its_own_size(torn_grid, create_ksp):
    """Where only this component is not zero, η is ‖z_c‖/‖x_c‖, whatever the energy weights."""
    problem = torn_grid((2, 2), (3, 3), components=2)
    ksp = create_ksp(problem.A)
    solve(ksp, problem, random_values(problem))
    pattern_torn = ksp.getPythonContext().formulation.pattern.torn
    load = np.tile([1.0, 0.0], pattern_torn.N // 2)
    x = np.tile([0.0, 1.0], pattern_torn.N // 2)
    norms = ComponentNorms(pattern_torn).for_load(load)
    largest, total = norms.ratios_of_correction(1e-3 * x, [x])
    equal((largest, total), (1e-3, 1e-3), 1e-15)


@every_formulation
def test_vanishing_component_costs_no_iteration(formulation):
    """In plane strain u_z is zero but for rounding, and needs no accuracy."""
    mesh = bar_mesh(3, HEXAHEDRON, 3)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    a = ufl.inner(2 * strain + ufl.tr(strain) * ufl.Identity(3), ufl.grad(v)) * ufl.dx
    faces = dirichlet(V, lambda x: np.isclose(x[2], 0) | np.isclose(x[2], 1), component=2)
    problem = torn(
        Problem(V, a, 0.01 * v[1] * ufl.dx, [dirichlet(V, left), faces]),
        6,
        feti_formulation=formulation,
    )
    feti = check_against_mumps(problem)
    agree(
        np.isnan(feti.error_floor) and feti.iterations == iterations_by_residual(problem),
        feti.iterations,
    )


@every_formulation
@pytest.mark.parametrize("stiff", [1.0, 1e6], ids=["alike", "others-stiffer"])
def test_component_without_a_load_costs_no_iteration(stiff, formulation):
    """Of three uncoupled fields one is loaded; the preconditioner mixes errors into the others."""
    mesh = cube(3, 6)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    k = (1.0, stiff, 1.0)
    a = sum(k[i] * ufl.inner(ufl.grad(u[i]), ufl.grad(v[i])) for i in range(3)) * ufl.dx
    problem = torn(
        Problem(V, a, v[1] * ufl.dx, [dirichlet(V, left)]), 6, feti_formulation=formulation
    )
    problem.solve()
    feti = problem.solver.getPythonContext()
    before = iterations_by_residual(problem)
    agree(problem.solver.getConvergedReason() == Reason.CONVERGED_RTOL, feti.error_estimate)
    agree(feti.iterations == before, (feti.iterations, before))


# ---- scalars --------------------------------------------------------------------------------


@every_formulation
@pytest.mark.parametrize("units", [1.0, 1e6], ids=["in-units", "in-small-units"])
def test_scalars_are_accurate_beside_a_penalty(units, formulation, torn_grid, create_ksp):
    """Two scalars beside 1e9 times the stiffness are accurate, each relative to itself."""
    k = 1e9
    grid = case((3, 2), (3, 3), 2)
    ends = np.arange(63, 70)

    def change(K, dofs):
        for K_i, own in zip(K, dofs, strict=True):
            at_end = np.isin(own // 2, ends)
            K_i[at_end, at_end] += k

    problem = torn_grid(change=change, **grid)
    rng = np.random.default_rng(3)
    n = len(problem.dirichlet)
    is_dirichlet = problem.dirichlet
    b = np.where(np.isin(np.arange(n) // 2, ends), k, 1.0) * rng.standard_normal(n)
    B = np.where(is_dirichlet[:, None], 0.0, np.sin(problem.x.repeat(2, axis=0))) * [1.0, units]
    d = rng.standard_normal(2) * [1.0, units]
    rows = slice(*problem.A.getOwnershipRange())
    solver = BorderedSolver()
    ksp = create_ksp(problem.A, feti_formulation=formulation)
    x, s = solver.solve(ksp, problem.A, b[rows], Border(B[rows], B[rows], np.zeros((2, 2))), d)
    context = ksp.getPythonContext()
    agree(ksp.getConvergedReason() > 0, context.message)
    M = np.block(
        [[np.where(is_dirichlet[:, None], np.eye(n), problem.matrix), B], [B.T, np.zeros((2, 2))]]
    )
    column_scale = 1 / np.linalg.norm(M, axis=0)
    row_scale = 1 / np.linalg.norm(M * column_scale, axis=1)
    exact = column_scale * np.linalg.solve(
        row_scale[:, None] * M * column_scale, row_scale * np.concatenate([b, d])
    )
    small(np.abs(whole(x) - exact[:n]).max() / np.abs(exact[:n]).max(), ACCURATE)
    small(np.abs(s / exact[n:] - 1.0).max(), ACCURATE)
    agree(context.error_estimate <= 1e-8)


# ---- what it costs --------------------------------------------------------------------------


def iterations_by_residual(problem):
    """Return the iterations of a solve that ends by its residual, without an error estimate."""
    _, b = problem.linear_system()
    ksp = problem.create_linear_solver()
    x = b.duplicate()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ComponentNorms, "largest_ratio", lambda *_: 0.0)
        ksp.solve(b, x)
    iterations = ksp.getIterationNumber()
    for used in (ksp, b, x):
        used.destroy()
    return iterations


@every_formulation
@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("body", [poisson, elasticity])
def test_error_estimate_costs_no_iteration_without_a_penalty(body, degree, rtol, formulation):
    """The residual then meets its tolerance no sooner than the estimated error."""
    problem = torn(
        body(cube(3, 6 // degree), degree=degree), 8, feti_formulation=formulation, ksp_rtol=rtol
    )
    problem.solve()
    feti = problem.solver.getPythonContext()
    before = iterations_by_residual(problem)
    agree(feti.iterations == before, (feti.iterations, before))
    agree(feti.error_estimate <= rtol)


@every_formulation
def test_penalty_takes_about_the_iterations_of_none(formulation):
    """The spectrum of the preconditioned matrix is the same."""
    counts = [
        check_against_mumps(
            torn(spring_bar(bar_mesh(2), ratio), 6, feti_formulation=formulation)
        ).iterations
        for ratio in (1.0, 1e8)
    ]
    agree(counts[1] <= 1.3 * counts[0] + 2, counts)


# ---- ends -----------------------------------------------------------------------------------


@every_formulation
@pytest.mark.parametrize("value", [0.0, 0.3])
def test_zero_load_and_rigid_motion_are_solved(value, formulation):
    """Prescribed values alone move the body rigidly, or not at all."""
    mesh = bar_mesh(2)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    a = ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(v)) * ufl.dx
    L = ufl.inner(dolfinx.fem.Constant(mesh, np.zeros(2)), v) * ufl.dx
    bc = dirichlet(V, left, lambda x: np.full((2, x.shape[1]), value))
    problem = torn(Problem(V, a, L, [bc]), 6, feti_formulation=formulation)
    solution = owned(problem.solve())
    equal(solution, np.full(len(solution), value), 1e-7 * value)
    agree(problem.solver.getConvergedReason() > 0)


@every_formulation
def test_iteration_limit_is_reported_with_the_estimated_error(formulation):
    """The residual meets its tolerance after few iterations, the estimated error does not."""
    problem = torn(spring_bar(bar_mesh(2), 1e8), 6, feti_formulation=formulation, ksp_max_it=6)
    _, b = problem.linear_system()
    x = b.duplicate()
    problem.solver.solve(b, x)
    feti = problem.solver.getPythonContext()
    agree(problem.solver.getConvergedReason() == Reason.DIVERGED_MAX_IT)
    agree("estimated error" in feti.message and feti.residual < 1e-8, feti.message)
    agree(1e-8 < feti.error_estimate < 1.0)
    for used in (b, x):
        used.destroy()


def test_user_tolerance_of_the_dual_method_ends_the_solve():
    """It ends early; residual and error are still measured."""
    problem = torn(
        spring_bar(bar_mesh(2), 1e6), 6, feti_formulation="dual", feti_dual_ksp_rtol=1e-2
    )
    problem.solve()
    feti = problem.solver.getPythonContext()
    agree(
        feti.iterations <= 6 and feti.error_estimate > 1e-6, (feti.iterations, feti.error_estimate)
    )


@every_formulation
@pytest.mark.parametrize("ratio", [1e8, 1e12], ids="{:g}".format)
def test_rounding_errors_are_reported(ratio, formulation, caplog):
    """A stiff block held only by a soft strip: the solution is right, or the error is reported."""
    problem = torn(jump_bar(bar_mesh(2), ratio), 6, feti_formulation=formulation)
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        try:
            off = off_by(owned(problem.solve()), direct_solution(problem))
        except ConvergenceError:
            return
    feti = problem.solver.getPythonContext()
    warnings = logged_messages(caplog)
    is_reported = bool(warnings) or feti.floor > 0.0
    agree(off <= ACCURATE or is_reported, (off, warnings, feti.error_estimate))
    agree(
        (feti.error_floor > 1e-7) == any("estimated error" in line for line in warnings), warnings
    )


# ---- what is shown --------------------------------------------------------------------------


def test_residual_and_estimated_error_are_reported():
    """The view, the record of the solve and the diagnosis have both."""
    problem = torn(spring_bar(bar_mesh(2), 1e6), 6, "shown_")
    problem.solve()
    feti = problem.solver.getPythonContext()
    rows = format_report(feti.report())
    agree(f"{feti.residual:.1e} of the load" in rows, rows)
    agree(f"{feti.error_estimate:.1e} of the solution" in rows, rows)
    step = problem.history[0]
    agree(step.linear_error == feti.error_estimate and step.linear_residual == feti.residual)
    diagnosis = problem.diagnose()
    agree(diagnosis.error_estimate <= 1e-8 and "estimated error" in str(diagnosis), diagnosis)
