# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A tangent that is not the derivative of the residual is found out, and named; another is not."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from problems import cube, dirichlet, left
from walls import beam

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem
from dolfinx_feti.problems.derivative import QUANTITY

LOADS = (0.001, 0.002, 0.003)


def warned(caplog):
    return COMM.bcast([record.getMessage() for record in caplog.records])


def advised(problem):
    """The advice about the tangent."""
    found = problem.diagnose()
    agree(all(str(a) in str(found) for a in found.advice), found)
    return [a for a in found.advice if a.quantity == QUANTITY]


def heat(J=None, k=lambda u: 1 + u**2, **options):
    """−div(k grad u) = 40, u = 0 on one side; J of the user's own, from u, v and du."""
    V = dolfinx.fem.functionspace(cube(2, 8), ("Lagrange", 1))
    u, v, du = dolfinx.fem.Function(V), ufl.TestFunction(V), ufl.TrialFunction(V)
    F = (k(u) * ufl.inner(ufl.grad(u), ufl.grad(v)) - 40.0 * v) * ufl.dx
    J = None if J is None else J(u, v, du) * ufl.dx
    bcs = [dirichlet(V, left)]
    return NonlinearProblem(F, u, bcs, J, subdomains=4, petsc_options=options)


def without_term(u, v, du):
    """Picard's tangent, which leaves out how the conductivity changes."""
    return (1 + u**2) * ufl.inner(ufl.grad(du), ufl.grad(v))


def bent(kind, caplog, **options):
    """Bend a beam with a tangent of its pressure; return problem, Newton steps and warnings."""
    body = beam(tangent=kind)
    problem = body.problem(4, {"ksp_rtol": 1e-6, **options})
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        for load in LOADS:
            body.load.value = load
            problem.solve()
    return problem, warned(caplog)


# -- what is found


@pytest.mark.parametrize("kind", ["symmetric", "none"])
def test_pressure_with_a_free_rim(caplog, kind):
    """The symmetric part is known by its error, which does no work along the step."""
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
    """It is found in a solve that arrives, slowly."""
    problem = heat(without_term)
    with caplog.at_level(logging.WARNING, "dolfinx_feti"):
        problem.solve()
    agree(len(problem.history) > 8)
    (advice,) = advised(problem)
    agree("J lacks a term of F" in advice.text and 0.01 < advice.value < 2.0, advice)
    agree("J lacks a term of F" in warned(caplog)[0])
    exact = heat()
    exact.solve()
    small(np.abs(exact.u.x.array - problem.u.x.array).max(initial=0.0), 1e-5)


def test_missing_term_in_a_solve_that_fails():
    """Smaller steps would not help, and are not recommended."""
    problem = heat(without_term, snes_max_it=3)
    with raises(ConvergenceError, "no convergence within 3 steps: J is not the derivative of F"):
        problem.solve()
    agree("smaller steps" not in problem._newton.message, problem._newton.message)
    agree(len(advised(problem)) == 1)


def test_coefficient_that_changes_with_u():
    """A monitor changes what F and J take to be fixed: F is another one in each step."""
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
    """Which is slow in the middle of large steps."""
    problem, said = bent(kind, caplog)
    agree(not problem._newton.mismatch and not advised(problem))
    agree(not said, said)
