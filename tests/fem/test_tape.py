# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Integrands as data: equal values are recognised, and a new material compiles nothing."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal
from problems import Cell, cube
from ufl_values import displacement, require_equal

import dolfinx
import ufl

from dolfinx_feti.fem.cell_kernels import tape as tape_module
from dolfinx_feti.fem.cell_kernels.generator import KernelGenerator
from dolfinx_feti.fem.cell_kernels.integrand import PointIntegrands
from dolfinx_feti.fem.cell_kernels.tape import Tape
from dolfinx_feti.runtime import native

Expr = ufl.core.expr.Expr


def test_order_and_sign_make_no_other_value():
    """Order and sign do not matter: a b + c = c + b a, −(a − b) = b − a."""
    tape = Tape()
    a, b, c = (tape.apply("constant", integers=[i]) for i in range(3))
    agree(tape.add(tape.multiply(a, b), c) == tape.add(c, tape.multiply(b, a)))
    agree(-tape.add(a, -b) == tape.add(b, -a))
    agree(tape.multiply(tape.multiply(a, -b), c) == -tape.multiply(tape.multiply(c, a), b))
    agree(tape.add(tape.add(a, b), c) == tape.add(tape.add(c, a), b))
    agree(tape.add(a, b) != tape.add(a, -b))
    agree(tape.multiply(tape.number(-1.0), a) == -a)
    mask = tape.apply("lt", a, b)
    agree(tape.choose(mask, -c, tape.number(0.0)) == -tape.choose(mask, c, tape.number(0.0)))


def test_numbers_are_values_of_their_own():
    """All powers of two, of either sign, and their products are different values."""
    tape = Tape()
    a = tape.apply("constant", integers=[0])
    values = {e: tape.number(2.0**e) for e in range(-1074, 1024)}
    agree(len({abs(value) for value in values.values()}) == len(values))
    agree(all(tape.literals[value] == 2.0**e for e, value in values.items()))
    agree(len({abs(tape.multiply(a, value)) for value in values.values()}) == len(values))
    agree(tape.multiply(values[30], values[31]) == values[61] != values[0])
    agree(tape.number(-(2.0**-52)) == -values[-52] != -values[9])


def test_a_number_with_the_key_of_another_is_no_other(monkeypatch):
    """Numbers that are equal in the field of 2⁶¹ − 1 elements remain different values."""
    monkeypatch.setattr(tape_module, "PRIME", 2**61 - 1)
    for pair in ((512.0, 2.0**-52), (1.0, -(2.0**61))):
        tape = Tape()
        found = [tape.number(x) for x in pair]
        agree(abs(found[0]) != abs(found[1]), pair)
        agree([tape.literals[abs(value)] for value in found] == [abs(x) for x in pair])


def test_numbers_that_differ_are_no_common_factor():
    """Coefficients of very different size are not merged: ∫ 512 x + 2⁻⁵² c y = 256.5, c = 2⁵²."""
    mesh = cube(3, 2, Cell.tetrahedron)
    x = ufl.SpatialCoordinate(mesh)
    c = dolfinx.fem.Constant(mesh, 2.0**52)
    (kernel,) = KernelGenerator().create_kernels(
        [(512.0 * x[0] + 2.0**-52 * c * x[1]) * ufl.dx(degree=1)], mesh
    )
    (values,) = kernel.evaluate()
    equal(COMM.allreduce(values.sum()), 256.5, 1e-14)


def fibres(u: dolfinx.fem.Function, k: Expr | float) -> Expr:
    """Return the energy of two fibre families without compression, in a matrix."""
    d = len(u)
    F = ufl.Identity(d) + ufl.grad(u)
    J = ufl.det(F)
    C = J ** (-2.0 / 3.0) * F.T * F
    psi = 1.5 * (ufl.tr(C) - 3) + 50.0 * (J - 1) ** 2
    for sign in (1.0, -1.0):
        a = ufl.as_vector([0.8, sign * 0.6, 0.0][:d])
        E = ufl.dot(a, C * a) - 1
        psi += ufl.conditional(ufl.gt(E, 0.0), k * (ufl.exp(0.8 * E**2) - 1), 0.0)
    return psi


def rubber(u: dolfinx.fem.Function, k: Expr | float) -> Expr:
    """Return an energy with other invariants, and with terms on both sides of a branch."""
    F = ufl.Identity(len(u)) + ufl.grad(u)
    C = F.T * F
    J = ufl.det(F)
    second = (ufl.tr(C) ** 2 - ufl.tr(C * C)) / 2
    # J = 1 at quadrature points on an edge of the cube: there rounding would choose the branch.
    branch = ufl.conditional(
        ufl.Or(ufl.lt(J, 1.0123), ufl.ge(second, 3.1)), ufl.ln(J) ** 2, J**3 - 1
    )
    return k * ufl.sqrt(second) + branch + ufl.cosh(ufl.tr(C) / 3) + abs(J - 1.1) ** 3.5


def derivatives(psi: Expr, u: dolfinx.fem.Function, quadrature: int) -> list[ufl.Form]:
    energy = psi * ufl.dx(degree=quadrature)
    F = ufl.derivative(energy, u)
    forms = [energy, F, ufl.derivative(F, u)]
    return [ufl.algorithms.expand_derivatives(form) for form in forms]


@pytest.mark.parametrize("energy", [fibres, rubber])
def test_second_derivatives_are_symmetric(energy):
    """Symmetric second derivatives have 45 factors instead of 81."""
    u = displacement(cube(3, 2), 1)
    _, _, tangent = derivatives(energy(u, 2.0), u, 2)
    data = ufl.algorithms.compute_form_data(tangent, do_apply_default_restrictions=False)
    point = PointIntegrands(u.function_space.mesh, [u], [])
    (integral,) = (i for group in data.integral_data for i in group.integrals)
    point.add(0, integral.integrand(), 2)
    (term,) = point.terms
    found = term.factors
    agree(len(found) == 81 and len(set(found.values())) == 45, len(set(found.values())))
    agree(all(found[u, v] == i for (v, u), i in found.items()))


def test_long_sums():
    """A sum of 600 nested terms is compiled to one factor, without a recursion error."""
    u = displacement(cube(2, 2), 1)
    point = PointIntegrands(u.function_space.mesh, [u], [])
    terms = [ufl.exp(1e-3 * k * u[0]) for k in range(600)]
    point.add(0, sum(terms) * ufl.TestFunction(u.function_space)[1], 1)
    (term,) = point.terms
    found = term.factors
    code = point.tape.code(set(found.values()), 1).words
    agree(len(found) == 1 and len(code) > 4 * len(terms))  # an exponential takes four numbers


@pytest.mark.parametrize("cell", [Cell.tetrahedron, Cell.quadrilateral])
def test_another_material_compiles_nothing(cell, monkeypatch):
    """Another material compiles nothing, and its kernels have dolfinx's values."""
    mesh = cube(3 if cell == Cell.tetrahedron else 2, 2, cell)
    u = displacement(mesh, 2)
    k = dolfinx.fem.Constant(mesh, 3.5)
    for quadrature in (1, 4):
        for form in derivatives(fibres(u, 2.0) + k, u, quadrature):
            KernelGenerator().create_kernels([form], mesh)
        monkeypatch.setattr(native, "_compile", lambda *_: agree(False))
        for psi in (fibres(u, 3.5) + k, fibres(u, k), rubber(u, k)):
            forms = derivatives(psi, u, quadrature)
            kernels = [KernelGenerator().create_kernels([form], mesh) for form in forms]
        monkeypatch.undo()
    k.value = 0.7
    for form, (kernel,) in zip(forms, kernels, strict=True):
        (values,) = kernel.evaluate()
        require_equal(form, values, 500 * np.finfo(float).eps)
