# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A forgotten pressure, neither condensed nor an unknown, is named; similar data are accepted."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, logged_messages, raises
from problems import Cell, cube, dirichlet, left

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials


class Body:
    """A block with a displacement of degree two, and other fields."""

    def __init__(self, dim: int = 2, cell: Cell | None = None) -> None:
        self.mesh = cube(dim, 2, cell)
        self.dim = dim
        self.V = dolfinx.fem.functionspace(self.mesh, ("Lagrange", 2, (dim,)))
        self.u = dolfinx.fem.Function(self.V, name="displacement")
        self.F = kinematics.deformation_gradient(self.u)
        self.C = kinematics.right_cauchy_green(self.F)
        self.J = kinematics.jacobian(self.F)
        self.e = ufl.sym(ufl.grad(self.u))
        self.shear = ufl.inner(self.F, self.F) / 2 - ufl.ln(self.J)

    def field(self, element=("DG", 0), name="pressure", value=0.0):
        f = dolfinx.fem.Function(dolfinx.fem.functionspace(self.mesh, element), name=name)
        f.x.array[:] = value
        return f

    def problem(self, F, **arguments):
        return NonlinearProblem(
            F,
            self.u,
            bcs=[dirichlet(self.V, left)],
            subdomains=3,
            **({"quadrature_degree": 4} | arguments),
        )


#: What a pressure adds to an energy: one of this package, and others by hand.
PRESSURES = {
    "package": lambda b, p: materials.perturbed_lagrangian(b.J, p, kappa=1e3),
    "by hand": lambda b, p: p * (b.J - 1) - p**2 / (2 * 1e3),
    "factored": lambda b, p: p * (b.J - 1 - p / 2e3),
    "scaled": lambda b, p: 5e-4 * (2e3 * p * (b.J - 1) - p * p),
    "other sign of p": lambda b, p: -p * (b.J - 1) - 0.5 * p**2 / 1e3,
    "logarithm": lambda b, p: p * ufl.ln(b.J) - p**2 / 2e3,
    "small strains": lambda b, p: p * ufl.div(b.u) - p**2 / 2e3,
    "varying kappa": lambda b, p: p * (b.J - 1) - p**2 / (2 * b.field(name="kappa", value=1e3)),
    "constant kappa": lambda b, p: p * (b.J - 1) - p**2 / (2 * dolfinx.fem.Constant(b.mesh, 1e3)),
}

ELEMENTS = [
    (2, None, ("DG", 0)),
    (2, None, ("DG", 1)),
    (3, None, ("DG", 0)),
    (2, Cell.quadrilateral, ("DPC", 1)),
]


@pytest.mark.parametrize("kind", PRESSURES)
def test_forgotten_pressure(kind):
    """A pressure without ``condense=`` is an error in each spelling of the form."""
    body = Body()
    p = body.field()
    energy = (body.shear + PRESSURES[kind](body, p)) * ufl.dx
    with raises(ValueError, "Function 'pressure' as a pressure.* condense=pressure .*displacement"):
        body.problem(energy)
    agree(body.problem(energy, condense=p).condenses)


@pytest.mark.parametrize(("dim", "cell", "element"), ELEMENTS)
@pytest.mark.parametrize("way", ["energy", "residual", "energy beside a residual", "sum"])
def test_forgotten_pressure_of_any_element(dim, cell, element, way):
    """A forgotten pressure of any element is an error, in an energy and its derivatives."""
    body = Body(dim, cell)
    p = body.field(element)
    v = ufl.TestFunction(body.V)
    energy = (body.shear + PRESSURES["package"](body, p)) * ufl.dx
    residual = ufl.derivative(energy, body.u, v)
    given = {
        "energy": (energy, {}),
        "residual": (residual, {}),
        "energy beside a residual": (ufl.inner(body.e, body.e) * v[0] * ufl.dx, {"energy": energy}),
        "sum": (residual - v[0] * ufl.ds, {"quadrature_degree": None}),
    }
    F, arguments = given[way]
    with raises(ValueError, "Function 'pressure' as a pressure"):
        body.problem(F, **arguments)


def test_forgotten_fields_of_a_three_field_energy():
    """A forgotten dilation and its multiplier are both named."""
    body = Body()
    p = body.field()
    dilation = body.field(name="dilation", value=1.0)
    volume = 500.0 * (dilation - 1) ** 2 + p * (body.J - dilation)
    energy = (body.shear + volume) * ufl.dx
    with raises(ValueError, r"'dilation' and 'pressure' .*condense=\[dilation, pressure\]"):
        body.problem(energy)
    agree(body.problem(energy, condense=[dilation, p]).condenses)


def test_warnings_instead(caplog):
    """A pressure with values, or one that cannot be condensed, causes a warning only."""
    body = Body()
    p = body.field(value=0.3)
    body.problem((body.shear + PRESSURES["package"](body, p)) * ufl.dx)
    (said,) = logged_messages(caplog)
    agree("'pressure'" in said and "condense=pressure" in said, said)
    caplog.clear()
    q = body.field(("Lagrange", 1))
    body.problem((body.shear + PRESSURES["package"](body, q)) * ufl.dx)
    (said,) = logged_messages(caplog)
    agree("'pressure'" in said and "Only a discontinuous field" in said, said)


def strain_energy(e):
    return ufl.inner(e, e) + 0.7 * ufl.tr(e) ** 2


def eigenstrain(b, T):
    """Return the elastic energy of a strain from which a thermal strain is subtracted."""
    return strain_energy(b.e - 1e-3 * T * ufl.Identity(b.dim))


def grown(b, g):
    Fe = b.F / (1 + g)
    return ufl.inner(Fe, Fe) / 2 - ufl.ln(ufl.det(Fe))


#: Energies of fields that are data, whatever their values.
DATA = {
    "modulus": lambda b, f: (1 + f) * b.shear,
    "bulk modulus": lambda b, f: b.shear + f * (b.J - 1) ** 2,
    "bulk modulus of a condensed pressure": lambda b, f: b.shear + f * ufl.ln(b.J) ** 2,
    "two materials": lambda b, f: f * b.shear + (1 - f) * strain_energy(b.e),
    "active tension": lambda b, f: b.shear + f * (ufl.sqrt(b.C[0, 0]) - 1),
    "load": lambda b, f: b.shear - f * b.u[0],
    "fluid in the pores": lambda b, f: b.shear - f * (b.J - 1),
    "multiplier of Uzawa's method": lambda b, f: b.shear + f * (b.J - 1) + 50 * (b.J - 1) ** 2,
    "temperature": eigenstrain,
    "expansion of the volume": lambda b, f: b.shear + 50 * (b.J - 1 - 3e-3 * f) ** 2,
    "growth": grown,
    "damage": lambda b, f: (1 - f) ** 2 * strain_energy(b.e) + f**2,
    "history": lambda b, f: b.shear + 3 * (b.C[0, 0] - 1 - f) ** 2,
    "target of a spring": lambda b, f: b.shear + 3 * (b.u[0] - f) ** 2,
    "viscosity": lambda b, f: b.shear + (1 + f) ** 2 * ufl.inner(b.u, b.u),
    "constant": lambda b, f: b.shear - f**2,
}


@pytest.mark.parametrize("element", [("DG", 0), ("Lagrange", 1)])
@pytest.mark.parametrize("value", [0.0, 0.4])
@pytest.mark.parametrize("kind", DATA)
def test_data_are_left_alone(kind, value, element, caplog):
    """Data, zero or not, discontinuous or not, cause neither an error nor a warning."""
    body = Body()
    f = body.field(element, "data", value)
    energy = DATA[kind](body, f) * ufl.dx
    body.problem(energy)
    body.problem(ufl.derivative(energy, body.u, ufl.TestFunction(body.V)))
    agree(logged_messages(caplog) == [])


def test_fields_that_a_solve_changes(caplog):
    """Internal variables, and functions set by ``before_assembly``, cause no warning."""
    body = Body()
    p = body.field()
    energy = (body.shear + PRESSURES["package"](body, p)) * ufl.dx
    body.problem(energy, internal_variables={p: 1e3 * (body.J - 1)})
    body.problem(energy, before_assembly=lambda *_: None)
    kappa = body.field(name="kappa", value=1e3)
    modulus = body.field(name="modulus", value=1.0)
    mixed = (modulus * body.shear + p * (body.J - 1) - p**2 / (2 * kappa)) * ufl.dx
    body.problem(mixed, condense=p)
    agree(logged_messages(caplog) == [])


def test_forgotten_on_some_values():
    """A pressure with nonzero values on one process only is an error on none."""
    body = Body()
    p = body.field(value=0.3 if COMM.rank == 0 else 0.0)
    body.problem((body.shear + PRESSURES["package"](body, p)) * ufl.dx)
    agree(np.isfinite(p.x.array).all())
