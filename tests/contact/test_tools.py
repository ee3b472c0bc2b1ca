# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Signed distances of tools at points whose distance is known by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from collective import COMM, raises

import dolfinx
import ufl

from dolfinx_feti.contact import Contact, cylinder, half_space, sphere, torus, union

pytestmark = pytest.mark.serial

PLACES = {
    "plate": (half_space((0, 0, 2), (1, 1, 1)), (5, 6, 4), 3.0),
    "plate-offset": (half_space((0, 1, 0), offset=0.5), (5, 6, 4), 5.5),
    "plate-of-any-length": (half_space((3, 4, 0)), (1, 1, 9), 1.4),
    "sphere": (sphere(2.0), (0, 3, 4), 3.0),
    "sphere-hollow": (sphere(7.0, (0, 0, 1), inside=True), (0, 3, 5), 2.0),
    "cylinder": (cylinder((0, 0, 3), 1.0, (1, 0, 7)), (4, 4, -8), 4.0),
    "cylinder-hollow": (cylinder((0, 0, 1), 7.0, inside=True), (3, 4, 5), 2.0),
    "torus": (torus((0, 0, 1), 5.0, 1.0), (3, 4, 3), 2.0),
    "torus-inside": (torus((0, 0, 1), 5.0, 1.0, inside=True), (3, 4, 0.25), 0.75),
    "union": (union(sphere(1.0), sphere(1.0, (9, 0, 0))), (7, 0, 0), 1.0),
}


@pytest.mark.parametrize("name", PLACES)
def test_distance(name):
    """The distance of a tool is that known by hand."""
    tool, place, distance = PLACES[name]
    assert math.isclose(ufl.as_ufl(tool(ufl.as_vector(place)))(()), distance, rel_tol=1e-12)


def test_constant_moves_a_tool():
    """A Constant in a tool moves it."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 1, 1)
    radius = dolfinx.fem.Constant(mesh, 1.0)
    centre = dolfinx.fem.Constant(mesh, np.zeros(2))
    distance = sphere(radius, centre)(ufl.as_vector([3.0, 4.0])) * ufl.dx(mesh)
    values = []
    for size, place in ((1.0, (0, 0)), (2.0, (3, 0))):
        radius.value = size
        centre.value = place
        form = dolfinx.fem.form(distance)
        values.append(COMM.allreduce(dolfinx.fem.assemble_scalar(form)))
    np.testing.assert_allclose(values, [4.0, 2.0], rtol=1e-14)


#: A tool that a number c places or turns, and its distance from (3, 4, 12) for c = 0 and c = 1.
PLACED = {
    "plate-point": (lambda c: half_space((0, 0, 1), (0, 0, 2 * c)), 12.0, 10.0),
    "plate-normal": (lambda c: half_space((0, c, 1 - c)), 12.0, 4.0),
    "sphere-centre": (lambda c: sphere(1.0, (0, 0, 12 * c)), 12.0, 4.0),
    "cylinder-point": (lambda c: cylinder((0, 0, 1), 1.0, (3 * c, 0, 0)), 4.0, 3.0),
    "cylinder-axis": (lambda c: cylinder((c, 0, 1 - c), 1.0), 4.0, math.hypot(4, 12) - 1.0),
    "torus-centre": (lambda c: torus((0, 0, 1), 5.0, 1.0, (0, 0, 12 * c)), 11.0, -1.0),
    "torus-axis": (lambda c: torus((0, 0, 1 + c), 5.0, 1.0), 11.0, 11.0),
    "list": (lambda c: sphere(1.0, [0, 0, 12 * c]), 12.0, 4.0),
}


@pytest.mark.parametrize("name", PLACED)
def test_constant_among_the_components_of_a_vector_moves_a_tool(name):
    """A tool follows a Constant that is one component of a point or a direction."""
    create_tool, first, second = PLACED[name]
    mesh = dolfinx.mesh.create_unit_square(COMM, 1, 1)
    c = dolfinx.fem.Constant(mesh, 0.0)
    place = ufl.as_vector([3.0, 4.0, 12.0])
    distance = dolfinx.fem.form(create_tool(c)(place) * ufl.dx(mesh))
    values = []
    for value in (0.0, 1.0):
        c.value = value
        values.append(COMM.allreduce(dolfinx.fem.assemble_scalar(distance)))
    np.testing.assert_allclose(values, [first, second], rtol=1e-14)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: sphere(0.0), "radius = 0.0: give a positive"),
        (lambda: sphere(1.0, (0, math.nan, 0)), "centre = .* give finite"),
        (lambda: sphere(1.0, 3.0), "centre = 3.0: give finite"),
        (lambda: cylinder((0, 0, 0), 1.0), "axis = .* not zero"),
        (lambda: half_space((0, 0, 1), offset=math.inf), "offset = inf"),
        (lambda: union(), "no tools"),
        (lambda: cylinder((0, 0, 1), 1.0)(ufl.as_vector([1.0, 2.0])), "3 components"),
    ],
    ids=["radius", "centre", "centre-number", "axis", "offset", "union", "plane"],
)
def test_bad_tools(make, words):
    """Tools with bad arguments are refused."""
    with pytest.raises(ValueError, match=words):
        make()


def _body():
    mesh = dolfinx.mesh.create_unit_square(COMM, 2, 2)
    return dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (2,))))


@pytest.mark.parametrize(
    ("make", "kind", "words"),
    [
        (lambda u: Contact(u, ufl.dx, sphere(1.0)), ValueError, "measure of a surface"),
        (lambda u: Contact(u, ufl.ds, 1.0), TypeError, "function of the position"),
        (lambda u: Contact(u, ufl.ds, lambda x: x), ValueError, "give a scalar"),
        (lambda u: Contact(u, ufl.ds, lambda x: 1.0), ValueError, "does not depend"),
        (lambda u: Contact(u[0], ufl.ds, sphere(1.0)), TypeError, "displacement"),
        (lambda u: Contact(u, ufl.ds, sphere(1.0)).force(), RuntimeError, "belongs to no problem"),
    ],
    ids=["measure", "tool", "shape", "position", "component", "problem"],
)
def test_bad_contacts(make, kind, words):
    """Contacts with bad arguments are refused."""
    with raises(kind, words):
        make(_body())
