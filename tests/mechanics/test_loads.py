# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pressures that follow a surface: tangents, potentials and volumes on a square and a cube."""

from __future__ import annotations

import functools

import numpy as np
import problems
import pytest
from cases import each
from problems import dirichlet, left, right, tagged
from ufl_values import scalar

import dolfinx
import ufl

from dolfinx_feti import loads
from dolfinx_feti.mechanics.kinematics import deformation_gradient

PRESSURE = 1.7


@functools.cache
def cube(dim):
    """Return a P2 space on the unit cube or square, and a measure whose tag 1 is the face x = 0."""
    mesh = problems.cube(dim, 2)
    ds = tagged(mesh, left)(metadata={"quadrature_degree": 6})
    return dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (dim,))), ds


def function(V, f):
    result = dolfinx.fem.Function(V)
    dim = V.mesh.geometry.dim
    result.interpolate(lambda x: np.array(f(x))[:dim])
    return result


def bulge(x):
    """Return a displacement of everything, rims included."""
    y = 0.3 * np.cos(x[1]) + 0.1 * x[0]
    return [0.2 * x[1] ** 2 - 0.1 * x[2] * x[0], y, 0.2 * x[0] * x[2] - 0.1 * x[1]]


def wave(x):
    return [np.sin(2 * x[1]) + x[2], x[0] - x[2] ** 2, np.cos(x[1] + x[2])]


def twist(x):
    return [x[1] * x[2] - 1, x[0] + x[1] ** 2, np.sin(3 * x[1]) * x[2] + 0.3]


def within(x, dim):
    """Return a displacement that is zero on the rim of the face x = 0."""
    return x[1] * (1 - x[1]) * (x[2] * (1 - x[2]) if dim == 3 else 1)


dims = pytest.mark.parametrize("dim", [2, 3])


def test_mmhg():
    """1 mmHg is 0.1333223684 kPa."""
    assert loads.mmhg(1) == pytest.approx(0.1333223684, rel=1e-9)
    assert loads.mmhg(760) == pytest.approx(101.325, rel=1e-15)
    assert loads.mmhg(0) == 0


@dims
def test_nanson(dim):
    """Nanson's formula holds, cof(F) = J F⁻ᵀ."""
    V, ds = cube(dim)
    u = function(V, bulge)
    v = function(V, wave)
    F = deformation_gradient(u)
    traction = -PRESSURE * ufl.det(F) * ufl.inv(F).T * ufl.FacetNormal(V.mesh)
    residual = loads.follower_pressure(PRESSURE, u, ufl.TestFunction(V), ds(1))
    by_hand = -scalar(ufl.inner(traction, v) * ds(1))
    assert scalar(residual, v) == pytest.approx(by_hand, rel=1e-12)


@dims
def test_full_tangent_by_finite_differences(dim):
    """The full tangent is the derivative of the pressure's residual."""
    V, ds = cube(dim)
    u, d, w = (function(V, f) for f in (bulge, wave, twist))
    v = ufl.TestFunction(V)
    du = ufl.TrialFunction(V)
    tangent = loads.follower_pressure_tangent(PRESSURE, u, v, du, ds(1), "full")
    h = 1e-3
    ends = []  # the residual is quadratic in u: central differences are exact
    for sign in (1, -1):
        moved = dolfinx.fem.Function(V)
        moved.x.array[:] = u.x.array + sign * h * d.x.array
        ends.append(scalar(loads.follower_pressure(PRESSURE, moved, v, ds(1)), w))
    exact = scalar(tangent, d, w)
    assert abs(exact) > 0.05
    assert exact == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-9)


@dims
def test_symmetric_tangent(dim):
    """The symmetric tangent is the symmetric part of the full one."""
    V, ds = cube(dim)
    u, d, w = (function(V, f) for f in (bulge, wave, twist))
    v = ufl.TestFunction(V)
    du = ufl.TrialFunction(V)
    full = loads.follower_pressure_tangent(PRESSURE, u, v, du, ds(1), "full")
    symmetric = loads.follower_pressure_tangent(PRESSURE, u, v, du, ds(1), "symmetric")
    a = scalar(full, d, w)
    a_T = scalar(full, w, d)
    assert abs(a - a_T) > 0.05  # an open surface whose rim moves
    assert scalar(symmetric, d, w) == pytest.approx((a + a_T) / 2, rel=1e-12)
    assert scalar(symmetric, d, w) == pytest.approx(scalar(symmetric, w, d), rel=1e-12)


def end(k):
    """Return a marker of the two faces normal to an axis."""
    return lambda x: np.isclose(x[k], 0) | np.isclose(x[k], 1)


def chosen(V, ds, p=PRESSURE, bcs=None):
    """Return the kind of tangent that ``auto`` chooses."""
    u = function(V, bulge)
    v = ufl.TestFunction(V)
    du = ufl.TrialFunction(V)
    auto = loads.follower_pressure_tangent(p, u, v, du, ds, bcs=bcs)
    kinds = ("symmetric", "full")
    forms = {kind: loads.follower_pressure_tangent(p, u, v, du, ds, kind) for kind in kinds}
    (kind,) = (kind for kind in kinds if forms[kind].signature() == auto.signature())
    return kind


@dims
def test_kind_follows_from_the_rim(dim):
    """``auto`` chooses the symmetric tangent if the whole rim is clamped or slides in planes."""
    V, ds = cube(dim)
    across = range(1, dim)
    clamped = [dirichlet(V, end(k)) for k in across]
    assert chosen(V, ds(1), bcs=clamped) == "symmetric"
    assert chosen(V, ds(1), bcs=[dirichlet(V, end(k), component=k) for k in across]) == "symmetric"
    assert chosen(V, ds(1), bcs=[dirichlet(V, end(k), component=0) for k in across]) == "symmetric"
    if dim == 3:  # these edges of the rim leave their plane
        assert chosen(V, ds(1), bcs=[clamped[0], dirichlet(V, end(2), component=1)]) == "full"
    assert chosen(V, ds(1), bcs=[dirichlet(V, lambda x: np.isclose(x[1], 1))]) == "full"
    assert chosen(V, ds(1), bcs=[dirichlet(V, right)]) == "full"
    assert chosen(V, ds(1), bcs=[]) == "full"


@dims
def test_closed_surface_needs_no_conditions(dim):
    """A closed surface has a symmetric tangent without conditions, an open one needs ``bcs=``."""
    V, ds = cube(dim)
    assert chosen(V, ds) == "symmetric"
    with pytest.raises(ValueError, match=r"has a rim, .* give bcs=, the Dirichlet conditions"):
        chosen(V, ds(1))


def test_pressure_that_varies_has_the_full_tangent():
    """A pressure that varies in space has the full tangent, whatever the rim is.

    Constants and expressions of them do not vary. The quadrature degree does not matter: where it
    is not exact, even the tangent of a clamped surface is a little unsymmetric.
    """
    V, ds = cube(3)
    bcs = [dirichlet(V, end(1)), dirichlet(V, end(2))]
    assert chosen(V, ds(1, metadata={"quadrature_degree": 1}), bcs=bcs) == "symmetric"
    p = dolfinx.fem.Constant(V.mesh, 0.0)
    x = ufl.SpatialCoordinate(V.mesh)
    assert chosen(V, ds(1), p=2.0 * p, bcs=bcs) == "symmetric"
    assert chosen(V, ds(1), p=p * x[0], bcs=bcs) == "full"
    scalar_field = dolfinx.fem.Function(dolfinx.fem.functionspace(V.mesh, ("DG", 0)))
    assert chosen(V, ds(1), p=scalar_field, bcs=bcs) == "full"


def test_nothing_to_add():
    """Without a tangent, or with zero pressure, the result is an empty form that can be added."""
    V, ds = cube(3)
    u = function(V, bulge)
    v = ufl.TestFunction(V)
    du = ufl.TrialFunction(V)
    stiffness = ufl.inner(ufl.grad(du), ufl.grad(v)) * ufl.dx
    for nothing in (
        loads.follower_pressure_tangent(PRESSURE, u, v, du, ds, "none"),
        loads.follower_pressure_tangent(0, u, v, du, ufl.ds),
        loads.follower_pressure(0.0, u, v, ufl.ds),
        loads.pressure_potential(0.0, u, ufl.ds),
    ):
        assert nothing.empty() and stiffness + nothing == stiffness


#: Wrong arguments of the tangent, made of u and ds, and the message.
WRONG_TANGENT = {
    "expression": (
        lambda u, ds: (2 * u, ds(1), {"bcs": []}),
        r"needs a dolfinx\.fem\.Function; give kind='symmetric' if",
    ),
    "no-facets": (
        lambda u, ds: (u, ds(7), {"bcs": []}),
        "ds has no facets: give the measure the facet tags",
    ),
    "kind": (lambda u, ds: (u, ds, {"kind": "half"}), "kind = 'half'"),
}


@each(("arguments", "message"), WRONG_TANGENT)
def test_bad_arguments_of_the_tangent(arguments, message):
    """Bad arguments of the tangent are refused with a remedy."""
    V, ds = cube(3)
    v = ufl.TestFunction(V)
    du = ufl.TrialFunction(V)
    u, surface, options = arguments(function(V, bulge), ds)
    with pytest.raises(ValueError, match=message):
        loads.follower_pressure_tangent(PRESSURE, u, v, du, surface, **options)


def test_infinite_pressure():
    """An infinite pressure is refused."""
    V, ds = cube(3)
    with pytest.raises(ValueError, match="p = inf"):
        loads.pressure_potential(float("inf"), function(V, bulge), ds)


@pytest.mark.parametrize(
    "axis",
    [(0.0, 0.0, 0.0), (0.0, 1.0), (float("nan"), 0.0, 1.0)],
    ids=["zero", "two-components", "nan"],
)
def test_bad_axis(axis):
    """An axis that is not one of the space is refused."""
    V, ds = cube(3)
    with pytest.raises(ValueError, match="axis = "):
        loads.enclosed_volume(function(V, bulge), ds, axis)


@pytest.mark.parametrize(("dim", "axis"), [(2, None), (3, None), (3, (0.0, 0.0, 2.0)), (2, (1, 1))])
def test_volume_of_a_closed_surface(dim, axis):
    """The volume enclosed by a solid's skin is −∫ J dX, as its normals point outwards."""
    V, ds = cube(dim)
    u = function(V, bulge)
    J = ufl.det(deformation_gradient(u))
    body = scalar(J * ufl.dx(V.mesh))
    assert scalar(loads.enclosed_volume(u, ds, axis)) == pytest.approx(-body, rel=1e-12)


@dims
def test_potential_of_a_clamped_surface(dim):
    """The derivative of −p V is the follower pressure for variations that vanish on the rim."""
    V, ds = cube(dim)
    u = function(V, bulge)
    v = ufl.TestFunction(V)
    p = dolfinx.fem.Constant(V.mesh, PRESSURE)
    slope = ufl.derivative(loads.pressure_potential(p, u, ds(1)), u, v)
    residual = loads.follower_pressure(p, u, v, ds(1))
    fixed = function(V, lambda x: np.array(wave(x)) * within(x, dim))
    assert abs(scalar(residual, fixed)) > 1e-2
    assert scalar(slope, fixed) == pytest.approx(scalar(residual, fixed), rel=1e-11)
    moving = function(V, wave)
    assert abs(scalar(slope, moving) - scalar(residual, moving)) > 1e-2


def test_potential_of_a_tube_whose_ends_slide():
    """The potential holds for rims sliding in planes normal to the axis, or of symmetry.

    The face x = 0 has its rims z = 0 and z = 1 in such planes, the rim y = 0 in a plane of symmetry
    through the origin, and its rim y = 1 clamped.
    """
    V, ds = cube(3)
    u = function(V, lambda x: [0.1 * x[1] ** 2 + 0.2 * x[2], 0.2 * x[1], 0 * x[0]])
    v = ufl.TestFunction(V)
    residual = loads.follower_pressure(PRESSURE, u, v, ds(1))
    slide = function(V, lambda x: [1 - x[1], x[1] * (1 - x[1]), x[2] * (1 - x[2]) * (1 - x[1])])
    slopes = [
        scalar(ufl.derivative(loads.pressure_potential(PRESSURE, u, ds(1), axis), u, v), slide)
        for axis in (None, (0, 0, 1))
    ]
    assert slopes[1] == pytest.approx(scalar(residual, slide), rel=1e-11)
    assert abs(slopes[0] - slopes[1]) > 1e-3
