# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A J that is not the derivative of the residual is detected and named, and a right one is not."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from collective import agree, equal, logged_messages, raises, small
from problems import cube, dirichlet, left
from walls import beam

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem
from dolfinx_feti.problems.iteration.tangent_check import QUANTITY

LOADS = (0.001, 0.002, 0.003)


def advised(problem):
    """Return the advice about the tangent in a problem's diagnosis."""
    found = problem.diagnose()
    agree(all(str(a) in str(found) for a in found.advice), found)
    return [a for a in found.advice if a.quantity == QUANTITY]


def heat(J=None, k=lambda u: 1 + u**2, **options):
    """Create −div(k grad u) = 40 with u = 0 on one side; J maps u, v and du to an integrand."""
    V = dolfinx.fem.functionspace(cube(2, 8), ("Lagrange", 1))
    u = dolfinx.fem.Function(V)
    v = ufl.TestFunction(V)
    du = ufl.TrialFunction(V)
    F = (k(u) * ufl.inner(ufl.grad(u), ufl.grad(v)) - 40.0 * v) * ufl.dx
    J = None if J is None else J(u, v, du) * ufl.dx
    bcs = [dirichlet(V, left)]
    return NonlinearProblem(F, u, bcs, J, subdomains=4, petsc_options=options)


def without_term(u, v, du):
    """Return Picard's tangent, which lacks the derivative of the conductivity."""
    return (1 + u**2) * ufl.inner(ufl.grad(du), ufl.grad(v))


def bent(kind, caplog, **options):
    """Bend a beam with a tangent of its pressure; return problem, Newton steps and warnings."""
    body = beam(tangent=kind)
    problem = body.problem(4, {"ksp_rtol": 1e-6, **options})
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        for load in LOADS:
            body.load.value = load
            problem.solve()
    return problem, logged_messages(caplog)


# -- what is found


@pytest.mark.parametrize("kind", ["symmetric", "none"])
def test_pressure_with_a_free_rim(caplog, kind):
    """On a free rim a symmetric or missing tangent of the pressure is detected, with its remedy."""
    problem, said = bent(kind, caplog, snes_max_it=40)
    (advice,) = advised(problem)
    remedy = "take follower_pressure_tangent(…, bcs=bcs)" if kind == "symmetric" else "lacks a term"
    agree(remedy in advice.text, advice)
    agree(advice.value > 100 * advice.threshold, advice)
    agree(sum("J is not the derivative of F" in text for text in said) == 1)
    other, _ = bent("auto", caplog)
    agree(len(problem.history) > 1.5 * len(other.history))  # and this is what it costs
    equal(other.u.x.array, problem.u.x.array, 1e-5)


def test_missing_term(caplog):
    """A missing term of J is named after a solve that converges slowly."""
    problem = heat(without_term)
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        problem.solve()
    agree(len(problem.history) > 8)
    (advice,) = advised(problem)
    agree("J lacks a term of F" in advice.text and 0.01 < advice.value < 2.0, advice)
    agree("J lacks a term of F" in logged_messages(caplog)[0])
    exact = heat()
    exact.solve()
    small(np.abs(exact.u.x.array - problem.u.x.array).max(initial=0.0), 1e-5)


def test_missing_term_in_a_solve_that_fails():
    """A failed solve with a wrong J names J, and does not recommend smaller steps."""
    problem = heat(without_term, snes_max_it=3)
    with raises(ConvergenceError, "no convergence within 3 steps: J is not the derivative of F"):
        problem.solve()
    agree("smaller steps" not in problem._newton.outcome.message, problem._newton.outcome.message)
    agree(len(advised(problem)) == 1)


def test_coefficient_that_changes_with_u():
    """A coefficient that changes between Newton steps is named as the cause, instead of J."""
    coefficients = []

    def conductivity(u):
        coefficients.append(dolfinx.fem.Function(u.function_space))
        return 1 + coefficients[0] ** 2 + u**2

    problem = heat(k=conductivity)

    def follow(_snes, _its, _norm):
        coefficients[0].x.array[:] = problem.u.x.array

    problem.solver.setMonitor(follow)
    with raises(ConvergenceError, "A coefficient of F changes with u from step to step"):
        problem.solve()
    (advice,) = advised(problem)
    agree("A coefficient of F changes with u" in advice.text, advice)


# -- what is not there


@pytest.mark.parametrize("kind", ["full", "exact", "auto"])
def test_right_tangent_of_a_beam(caplog, kind):
    """A right tangent causes no warning, although large steps converge slowly."""
    problem, said = bent(kind, caplog)
    agree(not problem._newton.findings and not advised(problem))
    agree(not said, said)


# -- who made J


def opposite(kind, factor, *, start=0.0, energy=False, condense=False):
    """Create a problem whose J is a multiple of the derivative."""
    mesh = cube(2, 6)
    shape = () if kind == "scalar" else (2,)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2 if condense else 1, shape))
    u = dolfinx.fem.Function(V)
    v = ufl.TestFunction(V)
    du = ufl.TrialFunction(V)
    u.x.array[:] = start
    more = {}
    if kind == "scalar":
        potential = (ufl.inner(ufl.grad(u), ufl.grad(u)) / 2 + u**4 / 4 - 40.0 * u) * ufl.dx
        residual = ufl.derivative(potential, u, v)
    else:
        grad = ufl.Identity(2) + ufl.grad(u)
        density = ufl.inner(grad, grad) / 2 - ufl.ln(ufl.det(grad)) + 0.05 * u[1]
        if condense:
            p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)), name="p")
            density += p * (ufl.det(grad) - 1) - p**2 / 2e3
            more = {"condense": p}
        potential = density * ufl.dx(degree=4)
        residual = ufl.derivative(potential, u, v)
    F = potential if energy or condense else residual
    J = factor * ufl.derivative(residual, u, du)
    return NonlinearProblem(F, u, [dirichlet(V, left)], J, subdomains=4, **more)


@pytest.mark.parametrize("factor", [-1.0, -0.1, -20.0])
@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("scalar", {}),
        ("scalar", {"start": 0.3}),
        ("scalar", {"energy": True}),
        ("vector", {}),
        ("vector", {"energy": True}),
        ("vector", {"condense": True}),
    ],
)
def test_wrong_sign(kind, options, factor, caplog):
    """A J of the wrong sign ends each solve after at most two steps, with one warning in all."""
    problem = opposite(kind, factor, **options)
    for _ in range(2):
        with raises(ConvergenceError, "J has the wrong sign: give J = ufl.derivative"):
            problem.solve()
        agree(len(problem.history) <= (2 if options.get("start") else 1), problem.history)
    agree(not logged_messages(caplog), logged_messages(caplog))
    (advice,) = advised(problem)
    agree("wrong sign" in advice.text, advice)


@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_right_sign(factor):
    """Half the derivative as J is slow, and does not end the solve."""
    problem = opposite("scalar", factor)
    problem.solve()
    agree(not any("sign" in finding.advice.text for finding in problem._newton.findings))


def ground(penalty, degree=None, *, given=False, kind="abs", dim=2):
    """Create a strip pressed on a wavy ground by a penalty on the positive part of the overlap."""
    mesh = cube(dim, 12 if dim == 2 else 4)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
    u = dolfinx.fem.Function(V)
    v = ufl.TestFunction(V)
    x = ufl.SpatialCoordinate(mesh)
    last = dim - 1
    push = np.zeros(dim)
    push[last] = -0.1
    bcs = [
        dirichlet(V, lambda x: np.isclose(x[last], 1.0), lambda x: push[:, None] + 0.0 * x[:dim])
    ]
    gap = -(u[last] + 0.05 + 0.04 * ufl.sin(9 * x[0]))
    positive = {
        "abs": (gap + abs(gap)) / 2,
        "max_value": ufl.max_value(gap, 0.0),
        "conditional": ufl.conditional(ufl.gt(gap, 0.0), gap, 0.0),
    }[kind]
    e = ufl.sym(ufl.grad(u))
    strain = ufl.inner(8 * e + 5 * ufl.tr(e) * ufl.Identity(dim), ufl.grad(v)) * ufl.dx
    below = ufl.conditional(ufl.lt(x[last], 1e-6), 1.0, 0.0)
    measure = ufl.ds if degree is None else ufl.ds(degree=degree)
    F = strain - penalty * positive * below * v[last] * measure
    J = ufl.derivative(F, u, ufl.TrialFunction(V)) if given else None
    return NonlinearProblem(F, u, bcs, J, subdomains=4)


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize("kind", ["abs", "max_value", "conditional"])
@pytest.mark.parametrize(("penalty", "dim"), [(1e3, 2), (1e4, 2), (1e3, 3)])
def test_tangent_has_the_degrees_of_the_residual(kind, penalty, dim, given):
    """A J without stated degrees takes the steps of one with the residual's quadrature degree."""
    steps = []
    for degree in (4, None):
        problem = ground(penalty, degree, given=given, kind=kind, dim=dim)
        problem.solve()
        steps.append(len(problem.history))
        agree(not problem._newton.findings, problem._newton.findings)
    agree(steps[1] <= steps[0] + 3, f"{steps[1]} steps, {steps[0]} with a degree")


def test_kink_is_named():
    """A solve that fails across a kink names the kink, and not J if none was passed."""
    problem = ground(1e3)
    problem.solver.setTolerances(max_it=2)
    with raises(ConvergenceError, r"within 2 steps.*F has a kink in u \(abs\)"):
        problem.solve()
    agree("leave J out" not in problem._newton.outcome.message, problem._newton.outcome.message)


def test_residual_that_does_not_change():
    """If F does not change with u, the error recommends ``before_assembly=``."""
    V = dolfinx.fem.functionspace(cube(2, 4), ("Lagrange", 1))
    u = dolfinx.fem.Function(V)
    v = ufl.TestFunction(V)
    du = ufl.TrialFunction(V)
    zero = dolfinx.fem.Constant(V.mesh, 0.0)
    F = (zero * u * v - v) * ufl.dx
    J = ufl.inner(ufl.grad(du), ufl.grad(v)) * ufl.dx
    options = {"snes_max_it": 1}
    problem = NonlinearProblem(F, u, [dirichlet(V, left)], J, subdomains=2, petsc_options=options)
    with raises(ConvergenceError, "F does not change with u at all: pass before_assembly"):
        problem.solve()
