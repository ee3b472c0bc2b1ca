# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Wrong arguments of scalar unknowns are refused by name on all processes, before a solve."""

from __future__ import annotations

import numpy as np
from cases import each, wrong_values
from collective import agree, raises
from inflated import balloon, balloon_cavity, thick_tube
from problems import cube, elasticity, poisson

import dolfinx
import ufl

from dolfinx_feti import LinearProblem
from dolfinx_feti.scalars import (
    ArcLength,
    Cavity,
    ScalarEquation,
    Windkessel,
    mean_value,
    rigid_motions,
)

NAN = float("nan")
INF = float("inf")
POSITIVE = (0.0, -1.0, NAN, INF, "3")
FINITE = (NAN, INF)

BALL = balloon(2)
U = BALL.u
DS = BALL.ds(1)
MESH = BALL.u.function_space.mesh
V = ufl.TestFunction(U.function_space)
SCALAR = dolfinx.fem.Function(dolfinx.fem.functionspace(MESH, ("Lagrange", 1)))
ONE, TWO = (dolfinx.fem.Constant(MESH, np.zeros(shape)) for shape in ((), (2,)))
DX = ufl.Measure("dx", MESH)
C = U[0] * ufl.Measure("dx", MESH)

#: A call, the arguments that are right, and the wrong values of some.
WRONG_ARGUMENTS = [
    (
        Cavity,
        {"u": U, "ds": DS},
        {
            "u": (SCALAR,),
            "ds": (None, DX, BALL.ds(7)),
            "volume": POSITIVE,
            "pressure": FINITE,
            "axis": ((0, 0, 0), (0, 0, NAN), (0, 1)),
        },
    ),
    (
        Windkessel,
        {"cavity": Cavity(U, DS), "resistance": 1.0, "compliance": 1.0},
        {
            "cavity": (U, Cavity(U, DS, volume=1.0)),
            "resistance": POSITIVE,
            "compliance": POSITIVE,
            "impedance": (-1.0, NAN, INF),
            "inflow": FINITE,
            "venous_pressure": FINITE,
            "distal_pressure": FINITE,
        },
    ),
    (
        ArcLength,
        {"u": U},
        {"load": (3.0, TWO, *(dolfinx.fem.Constant(MESH, value) for value in FINITE))},
    ),
    (mean_value, {"u": U}, {"value": (*FINITE, "3", ufl.as_vector([1.0, 2.0]))}),
    (rigid_motions, {}, {"u": (SCALAR,)}),
    (
        ScalarEquation,
        {"unknown": ONE, "equations": (C,)},
        {
            "unknown": (3.0, TWO, SCALAR),
            "equations": ((), (C, C), (0,), (V[0] * DX,)),
            "work": (C,),
        },
    ),
]


@wrong_values(WRONG_ARGUMENTS)
def test_wrong_arguments_are_refused_by_name(call, right, name, wrong):
    """A wrong type is a TypeError if it is a text, and any other value a ValueError."""
    with raises(TypeError if isinstance(wrong, str) else ValueError, rf"\b{name}\b"):
        call(**{**right, name: wrong})


def vessels(cavity: Cavity) -> Windkessel:
    """Return a Windkessel with R = C = 1 behind a cavity."""
    return Windkessel(cavity, resistance=1.0, compliance=1.0)


def remove_symmetry(ball):
    """Remove the condition of the rim in one plane of symmetry."""
    del ball.bcs[1]
    return [balloon_cavity(ball)]


#: Couplings of a balloon, or of a tube, that do not fit it or each other.
UNFIT_COUPLINGS = {
    "alone": (balloon, balloon_cavity, "put it in a list"),
    "a number": (balloon, lambda ball: [3], r"scalars\[0\] is 3"),
    "without a volume": (balloon, lambda ball: [Cavity(ball.u, ball.ds(1))], "has no volume"),
    "of another body": (balloon, lambda ball: [balloon_cavity(BALL)], "another space"),
    "open": (balloon, remove_symmetry, "open"),
    "open ends": (thick_tube, lambda t: [Cavity(t.u, t.ds(1), 1.0)], "open"),
    "another axis": (thick_tube, lambda t: [Cavity(t.u, t.ds(1), 1.0, axis=(0, 1, 0))], "open"),
    "twice": (balloon, lambda ball: [balloon_cavity(ball), balloon_cavity(ball)], "same facets"),
    "two Windkessels": (
        balloon,
        lambda ball: [vessels(Cavity(ball.u, ball.ds(1))) for _ in range(2)],
        "same facets",
    ),
}


@each(("kind", "make", "message"), UNFIT_COUPLINGS)
def test_couplings_that_do_not_fit_the_problem_are_refused(kind, make, message):
    """A cavity must be closed, belong to the body, and have its facets for itself."""
    body = kind(2) if kind is balloon else kind((2, 3))
    with raises(ValueError, message):
        body.problem(make(body))


def mean_values(*values):
    """Return the means of the first component with these values, by multipliers on all of u."""

    def make(u):
        dx = ufl.Measure("dx", u.function_space.mesh)
        v = ufl.TestFunction(u.function_space)
        for value in values:
            λ = dolfinx.fem.Constant(u.function_space.mesh, np.float64(0.0))
            yield ScalarEquation(λ, ((u - value) * dx,), λ * v * dx)

    return make


def one_unknown(u):
    """Return two equations for one unknown."""
    λ = dolfinx.fem.Constant(u.function_space.mesh, 0.0)
    v = ufl.TestFunction(u.function_space)
    yield from (ScalarEquation(λ, (u[i] * ufl.dx,), λ * v[i] * ufl.dx) for i in range(2))


def without_unknown(u):
    """Return an equation without an unknown in it."""
    λ = dolfinx.fem.Constant(u.function_space.mesh, 0.0)
    dx = ufl.dx(u.function_space.mesh)
    yield ScalarEquation(λ, (dolfinx.fem.Constant(u.function_space.mesh, 1.0) * dx,))


#: Constraints of a body that nothing supports, which depend on each other or on nothing.
DEPENDENT_CONSTRAINTS = {
    "the same twice": (poisson, mean_values(0.0, 0.0), r"equations \[0, 1\] depend on each other"),
    "a contradiction": (poisson, mean_values(0.0, 1.0), r"equations \[0, 1\] depend on each other"),
    "all motions twice": (
        elasticity,
        lambda u: [rigid_motions(u), mean_value(u)],
        "equations .* depend on each other",
    ),
    "one unknown": (elasticity, one_unknown, r"unknowns \[0, 1\] depend on each other"),
    "no dof": (elasticity, without_unknown, r"equations \[0\] depend neither on a free dof"),
}


@each(("kind", "make", "message"), DEPENDENT_CONSTRAINTS)
def test_dependent_constraints_are_refused(kind, make, message):
    """There is one error, before the first solve."""
    body = kind(cube(3, 2), clamped=None)
    u = dolfinx.fem.Function(body.V)
    problem = LinearProblem(body.a, body.L, u=u, subdomains=4, scalars=list(make(u)))
    with raises(ValueError, message):
        problem.solve()
    agree(problem.solver.getIterationNumber() == 0)
