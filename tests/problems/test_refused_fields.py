# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Problems in several fields that cannot be torn are refused with a message that fits the form."""

from __future__ import annotations

import pytest
from collective import raises
from problems import Cell, cube

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti import LinearProblem, NonlinearProblem

GRADIENT = "The scalar has derivatives in the forms, .* it is no pressure"
COMPONENTS = "make them components of one unknown"
PRESSURE = "A pressure has to be discontinuous"
FLUX = "if the vector is a flux −k ∇p, solve"
JUMPS = "integrals over interior facets .*cohesive zones"
BLOCKS = r"pass blocks, NonlinearProblem\(\[F_u, F_p\], \[u, p\]"


def plate(u, w, v, z):
    """Return the form of a Reissner–Mindlin plate, with deflection and rotation."""
    return (
        ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx
        + ufl.inner(ufl.grad(w) - u, ufl.grad(z) - v) * ufl.dx
    )


def thermoelastic(u, w, v, z):
    """Return the form of a displacement and a temperature."""
    strain = ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) - w * ufl.div(v)
    return strain * ufl.dx + ufl.inner(ufl.grad(w), ufl.grad(z)) * ufl.dx


def stokes(u, w, v, z):
    """Return the form of Stokes' equations."""
    return (ufl.inner(ufl.grad(u), ufl.grad(v)) - w * ufl.div(v) - z * ufl.div(u)) * ufl.dx


def darcy(u, w, v, z):
    """Return the mixed form of Darcy's equations, with flux and pressure."""
    return (ufl.inner(u, v) - w * ufl.div(v) - z * ufl.div(u)) * ufl.dx


def beam(u, w, v, z):
    """Return the form of two vectors, such as displacement and rotation."""
    bend = ufl.inner(ufl.grad(w), ufl.grad(z))
    return (bend + ufl.inner(ufl.grad(u)[:, 0] - w, ufl.grad(v)[:, 0] - z)) * ufl.dx


def cohesive(u, w, v, z):
    """Return the thermoelastic form with springs across interior facets."""
    return thermoelastic(u, w, v, z) + ufl.inner(ufl.jump(u), ufl.jump(v)) * ufl.dS


VECTOR = ("Lagrange", 2, (2,))
SCALAR = ("Lagrange", 1)
CASES = {
    "plate": (plate, VECTOR, SCALAR, GRADIENT),
    "thermoelasticity": (thermoelastic, VECTOR, SCALAR, GRADIENT),
    "Taylor-Hood": (stokes, VECTOR, SCALAR, PRESSURE),
    "Darcy": (darcy, ("RT", 1), ("DG", 0), FLUX),
    "beam": (beam, VECTOR, VECTOR, COMPONENTS),
    "cohesive zone": (cohesive, ("DG", 1, (2,)), SCALAR, JUMPS),
}


@pytest.mark.parametrize("kind", ["nonlinear", "linear", "swapped", "mixed", "parts"])
@pytest.mark.parametrize("case", CASES)
def test_message_fits_the_form(case, kind):
    """The message fits the form as blocks in any order, as a mixed element, or as its parts."""
    rows, of_u, of_w, text = CASES[case]
    mesh = cube(2, 2, Cell.triangle)
    V, Q = (dolfinx.fem.functionspace(mesh, e) for e in (of_u, of_w))
    if kind == "mixed":
        parts = [space.ufl_element() for space in (V, Q)]
        W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(parts))
        f = dolfinx.fem.Function(W)
        with raises(TypeError, f"mixed element of 2, but only .*{text}"):
            NonlinearProblem(rows(*ufl.split(f), *ufl.TestFunctions(W)), f)
        return
    W = ufl.MixedFunctionSpace(V, Q)
    if kind == "parts":
        a = rows(*ufl.TrialFunctions(W), *ufl.TestFunctions(W))
        L = sum(0.0 * v[0] * ufl.dx(mesh) for v in ufl.TestFunctions(W) if v.ufl_shape)
        with raises(ValueError, f"a is a block of 2, but only .*{text}"):
            LinearProblem(a, L, u=[dolfinx.fem.Function(V), dolfinx.fem.Function(Q)])
        return
    u = dolfinx.fem.Function(V)
    w = dolfinx.fem.Function(Q)
    if kind == "linear":
        a = ufl.extract_blocks(rows(*ufl.TrialFunctions(W), *ufl.TestFunctions(W)))
        with raises(ValueError, f"a is a block of 2, but only .*{text}"):
            LinearProblem(a, [None, None], u=[u, w])
        return
    F = ufl.extract_blocks(rows(u, w, *ufl.TestFunctions(W)))
    unknowns = [u, w]
    if kind == "swapped":
        F = F[::-1]
        unknowns = unknowns[::-1]
    with raises(ValueError, f"u is a block of 2, but only .*{text}"):
        NonlinearProblem(F, unknowns)


def test_mixed_element_with_a_discontinuous_pressure():
    """A mixed element with a discontinuous pressure raises an error that recommends blocks."""
    mesh = cube(2, 2)
    parts = [
        basix.ufl.element("P", "triangle", 2, shape=(2,)),
        basix.ufl.element("DG", "triangle", 0),
    ]
    W = dolfinx.fem.functionspace(mesh, basix.ufl.mixed_element(parts))
    f = dolfinx.fem.Function(W)
    with raises(TypeError, f"mixed element of 2, but only .*{BLOCKS}"):
        NonlinearProblem(stokes(*ufl.split(f), *ufl.TestFunctions(W)), f)
