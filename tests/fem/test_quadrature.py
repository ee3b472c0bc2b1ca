# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Quadrature degrees are bounded, and an energy has the rule of its residual."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, small
from problems import Cell, cube
from random_forms import bent

import basix.ufl
import dolfinx
import ufl

from dolfinx_feti.fem.quadrature import (
    estimated_quadrature_degree,
    limit_quadrature_degree,
    match_quadrature_degree,
    quadrature_degrees,
    set_quadrature_degrees,
)
from dolfinx_feti.problems.forms import derive


def unknown(cell: Cell = Cell.triangle, degree: int = 2) -> dolfinx.fem.Function:
    """Return a displacement that is far from linear in each cell."""
    V = dolfinx.fem.functionspace(cube(2, 2, cell), ("Lagrange", degree, (2,)))
    u = dolfinx.fem.Function(V)
    u.interpolate(lambda x: 0.1 * np.stack([np.sin(4 * x[1]) * x[0], x[1] * np.cos(5 * x[0])]))
    return u


def density(u: dolfinx.fem.Function) -> ufl.core.expr.Expr:
    F = ufl.Identity(2) + ufl.grad(u)
    return ufl.exp(ufl.inner(F, F) - 2) - ufl.ln(ufl.det(F))


def integral(form: ufl.Form) -> float:
    return COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(form)))


@pytest.mark.parametrize("cell", [Cell.triangle, Cell.quadrilateral])
def test_energy_falls_as_its_residual_says(cell):
    """Differences of the energy agree with the residual, both as they are integrated."""
    u = unknown(cell)
    w = dolfinx.fem.Function(u.function_space)
    w.interpolate(lambda x: np.stack([x[0] * x[1], np.cos(3 * x[0])]))
    start = u.x.array.copy()
    h = 1e-4
    energy = density(u) * ufl.dx
    residual = ufl.derivative(energy, u, ufl.TestFunction(u.function_space))
    r = dolfinx.fem.assemble_vector(dolfinx.fem.form(residual))
    r.scatter_reverse(dolfinx.la.InsertMode.add)
    n = u.function_space.dofmap.index_map.size_local * 2
    expected = COMM.allreduce(float(r.array[:n] @ w.x.array[:n]))
    errors = []
    for form in (match_quadrature_degree(energy, residual), energy):
        heights = []
        for step in (-2, -1, 1, 2):
            u.x.array[:] = start + step * h * w.x.array
            heights.append(integral(form))
        slope = (heights[0] - 8 * heights[1] + 8 * heights[2] - heights[3]) / (12 * h)
        errors.append(abs(slope / expected - 1.0))
        u.x.array[:] = start
    small(errors[0], 1e-9)
    agree(errors[1] > 1e-7, errors)


def test_degrees_that_are_stated_stay():
    """Stated degrees are kept; those of a residual also apply to its energy."""
    u = unknown()
    v = ufl.TestFunction(u.function_space)
    stated = density(u) * ufl.dx(metadata={"quadrature_degree": 3})
    for energy in (stated, density(u) * ufl.dx):
        agree(match_quadrature_degree(energy, ufl.derivative(stated, u, v)) == stated)
    agree(estimated_quadrature_degree(stated) == 0)


def test_each_part_of_the_domain_has_its_own():
    """Each part of the domain has its own degree, dx, dx(1) and ds included."""
    u = unknown()
    v = ufl.TestFunction(u.function_space)
    one = dolfinx.fem.Constant(u.function_space.mesh, 1.0)
    energy = (
        density(u) * ufl.dx(1)
        + ufl.inner(u, u) * ufl.dx
        + density(u) * ufl.dx((2, 3))
        + u[0] * ufl.ds
    )
    matched = match_quadrature_degree(energy, ufl.derivative(energy, u, v))
    degrees = {
        (i.integral_type(), i.subdomain_id()): i.metadata()["quadrature_degree"]
        for i in matched.integrals()
    }
    high = estimated_quadrature_degree(ufl.derivative(density(u) * ufl.dx, u, v))
    agree(high > 4)
    expected = {("cell", k): high for k in (1, 2, 3)}
    expected |= {("cell", "everywhere"): 4, ("exterior_facet", "everywhere"): 2}
    agree(degrees == expected, degrees)
    for part, known in ((one * ufl.ds, density(u) * ufl.dx), (one * ufl.dx, one * ufl.dx)):
        agree(match_quadrature_degree(part, ufl.derivative(known, u, v)) == part)


@pytest.mark.parametrize("kind", [int, np.int32, np.int64])
@pytest.mark.parametrize("cell", [Cell.triangle, Cell.quadrilateral])
def test_a_bound_holds_on_curved_cells(cell, kind):
    """The bound holds on curved cells, and a stated degree of any integer type is kept."""
    mesh = bent(cube(2, 2, cell))
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 2)))
    for energy in (u**2, ufl.inner(ufl.grad(u), ufl.grad(u)), ufl.exp(u)):
        limited = limit_quadrature_degree(energy * ufl.dx, kind(4))
        agree(highest(limited) <= 4)
    agree(highest(u * ufl.dx(degree=kind(7))) == 7)
    agree(highest(limit_quadrature_degree(u * ufl.dx(degree=kind(7)), 4)) == 7)
    agree(highest(limit_quadrature_degree(ufl.exp(u) * ufl.dx(degree=kind(-1)), 4)) == 4)


def highest(form: ufl.Form) -> int:
    """Return the highest degree by which FFCx integrates a form."""
    data = ufl.algorithms.compute_form_data(
        form, do_apply_integral_scaling=True, do_append_everywhere_integrals=False
    )
    found = [i.metadata() for group in data.integral_data for i in group.integrals]
    stated = [int(m.get("quadrature_degree", -1)) for m in found]
    estimated = [int(np.max(m["estimated_polynomial_degree"])) for m in found]
    return max(s if s >= 0 else e for s, e in zip(stated, estimated, strict=True))


def degrees_of(form: ufl.Form) -> set[int]:
    """Return the degrees by which FFCx integrates a form."""
    return set(quadrature_degrees(form).values())


@pytest.mark.parametrize("kind", ["residual", "energy", "given"])
def test_a_derived_tangent_has_the_degrees_of_its_residual(kind):
    """A derived tangent has its residual's degrees, on each type and part of the domain."""
    u = unknown()
    V = u.function_space
    mesh = u.function_space.mesh
    v = ufl.TestFunction(V)
    du = ufl.TrialFunction(V)
    cells = dolfinx.mesh.locate_entities(mesh, 2, lambda x: x[0] <= 0.5)
    tags = dolfinx.mesh.meshtags(mesh, 2, cells, np.full(len(cells), 1, dtype=np.int32))
    dx = ufl.Measure("dx", mesh, subdomain_data=tags)
    gap = u[0] - 0.1
    energy = density(u) * dx + (gap * abs(gap)) * dx(1) + ufl.exp(u[1]) * ufl.ds
    residual = ufl.derivative(energy, u, v)
    F = energy if kind == "energy" else residual
    J = ufl.derivative(residual, u, du) if kind == "given" else None
    forms = derive(F, u, J=J, condense=(), energy=None, degree=None)
    agree(quadrature_degrees(forms.F_u) == quadrature_degrees(residual), forms.F_u)
    agree(quadrature_degrees(forms.J) == quadrature_degrees(residual), quadrature_degrees(forms.J))
    plain = ufl.derivative(residual, u, du)
    agree(quadrature_degrees(plain) != quadrature_degrees(residual), "UFL's own differ")
    agree(forms.has_given_tangent == (kind == "given"))


def test_an_energy_with_a_pressure_has_one_rule():
    """All residuals of an energy have one degree, so that K_up and K_pu are transposes."""
    u = unknown()
    p = dolfinx.fem.Function(dolfinx.fem.functionspace(u.function_space.mesh, ("DG", 0)))
    energy = (density(u) + p * (ufl.det(ufl.Identity(2) + ufl.grad(u)) - 1) - p**2 / 20) * ufl.dx
    forms = derive(energy, u, J=None, condense=(p,), energy=None, degree=None)
    degrees = degrees_of(forms.F_u)
    agree(degrees_of(forms.field_equations[0].residual) == degrees)
    agree(degrees_of(forms.J) == degrees)


def test_parts_of_one_integral_have_degrees_of_their_own():
    """An integral over two parts is split if their degrees differ, with the same sum."""
    u = unknown()
    mesh = u.function_space.mesh
    n = mesh.topology.index_map(2).size_local
    numbers = np.arange(n, dtype=np.int32) % 2 + 1
    tags = dolfinx.mesh.meshtags(mesh, 2, np.arange(n, dtype=np.int32), numbers)
    dx = ufl.Measure("dx", mesh, subdomain_data=tags)
    form = u[0] ** 2 * dx((1, 2)) + u[0] ** 4 * dx(2)
    known = quadrature_degrees(form)
    agree((known["cell", 1], known["cell", 2]) == (4, 8), known)
    stated = set_quadrature_degrees(form, known)
    agree(estimated_quadrature_degree(stated) == 0, "no integral is left to UFL")
    small(integral(stated) - integral(form), 1e-13)
    fixed = set_quadrature_degrees(u[0] ** 2 * dx(degree=3), known)
    agree(degrees_of(fixed) == {3}, "a degree that is stated stays")


def test_data_at_quadrature_points_state_their_degree():
    """Data at quadrature points set the degree of the residual and of its derivative."""
    u = unknown()
    mesh = u.function_space.mesh
    v = ufl.TestFunction(u.function_space)
    element = basix.ufl.quadrature_element("triangle", degree=3)
    data = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))
    F = (data * v[0] + ufl.inner(ufl.grad(u), ufl.grad(v))) * ufl.dx
    agree(degrees_of(F) == {3}, quadrature_degrees(F))
    forms = derive(F, u, J=None, condense=(), energy=None, degree=None)
    agree(degrees_of(forms.J) == {3}, quadrature_degrees(forms.J))
