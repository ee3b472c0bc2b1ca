# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The deformation gradient is detected in the forms, whatever the unknown is.

A volume ratio that is found is compared, by its values, with the determinant that is right.
"""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, equal, raises, small
from problems import cube, dirichlet, left, owned, right

import dolfinx
import ufl

from dolfinx_feti import ConvergenceError, NonlinearProblem
from dolfinx_feti.fem.user_forms.deformation import (
    GradientFactor,
    find_volume_ratio,
    volume_ratio_of_expression,
)

STEP = 0.1  # s

ONE = ufl.Identity(2)


class Fields:
    """An unknown u, known fields, and a time step, on a square."""

    def __init__(self):
        self.mesh = cube(2, 2)
        self.V = dolfinx.fem.functionspace(self.mesh, ("Lagrange", 2, (2,)))
        tensors = dolfinx.fem.functionspace(self.mesh, ("DG", 1, (2, 2)))
        self.u, self.last = dolfinx.fem.Function(self.V), dolfinx.fem.Function(self.V)
        self.G = dolfinx.fem.Function(tensors)
        self.dt = dolfinx.fem.Constant(self.mesh, STEP)
        self.x = ufl.SpatialCoordinate(self.mesh)
        self.u.interpolate(lambda x: np.stack([0.2 * x[0] * x[1] + 0.1 * x[1], -0.3 * x[0] ** 2]))
        self.last.interpolate(lambda x: np.stack([0.1 * x[1] ** 2, 0.2 * x[0]]))
        self.G.interpolate(lambda x: np.stack([1.2 + 0 * x[0], 0.1 * x[0], 0.2 * x[1], 1 + x[0]]))

    def at_points(self, expression):
        """Evaluate a scalar at some points of the owned cells."""
        points = np.array([[0.2, 0.3], [0.6, 0.1]])
        n = self.mesh.topology.index_map(2).size_local
        values = dolfinx.fem.Expression(expression, points, comm=COMM).eval(
            self.mesh, np.arange(n, dtype=np.int32)
        )
        return np.asarray(values).ravel()


def neo_hookean(F):
    """Return an energy that contains a determinant."""
    return ufl.inner(F, F) - 2 * ufl.ln(ufl.det(F))


def green_lagrange(F):
    """Return an energy of E = (Fᵀ F − I)/2, without a determinant."""
    E = (F.T * F - ufl.Identity(F.ufl_shape[0])) / 2
    return ufl.inner(E, E)


def axisymmetric(f, w, s=1):
    """Return F of a body symmetric about the axis x₀ = 0, in the order r, z, θ."""
    H = s * ufl.grad(w)
    hoop = s * w[0] / f.x[0]
    return ufl.as_matrix([[1 + H[0, 0], H[0, 1], 0], [H[1, 0], 1 + H[1, 1], 0], [0, 0, 1 + hoop]])


def hoop_in_the_middle(f):
    """Return F of an axisymmetric velocity, in the order r, θ, z."""
    w = f.dt * f.u
    row_r, row_z = ([w[i].dx(0), 0, w[i].dx(1)] for i in (0, 1))
    F = [[1 + row_r[0], *row_r[1:]], [0, 1 + w[0] / f.x[0], 0], [*row_z[:2], 1 + row_z[2]]]
    return ufl.as_matrix(F)


def by_indices(f):
    i, j = ufl.indices(2)
    return ufl.as_tensor(ONE[i, j] + f.u[i].dx(j), (i, j))


def through_the_last(f):
    """Return F = (I + Grad w F_n⁻¹) F_n."""
    F_n = ONE + ufl.grad(f.last)
    return (ONE + ufl.grad(f.u) * ufl.inv(F_n)) * F_n


#: F in the forms, and its factor before Grad u.
GRADIENTS = {
    "displacement": (lambda f: ONE + ufl.grad(f.u), 1.0),
    "variable": (lambda f: ufl.variable(ONE + ufl.grad(f.u)), 1.0),
    "transposed": (lambda f: ONE + ufl.nabla_grad(f.u), 1.0),
    "indices": (by_indices, 1.0),
    "velocity": (lambda f: ONE + f.dt * ufl.grad(f.u), STEP),
    "gradient-of-dt-v": (lambda f: ONE + ufl.grad(f.dt * f.u), STEP),
    "float-dt": (lambda f: ONE + 0.3 * ufl.grad(f.u), 0.3),
    "increment": (lambda f: ONE + ufl.grad(f.last + f.u), 1.0),
    "increment-in-a-sum": (lambda f: ONE + ufl.grad(f.u) + ufl.grad(f.last), 1.0),
    "last-and-velocity": (lambda f: (ONE + ufl.grad(f.last)) + f.dt * ufl.grad(f.u), STEP),
    "midpoint": (lambda f: ONE + ufl.grad((f.last + f.u) / 2), 0.5),
    "axisymmetric": (lambda f: axisymmetric(f, f.u), 1.0),
    "axisymmetric-velocity": (lambda f: axisymmetric(f, f.u, f.dt), STEP),
    "axisymmetric-increment": (lambda f: axisymmetric(f, f.last + f.u), 1.0),
    "hoop-in-the-middle": (hoop_in_the_middle, STEP),
    "plane-in-space": (lambda f: _in_space(ONE + f.dt * ufl.grad(f.u)), STEP),
}


def _in_space(F):
    """Plane strain, 3 × 3."""
    return ufl.as_matrix([[F[0, 0], F[0, 1], 0], [F[1, 0], F[1, 1], 0], [0, 0, 1]])


@pytest.mark.parametrize("way", ["energy", "residual"])
@pytest.mark.parametrize("density", [neo_hookean, green_lagrange])
@pytest.mark.parametrize("name", GRADIENTS)
def test_volume_ratio_is_that_of_the_forms(name, density, way):
    """The detected volume ratio is det F, in an energy and in a residual."""
    f = Fields()
    create, factor = GRADIENTS[name]
    F = create(f)
    form = density(F) * ufl.dx
    if way == "residual":
        form = ufl.derivative(form, f.u, ufl.TestFunction(f.V))
    ratio = find_volume_ratio([form], f.u)
    agree(ratio is not None and ratio.is_determinant, name)
    equal(f.at_points(ratio.of_body), f.at_points(ufl.det(F)), 1e-12)
    equal(f.at_points(ratio.of_energy), f.at_points(ufl.det(F)), 1e-12)
    small(GradientFactor(ratio).value() - factor, 1e-12)


def test_stress_by_differentiation():
    """F = I + Δt Grad v is detected in a residual with P = ∂Ψ/∂F."""
    f = Fields()
    F = ufl.variable(ONE + f.dt * ufl.grad(f.u))
    P = ufl.diff(neo_hookean(F), F)
    ratio = find_volume_ratio([ufl.inner(P, ufl.grad(ufl.TestFunction(f.V))) * ufl.dx], f.u)
    equal(f.at_points(ratio.of_body), f.at_points(ufl.det(F)), 1e-12)


@pytest.mark.parametrize("factor", [1.0, STEP])
@pytest.mark.parametrize("half", [0.5, 1.0])
def test_strain_without_a_gradient_in_it(half, factor):
    """F = I + H is detected in E = c (H + Hᵀ + Hᵀ H), which does not contain I + H."""
    f = Fields()
    H = factor * ufl.grad(f.u)
    E = half * (2 * ufl.sym(H) + H.T * H)
    ratio = find_volume_ratio([ufl.inner(E, E) * ufl.dx], f.u)
    equal(f.at_points(ratio.of_body), f.at_points(ufl.det(ONE + H)), 1e-12)


def test_several_gradients():
    """The volume ratio is the least determinant, as of the midpoint and the end of a step."""
    f = Fields()
    half = ONE + ufl.grad((f.last + f.u) / 2)
    end = ONE + ufl.grad(f.u)
    ratio = find_volume_ratio([neo_hookean(half) * ufl.dx + neo_hookean(end) * ufl.ds], f.u)
    dets = [f.at_points(ufl.det(F)) for F in (half, end)]
    equal(f.at_points(ratio.of_body), np.minimum(*dets), 1e-12)


def test_relative_to_the_last_state():
    """The determinants of F and of its increment, which the forms invert, are both watched."""
    f = Fields()
    F = through_the_last(f)
    ratio = find_volume_ratio([neo_hookean(F) * ufl.dx], f.u)
    dets = f.at_points(ufl.det(F)), f.at_points(ufl.det(F) / ufl.det(ONE + ufl.grad(f.last)))
    equal(f.at_points(ratio.of_body), np.minimum(*dets), 1e-12)


def test_elastic_part():
    """With F G⁻¹ in the forms, F is watched in the solve and F G⁻¹ in the cell check."""
    f = Fields()
    F = ONE + ufl.grad(f.u)
    for E in (F * ufl.inv(f.G), ufl.variable(F) * ufl.inv(f.G), F / f.G[0, 0]):
        ratio = find_volume_ratio([neo_hookean(E) * ufl.dx], f.u)
        equal(f.at_points(ratio.of_body), f.at_points(ufl.det(F)), 1e-12)
        equal(f.at_points(ratio.of_energy), f.at_points(ufl.det(E)), 1e-12)


def _linear_elasticity(f, v):
    strain = ufl.sym(ufl.grad(f.u))
    return ufl.inner(strain + 3 * ufl.tr(strain) * ONE, ufl.grad(v))


#: Integrands without a deformation gradient that can be shown.
NONE = {
    "linear-elasticity": _linear_elasticity,
    "p-laplace": lambda f, _: (1 + ufl.inner(ufl.grad(f.u), ufl.grad(f.u))) ** 1.5,
    "diffusion": lambda f, v: ufl.inner(ufl.inv(ONE + ufl.diag(f.u)) * ufl.grad(f.u), ufl.grad(v)),
    "tensor-of-unknown-meaning": lambda f, _: neo_hookean(f.G + ufl.grad(f.u)),
    "small-strains": lambda f, _: ufl.inner(ONE + ufl.sym(ufl.grad(f.u)), ONE),
    "known-gradient": lambda f, _: neo_hookean(ONE + ufl.grad(f.last)) * f.u[0] ** 2,
}


@pytest.mark.parametrize("name", NONE)
def test_forms_without_finite_strain_have_no_volume_ratio(name):
    """In forms without finite strains no volume ratio is detected."""
    f = Fields()
    form = NONE[name](f, ufl.TestFunction(f.V)) * ufl.dx
    agree(find_volume_ratio([form], f.u) is None, name)


def test_factor_follows_the_time_step():
    """The factor of the gradient is the present time step."""
    f = Fields()
    form = neo_hookean(ONE + f.dt * ufl.grad(f.u)) * ufl.dx
    factor = GradientFactor(find_volume_ratio([form], f.u))
    for dt in (0.5, 1e-6, 1e3):
        f.dt.value = dt
        small(factor.value() / dt - 1.0, 1e-12)


def test_volume_ratio_that_a_user_names():
    """A user's volume ratio that is a determinant has a size, and any other one only a sign."""
    f = Fields()
    named = volume_ratio_of_expression(ufl.det(ONE + f.dt * ufl.grad(f.u)), f.u)
    agree(named.is_determinant)
    small(GradientFactor(named).value() - STEP, 1e-12)
    agree(not volume_ratio_of_expression(0.01 - f.u[0], f.u).is_determinant)


def test_volume_ratio_that_is_none():
    """A volume ratio that is a number or a tensor is refused."""
    f = Fields()
    with raises(TypeError, "volume_ratio is 1.0: give an expression"):
        volume_ratio_of_expression(1.0, f.u)
    with raises(ValueError, r"volume_ratio has the shape \(2, 2\): give a scalar"):
        volume_ratio_of_expression(ONE + ufl.grad(f.u), f.u)


def shorten(w, F, scale):
    """Return the problem of a bar of length 2 that is shortened by 0.4; w is u over ``scale``."""
    V = w.function_space

    def shortening(x):
        at_end = np.isclose(x[0], 1.0)
        return np.stack([np.where(at_end, -0.4 / scale, 0.0), 0.0 * x[1]])

    bcs = [dirichlet(V, left), dirichlet(V, right, shortening)]
    w.interpolate(lambda x: np.stack([-0.4 / scale * x[0], 0 * x[1]]))
    J = ufl.det(F)
    energy = (3 * (ufl.tr(F.T * F) - 2 - 2 * ufl.ln(J)) + 4 * ufl.ln(J) ** 2) * ufl.dx(degree=2)
    return NonlinearProblem(energy, w, bcs=bcs, subdomains=3)


@pytest.mark.parametrize("step", [1e-6, 0.1, 10.0, 1e6])
def test_velocity_gives_the_displacement(step):
    """With a velocity v as the unknown, det(I + Δt Grad v) is watched in any unit of time."""
    V = dolfinx.fem.functionspace(cube(2, 4), ("Lagrange", 1, (2,)))
    u = dolfinx.fem.Function(V)
    v = dolfinx.fem.Function(V)
    displaced = shorten(u, ONE + ufl.grad(u), 1.0)
    moved = shorten(v, ONE + step * ufl.grad(v), step)
    equal(step * owned(moved.solve()), owned(displaced.solve()), 1e-7)
    agree(len(moved.history) == len(displaced.history), (moved.history, displaced.history))


def test_inversion_of_a_velocity_is_seen():
    """With a velocity, inverted cells are detected for Δt = 10, and the message has the remedy."""
    V = dolfinx.fem.functionspace(cube(2, 4), ("Lagrange", 1, (2,)))
    v = dolfinx.fem.Function(V)
    problem = shorten(v, ONE + 10.0 * ufl.grad(v), 10.0)
    v.interpolate(lambda x: np.stack([-0.2 * x[0], 0 * x[1]]))
    with raises(ConvergenceError, "det F is not positive at the start.*volume_ratio="):
        problem.solve()
