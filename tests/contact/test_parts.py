# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Parts of a contact on a square, against values known by hand."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from problems import tagged
from ufl_values import scalar

import dolfinx
import ufl

from dolfinx_feti.contact.crossing import CrossingDetection
from dolfinx_feti.contact.evaluation import ContactEvaluation
from dolfinx_feti.contact.law import ContactLaw
from dolfinx_feti.contact.rounding import force_rounding
from dolfinx_feti.contact.state import PENALTY, ContactState
from dolfinx_feti.contact.stiffness import stiffness_quantile
from dolfinx_feti.contact.surface import ContactSurface
from dolfinx_feti.contact.surface_fields import SurfaceFields
from dolfinx_feti.contact.tools import Tool, gap_from, half_space, sphere
from dolfinx_feti.contact.traces import Traces
from dolfinx_feti.fem.compiler import Compiler

#: Penalty of the laws [stress per length].
PENALTY_OF_LAW = 10.0

#: Depth to which the plate covers the lower edge.
DEPTH = 0.01


def displacement() -> dolfinx.fem.Function:
    """Return a displacement of degree 2, zero, on a unit square of 4 × 4 quadrilaterals."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 4, 4, dolfinx.mesh.CellType.quadrilateral)
    return dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,))))


def lower_edge(u: dolfinx.fem.Function) -> ufl.Measure:
    """Return the measure of the lower edge, of degree 4."""
    mesh = u.function_space.mesh
    ds = tagged(mesh, lambda x: np.isclose(x[1], 0.0))
    return ds(1)(metadata={"quadrature_degree": 4})


def law_of(tool: Tool, u: dolfinx.fem.Function) -> ContactLaw:
    """Return the law of the lower edge and a tool, with a penalty and λ = 0."""
    law = ContactLaw(u, gap_from(tool, u), lower_edge(u), 1.0, "contact")
    law.penalty.x.array[:] = PENALTY_OF_LAW
    return law


def surface_of(law: ContactLaw) -> ContactSurface:
    """Return the points of the surface of a law."""
    return ContactSurface(law.multiplier.function_space, law.ds, law.weight, Compiler(COMM))


@pytest.fixture
def law() -> ContactLaw:
    """Return the law of the lower edge and a plate that covers it to ``DEPTH``."""
    return law_of(half_space((0.0, 1.0), offset=DEPTH), displacement())


@pytest.fixture
def surface(law: ContactLaw) -> ContactSurface:
    """Return the points of the lower edge."""
    return surface_of(law)


def total(values) -> float:
    """Return the sum of values over all processes."""
    return COMM.allreduce(float(np.sum(values)))


def assembled(form: ufl.Form) -> np.ndarray:
    """Return a linear form as an array of the owned dofs."""
    vector = dolfinx.fem.assemble_vector(dolfinx.fem.form(form))
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    index_map = vector.index_map
    return vector.array[: index_map.size_local * vector.block_size]


def test_law_has_the_energy_of_springs(law):
    """With λ = 0 the law's energy is ∫ ε g²/2 dA."""
    small(scalar(law.energy) - PENALTY_OF_LAW * DEPTH**2 / 2, 1e-15)


def test_virtual_work_is_the_derivative_of_the_energy():
    """The law's virtual work is UFL's derivative of its energy."""
    u = displacement()
    law = law_of(sphere(0.5, (0.5, -0.4)), u)
    v = ufl.TestFunction(u.function_space)
    expected = assembled(ufl.derivative(law.energy, u, v))
    equal(assembled(law.virtual_work), expected, 1e-12)


def test_tangent_is_the_derivative_of_the_virtual_work():
    """The tangent is the derivative of the virtual work for small penetrations g ≠ 0."""
    u = displacement()
    law = law_of(sphere(0.5, (0.5, -0.499)), u)
    direction = dolfinx.fem.Function(u.function_space)
    direction.interpolate(lambda x: np.vstack([x[0] * x[1] + 0.3, x[0] ** 2 - 0.4]))
    actual = assembled(ufl.action(law.tangent, direction))
    expected = assembled(ufl.derivative(law.virtual_work, u, direction))
    equal(actual, expected, 1e-12)


def test_tangent_bounds_the_curvature_of_a_deep_penetration():
    """For deep penetrations the tangent limits p in −p Δδg to that of a hundredth of a cell."""
    u = displacement()
    law = law_of(sphere(0.5, (0.5, -0.4)), u)
    direction = dolfinx.fem.Function(u.function_space)
    direction.interpolate(lambda x: np.vstack([np.ones_like(x[0]), np.zeros_like(x[0])]))
    bounded = ufl.action(ufl.action(law.tangent, direction), direction)
    exact = ufl.derivative(ufl.action(law.virtual_work, direction), u, direction)
    agree(scalar(bounded) > scalar(exact) > 0.0)


def test_surface_has_the_points_of_its_edge(surface):
    """The surface has three points on each facet, in the order of the facets."""
    small(total(len(surface.dofs)) - 12, 0.0)
    small(total(len(surface.facets)) - 4, 0.0)
    X = surface.coordinates()
    equal(X[:, 1], np.zeros(len(X)), 0.0)
    small(total(surface.weighted_areas) - 1.0, 1e-14)
    equal(surface.facet_areas(), np.full(len(surface.facets), 0.25), 1e-14)
    small(total(surface.weighted_areas * X[:, 0] ** 4) - 0.2, 1e-14)  # ∫ x⁴ dx
    equal(surface.cell_sizes, np.full(len(X), np.sqrt(2.0) / 4), 1e-14)


def test_surface_refuses_a_measure_without_facets(law):
    """A measure without facets is refused."""
    ds = law.ds(7)
    with raises(ValueError, "has no facets"):
        ContactSurface(law.multiplier.function_space, ds, 1.0, Compiler(COMM))


def test_surface_refuses_a_negative_weight(law):
    """A weight of the contact that is not positive is refused."""
    weight = 0.5 - ufl.SpatialCoordinate(law.u.function_space.mesh)[0]
    with raises(ValueError, "weight of a contact is not positive"):
        ContactSurface(law.multiplier.function_space, law.ds, weight, Compiler(COMM))


@pytest.mark.parametrize("quantile", [0.0, 0.9, 1.0])
def test_stiffness_of_springs_is_the_stiffness_per_area(law, surface, quantile):
    """The diagonal is that of springs s per area, lumped to the nodes by s ∫ φ_i dA.

    On an inner facet the two vertices get half of their entries, and the facet all of its own.
    """
    s = 3.0
    nodal_areas = Traces(law.u.function_space, surface).nodal_forces(np.ones(len(surface.dofs)))
    diagonal = np.repeat(s * nodal_areas, 2)
    stiffness = stiffness_quantile(surface, law.u.function_space, diagonal, quantile)
    small(stiffness - s, 1e-12)


def test_nodal_forces_of_a_pressure_have_its_resultant(law, surface):
    """The nodal forces of a pressure sum to its resultant."""
    p = 2.0 + surface.coordinates()[:, 0]
    forces = Traces(law.u.function_space, surface).nodal_forces(p)
    small(total(forces) - 2.5, 1e-14)


def test_fit_keeps_the_traces_of_u_and_the_forces(law, surface):
    """The fit of a trace of u is exact, and of any pressure has the same nodal forces."""
    traces = Traces(law.u.function_space, surface)
    x = surface.coordinates()[:, 0]
    equal(traces.fit(1.0 + x**2), 1.0 + x**2, 1e-9)
    other = 2.0 + np.cos(40.0 * x)
    fitted = traces.fit(other)
    equal(traces.nodal_forces(fitted), traces.nodal_forces(other), 1e-9)
    agree(COMM.allreduce(float(np.abs(fitted - other).sum())) > 0.1)


def test_values_below_a_plate(law, surface):
    """Gap, normals, pressure, force and area stretch below a plate are those known by hand."""
    law.multiplier.x.array[:] = 0.5
    values = ContactEvaluation(surface, law)
    n = len(surface.dofs)
    equal(values.gap(), np.full(n, -DEPTH), 1e-14)
    equal(values.normals(), np.tile([0.0, 1.0], (n, 1)), 1e-14)
    p = 0.5 + PENALTY_OF_LAW * DEPTH
    equal(values.pressure(), np.full(n, p), 1e-14)
    equal(values.force(), [0.0, p], 1e-13)
    law.u.interpolate(lambda x: np.vstack([0.5 * x[0], 0.0 * x[0]]))
    equal(values.area_stretch(), np.full(n, 1.5), 1e-13)
    law.u.interpolate(lambda x: np.vstack([0.0 * x[0], 0.0 * x[0] + 1.0]))
    equal(values.pressure(), np.zeros(n), 0.0)


def test_points_at_the_centre_of_a_hollow_tool_have_no_force():
    """∇g is undefined there, but such a point does not touch."""
    u = displacement()
    x = surface_of(law_of(half_space((0.0, 1.0), offset=DEPTH), u)).coordinates()
    points = np.vstack(COMM.allgather(x))
    law = law_of(sphere(10.0, tuple(points[0]), inside=True), u)
    values = ContactEvaluation(surface_of(law), law)
    agree(COMM.allreduce(int(np.isnan(values.normals()).sum())) > 0)
    equal(values.force(), [0.0, 0.0], 0.0)


def test_state_updates_the_multiplier(law, surface):
    """An update of the multiplier sets λ to the contact pressure."""
    values = ContactEvaluation(surface, law)
    state = ContactState(values, Traces(law.u.function_space, surface))
    small(state.violation() - DEPTH / (np.sqrt(2.0) / 4), 1e-14)
    small(state.force_change() - 1.0, 1e-14)  # λ is zero
    state.update_multiplier()
    equal(values.multiplier(), np.full(len(surface.dofs), PENALTY_OF_LAW * DEPTH), 1e-13)
    small(state.force_change() - 0.5, 1e-12)  # p is now 2 λ
    with state.without_tool():
        equal(values.pressure(), np.zeros(len(surface.dofs)), 0.0)
    small(state.force_change() - 0.5, 1e-12)


def test_state_raises_the_penalty_only(law, surface):
    """Penalties are raised where the stiffness asks for it, and never reduced."""
    traces = Traces(law.u.function_space, surface)
    values = ContactEvaluation(surface, law)
    state = ContactState(values, traces)
    areas = np.repeat(traces.nodal_forces(np.ones(len(surface.dofs))), 2)
    state.set_penalty(0.1 * PENALTY_OF_LAW / PENALTY * areas)
    equal(values.penalty(), np.full(len(surface.dofs), PENALTY_OF_LAW), 0.0)
    state.set_penalty(7.0 * areas)
    equal(values.penalty(), np.full(len(surface.dofs), 7.0 * PENALTY), 1e-12)
    state.grow_penalty(2.0)
    equal(values.penalty(), np.full(len(surface.dofs), 14.0 * PENALTY), 1e-12)
    agree(state.has_penalty())
    law.penalty.x.array[:] = 0.0
    agree(not state.has_penalty())


@pytest.mark.parametrize(("distance", "crosses"), [(0.5, True), (-0.5, False)])
def test_crossing_is_seen_behind_a_thin_tool(distance, crosses):
    """A surface that has crossed a thin tool is detected, and one that moved away is not."""
    u = displacement()
    law = law_of(sphere(0.05, (0.5, 0.25)), u)
    detection = CrossingDetection(ContactEvaluation(surface_of(law), law))
    u.interpolate(lambda x: np.vstack([0.0 * x[0], 0.0 * x[0] + distance]))
    agree(detection.has_crossed(1e-3) == crosses)
    equal(u.x.array.reshape(-1, 2)[:, 1], np.full(len(u.x.array) // 2, distance), 0.0)


def test_rounding_of_forces_is_that_of_the_distance():
    """The rounding of forces is that of the tool's distances, here 1e-12; u is restored."""
    u = displacement()
    law = law_of(sphere(1e4, (0.5, -1e4 + DEPTH)), u)
    surface = surface_of(law)
    traces = Traces(u.function_space, surface)
    rounding = force_rounding(ContactEvaluation(surface, law), traces)
    ones = traces.nodal_forces(np.ones(len(surface.dofs)))
    of_one = np.sqrt(COMM.allreduce(float(ones @ ones)))
    error = rounding / (PENALTY_OF_LAW * of_one)
    agree(1e-13 < error < 1e-11)
    equal(u.x.array, np.zeros(len(u.x.array)), 0.0)


def test_fields_have_the_values_of_their_points(surface):
    """Fields on the mesh of the edge have the values of their points."""
    fields = SurfaceFields(surface)
    f = fields.create("x")
    fields.set_values(f, surface.coordinates()[:, 0])
    mesh = f.function_space.mesh
    x = ufl.SpatialCoordinate(mesh)[0]
    dx = ufl.dx(mesh, metadata={"quadrature_degree": 4})
    difference = total(dolfinx.fem.assemble_scalar(dolfinx.fem.form((f - x) ** 2 * dx)))
    length = total(dolfinx.fem.assemble_scalar(dolfinx.fem.form(f * dx)))
    small(difference, 1e-28)
    small(length - 0.5, 1e-14)
