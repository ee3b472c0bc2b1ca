# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""When a linear solve has converged: by residual and estimated error, even if a load is stiff."""

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


def check(problem, tolerance=ACCURATE):
    """Assert that a problem is solved as MUMPS does; return the FETI context."""
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
def test_spring(ratio, formulation):
    """The iterations do not grow with the penalty, which the residual is relative to."""
    problem = torn(spring_bar(bar_mesh(2), ratio), 6, feti_formulation=formulation)
    feti = check(problem)
    agree(feti.iterations <= 20, feti.iterations)


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
def test_elements(mesh, body, formulation):
    dim, cell, cells, degree = mesh
    ratio = 1e4 if body is jump_bar else 1e7
    problem = torn(body(bar_mesh(dim, cell, cells), ratio, degree), 6, feti_formulation=formulation)
    check(problem)


@every_formulation
def test_robin_condition(formulation):
    """Heat conduction with a heat transfer coefficient of 1e8 to a temperature of 20."""
    mesh = cube(3, 6)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
    T = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    ds = tagged(mesh, lambda x: np.isclose(x[0], 1.0))(1)
    a = ufl.inner(ufl.grad(T), ufl.grad(v)) * ufl.dx + 1e8 * T * v * ds
    L = v * ufl.dx + 1e8 * 20.0 * v * ds
    check(torn(Problem(V, a, L, [dirichlet(V, left)]), 6, feti_formulation=formulation))


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
def test_penalty_by_hand(share, options, kind, torn_grid, create_ksp):
    """A thousand million times the stiffness on the diagonal of one end, by each method.

    Of an unsymmetric matrix a share of the entries is random.
    """
    k = 1e9
    disturb = unsymmetric(share)

    def change(K, dofs):
        disturb(K, dofs)
        for K_i, own in zip(K, dofs, strict=True):
            at_end = np.isin(own // 2, ends)
            K_i[at_end, at_end] += k

    ends = np.arange(63, 70)  # the nodes with the largest x₀ of 10 × 7
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
def test_condensed_pressure(formulation):
    """A nearly incompressible bar on springs: u and the pressure in each cell."""
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
    check(problem)


# ---- components -----------------------------------------------------------------------------


def two_fields(units, h=1e6):
    """A temperature and a concentration, uncoupled, one with a stiff Robin term, in some units."""
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
    """The error of each component is small relative to that component."""
    problem = torn(two_fields(units), 6, feti_formulation=formulation)
    u = owned(problem.solve()).reshape(-1, 2)
    exact = direct_solution(problem).reshape(-1, 2)
    for c in range(2):
        small(off_by(u[:, c], exact[:, c]), ACCURATE)


@pytest.mark.parametrize("body", [two_fields, elasticity])
@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_estimate_does_not_depend_on_units(unit, body):
    """η of any z and x is the same after one component, and one equation, has another unit."""
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


@every_formulation
def test_component_that_vanishes_costs_nothing(formulation):
    """Plane strain in space: u_z is zero but for rounding, and no accuracy is asked of it."""
    mesh = bar_mesh(3, HEXAHEDRON, 3)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    e = ufl.sym(ufl.grad(u))
    a = ufl.inner(2 * e + ufl.tr(e) * ufl.Identity(3), ufl.grad(v)) * ufl.dx
    faces = dirichlet(V, lambda x: np.isclose(x[2], 0) | np.isclose(x[2], 1), component=2)
    problem = torn(
        Problem(V, a, 0.01 * v[1] * ufl.dx, [dirichlet(V, left), faces]),
        6,
        feti_formulation=formulation,
    )
    feti = check(problem)
    agree(
        np.isnan(feti.error_floor) and feti.iterations == residual_alone(problem), feti.iterations
    )


@every_formulation
@pytest.mark.parametrize("stiff", [1.0, 1e6], ids=["alike", "others-stiffer"])
def test_component_without_a_load_costs_nothing(stiff, formulation):
    """Three fields that nothing couples, one loaded: the preconditioner mixes error into others."""
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
    before = residual_alone(problem)
    agree(problem.solver.getConvergedReason() == Reason.CONVERGED_RTOL, feti.error_estimate)
    agree(feti.iterations == before, (feti.iterations, before))


# ---- scalars --------------------------------------------------------------------------------


@every_formulation
@pytest.mark.parametrize("units", [1.0, 1e6], ids=["in-units", "in-small-units"])
def test_scalars(units, formulation, torn_grid, create_ksp):
    """Two scalars beside a penalty of 1e9 times the stiffness, each right relative to itself."""
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
    held = problem.dirichlet
    b = np.where(np.isin(np.arange(n) // 2, ends), k, 1.0) * rng.standard_normal(n)
    B = np.where(held[:, None], 0.0, np.sin(problem.x.repeat(2, axis=0))) * [1.0, units]
    d = rng.standard_normal(2) * [1.0, units]
    rows = slice(*problem.A.getOwnershipRange())
    solver = BorderedSolver()
    ksp = create_ksp(problem.A, feti_formulation=formulation)
    x, s = solver.solve(ksp, problem.A, b[rows], Border(B[rows], B[rows], np.zeros((2, 2))), d)
    context = ksp.getPythonContext()
    agree(ksp.getConvergedReason() > 0, context.message)
    M = np.block([[np.where(held[:, None], np.eye(n), problem.matrix), B], [B.T, np.zeros((2, 2))]])
    columns = 1 / np.linalg.norm(M, axis=0)
    rows_ = 1 / np.linalg.norm(M * columns, axis=1)
    exact = columns * np.linalg.solve(rows_[:, None] * M * columns, rows_ * np.concatenate([b, d]))
    small(np.abs(whole(x) - exact[:n]).max() / np.abs(exact[:n]).max(), ACCURATE)
    small(np.abs(s / exact[n:] - 1.0).max(), ACCURATE)
    agree(context.error_estimate <= 1e-8, context.error_estimate)


# ---- what it costs --------------------------------------------------------------------------


def residual_alone(problem):
    """Return the iterations of a solve that ends by the residual, as it did before."""
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
def test_no_iteration_more_without_a_penalty(body, degree, rtol, formulation):
    problem = torn(
        body(cube(3, 6 // degree), degree=degree), 8, feti_formulation=formulation, ksp_rtol=rtol
    )
    problem.solve()
    feti = problem.solver.getPythonContext()
    before = residual_alone(problem)
    agree(feti.iterations == before, (feti.iterations, before))
    agree(feti.error_estimate <= rtol, feti.error_estimate)


@every_formulation
def test_penalty_costs_what_its_accuracy_needs(formulation):
    """A penalty takes as many iterations as none, as the spectrum is the same."""
    counts = [
        check(torn(spring_bar(bar_mesh(2), ratio), 6, feti_formulation=formulation)).iterations
        for ratio in (1.0, 1e8)
    ]
    agree(counts[1] <= 1.3 * counts[0] + 2, counts)


# ---- ends -----------------------------------------------------------------------------------


@every_formulation
@pytest.mark.parametrize("value", [0.0, 0.3])
def test_nothing_to_do(value, formulation):
    """No load: zero, or a rigid motion that is prescribed."""
    mesh = bar_mesh(2)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u = ufl.TrialFunction(V)
    v = ufl.TestFunction(V)
    a = ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(v)) * ufl.dx
    L = ufl.inner(dolfinx.fem.Constant(mesh, np.zeros(2)), v) * ufl.dx
    bc = dirichlet(V, left, lambda x: np.full((2, x.shape[1]), value))
    problem = torn(Problem(V, a, L, [bc]), 6, feti_formulation=formulation)
    found = owned(problem.solve())
    equal(found, np.full(len(found), value), 1e-7 * value)
    agree(problem.solver.getConvergedReason() > 0)


@every_formulation
def test_limit_of_iterations_is_told(formulation):
    """The residual meets its tolerance after few iterations, the estimated error does not."""
    problem = torn(spring_bar(bar_mesh(2), 1e8), 6, feti_formulation=formulation, ksp_max_it=6)
    _, b = problem.linear_system()
    x = b.duplicate()
    problem.solver.solve(b, x)
    feti = problem.solver.getPythonContext()
    agree(problem.solver.getConvergedReason() == Reason.DIVERGED_MAX_IT)
    agree("estimated error" in feti.message and feti.residual < 1e-8, feti.message)
    agree(1e-8 < feti.error_estimate < 1.0, feti.error_estimate)
    for used in (b, x):
        used.destroy()


def test_own_test_of_the_dual_method_decides():
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
def test_rounding_is_told(ratio, formulation, caplog):
    """A stiff block held only by a soft strip: the solution is right, or the error is reported."""
    problem = torn(jump_bar(bar_mesh(2), ratio), 6, feti_formulation=formulation)
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        try:
            off = off_by(owned(problem.solve()), direct_solution(problem))
        except ConvergenceError:
            return
    feti = problem.solver.getPythonContext()
    said = logged_messages(caplog)
    is_reported = bool(said) or feti.floor > 0.0
    agree(off <= ACCURATE or is_reported, (off, said, feti.error_estimate))
    agree((feti.error_floor > 1e-7) == any("estimated error" in line for line in said), said)


# ---- what is shown --------------------------------------------------------------------------


def test_both_numbers_are_shown():
    problem = torn(spring_bar(bar_mesh(2), 1e6), 6, "shown_")
    problem.solve()
    feti = problem.solver.getPythonContext()
    rows = format_report(feti.report())
    agree(f"{feti.residual:.1e} of the load" in rows, rows)
    agree(f"{feti.error_estimate:.1e} of the solution" in rows, rows)
    step = problem.history[0]
    agree(step.linear_error == feti.error_estimate and step.linear_residual == feti.residual)
    found = problem.diagnose()
    agree(found.error_estimate <= 1e-8 and "estimated error" in str(found), found)
