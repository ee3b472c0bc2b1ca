# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Residual stress: a ring that is cut opens by its angle, without stress afterwards."""

from __future__ import annotations

import numpy as np
import pytest
from collective import COMM, agree, raises, small, whole
from problems import dirichlet
from ufl_values import scalar, value, variable

import dolfinx
import ufl

from dolfinx_feti import NonlinearProblem, kinematics, materials
from dolfinx_feti.mechanics.residual_stress import (
    elastic_part,
    opening_deformation,
    residual_stretch,
    stress_free_direction,
)

INNER = 1.0
OUTER = 1.4
MIDDLE = (INNER + OUTER) / 2


def half_ring(angle: float, stretch: float = 1.0):
    """Return half a ring in plane strain on the plane y = 0, with its directions and energy."""
    mesh = dolfinx.mesh.create_rectangle(
        COMM, [(INNER, 0.0), (OUTER, np.pi)], (4, 24), dolfinx.mesh.CellType.quadrilateral
    )
    r = mesh.geometry.x[:, 0].copy()
    θ = mesh.geometry.x[:, 1].copy()
    mesh.geometry.x[:, 0] = r * np.cos(θ)
    mesh.geometry.x[:, 1] = r * np.sin(θ)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u = dolfinx.fem.Function(V)
    x = ufl.SpatialCoordinate(mesh)
    ρ = ufl.sqrt(ufl.inner(x, x))
    λ = residual_stretch(1 / MIDDLE, ρ - MIDDLE, angle, stretch)
    e0 = ufl.as_vector([-x[1] / ρ, x[0] / ρ, 0])
    e2 = ufl.as_vector([x[0] / ρ, x[1] / ρ, 0])
    tensor = opening_deformation([e0, ufl.as_vector([0, 0, 1]), e2], λ, stretch)
    G = ufl.as_matrix([[tensor[i, j] for j in range(2)] for i in range(2)])
    F = kinematics.deformation_gradient(u)
    F_e = elastic_part(F, G)
    C = kinematics.right_cauchy_green(F_e)
    J = kinematics.jacobian(F_e)
    psi = materials.neo_hookean(C, c=3.0, J=J) + materials.volumetric(J, kappa=30.0)
    return u, F, psi


def held(u: dolfinx.fem.Function, *, closed: bool) -> list[dolfinx.fem.DirichletBC]:
    """Symmetry at y = 0 on the right, with one point fixed; the left end, too, where closed."""
    V = u.function_space
    ends = dirichlet(V, lambda x: np.isclose(x[1], 0.0) & (closed | (x[0] > 0)), component=1)
    W, _ = V.sub(0).collapse()
    corner = dolfinx.fem.locate_dofs_geometrical(
        (V.sub(0), W), lambda x: np.isclose(x[0], MIDDLE) & np.isclose(x[1], 0.0)
    )
    return [ends, dolfinx.fem.dirichletbc(dolfinx.fem.Function(W), corner, V.sub(0))]


def solve(angle: float, *, closed: bool):
    u, F, psi = half_ring(angle)
    bcs = held(u, closed=closed)
    problem = NonlinearProblem(psi * ufl.dx, u, bcs=bcs, quadrature_degree=4, subdomains=4)
    problem.solve()
    return u, F, psi


@pytest.mark.parametrize("angle", [30.0, -20.0])
def test_ring_that_is_cut_opens_by_its_angle(angle):
    """The cut end of half a ring turns by half of the opening angle, with zero energy."""
    u, _, psi = solve(angle, closed=False)
    V = u.function_space
    X = V.tabulate_dof_coordinates()[:, :2]
    end = np.isclose(X[:, 1], 0.0, atol=1e-12) & (X[:, 0] < 0)
    X, x = whole(X[end]), whole((X + u.x.array.reshape(-1, 2))[end])
    direction = x[X[:, 0].argmin()] - x[X[:, 0].argmax()]  # from the inside to the outside
    turned = np.degrees(np.arctan2(direction[1], -direction[0]))
    small(abs(turned) - abs(angle) / 2, 0.01 * abs(angle))
    closed_energy = scalar(half_ring(angle)[2] * ufl.dx(metadata={"quadrature_degree": 4}))
    left = scalar(psi * ufl.dx(metadata={"quadrature_degree": 4}))
    small(left, 1e-3 * closed_energy)


def test_closed_ring_is_stretched_outside_and_pressed_inside():
    """In a closed ring the hoop stress is tensile outside, compressive inside, and balanced."""
    _, F, psi = solve(60.0, closed=True)
    sigma = kinematics.cauchy_stress(psi, F)
    mesh = ufl.domain.extract_unique_domain(F)
    x = ufl.SpatialCoordinate(mesh)
    ρ = ufl.sqrt(ufl.inner(x, x))
    e = ufl.as_vector([-x[1] / ρ, x[0] / ρ])
    hoop = ufl.inner(e, sigma * e)
    dx = ufl.dx(metadata={"quadrature_degree": 4})
    outside, inside = (
        scalar(hoop / ρ * ufl.conditional(ufl.gt(s * (ρ - MIDDLE), 0), 1, 0) * dx) for s in (1, -1)
    )
    agree(outside > 0.0 > inside)
    small(outside + inside, 0.05 * outside)  # no load is carried


def test_no_angle_no_stretch():
    """Without an opening angle the energy is zero."""
    *_, psi = half_ring(0.0)
    small(scalar(psi * ufl.dx(metadata={"quadrature_degree": 4})), 1e-12)


@pytest.mark.parametrize("angle", [0.0, 29.0, 62.0])
def test_an_oblique_fibre_of_the_image(angle):
    """The stress of an oblique fibre of the image is that of the fibre in the opened pieces."""
    G = np.diag([1 / 1.3, 1 / 1.1, 1.43])  # opens and becomes shorter
    a = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])
    A = G @ a / np.linalg.norm(G @ a)
    F = np.array([[1.1, 0.05, 0.0], [0.0, 1.2, 0.02], [0.01, 0.0, 0.8]])

    def stress(F, fibre, G):
        F_e = elastic_part(F, G)
        C = kinematics.right_cauchy_green(F_e)
        J = kinematics.jacobian(F_e)
        psi = materials.neo_hookean(C, c=3.0, J=J)
        psi += 20.0 * (kinematics.isochoric_invariant_4(C, fibre, J) - 1) ** 2
        return value(kinematics.cauchy_stress(psi, F))

    fibre = ufl.as_vector(a.tolist())
    residual = ufl.as_matrix(G.tolist())
    F_e = variable(F @ np.linalg.inv(G))
    exact = stress(F_e, ufl.as_vector(A.tolist()), ufl.Identity(3))
    found = stress(variable(F), stress_free_direction(fibre, residual), residual)
    np.testing.assert_allclose(found, exact, atol=1e-12 * np.abs(exact).max())
    if angle:  # as it is, the direction of the image is wrong there
        assert (
            np.abs(stress(variable(F), fibre, residual) - exact).max() > 0.02 * np.abs(exact).max()
        )


def test_bad_input():
    """A G whose dimension is not that of the fibre or of F is refused."""
    with raises(ValueError, r"G has the shape \(3, 3\) and a \(2,\)"):
        stress_free_direction(ufl.as_vector([1, 0]), ufl.Identity(3))
    with raises(ValueError, r"G has the shape \(2, 2\) and F \(3, 3\)"):
        elastic_part(ufl.Identity(3), ufl.Identity(2))
