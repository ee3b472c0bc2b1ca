# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from ufl_values import scalar, value, variable

import dolfinx
import ufl

from dolfinx_feti import kinematics as kin

F_ANY = np.array([[1.2, 0.3, -0.1], [0.05, 0.9, 0.2], [-0.2, 0.1, 1.1]])


def test_deformation_gradient_of_an_affine_displacement():
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2)
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,))))
    u.interpolate(lambda x: (F_ANY - np.eye(3)) @ x)
    F = kin.deformation_gradient(u)
    for i, j in ((0, 0), (0, 1), (1, 0), (2, 1)):
        assert scalar(F[i, j] * ufl.dx) == pytest.approx(F_ANY[i, j], abs=1e-13)


def test_every_deformation_gradient_gives_the_same_form():
    """Variables are numbered anew in each form, so that the compiler's cache serves again."""
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,))))
    first, second = (
        ufl.derivative(ufl.det(kin.deformation_gradient(u)) * ufl.dx, u) for _ in range(2)
    )
    assert first.signature() == second.signature()


@pytest.mark.parametrize("with_jacobian", [True, False])
def test_isochoric_invariants(with_jacobian):
    F = variable(F_ANY)
    C, J = kin.right_cauchy_green(F), kin.jacobian(F) if with_jacobian else None
    a = np.array([0.6, 0.0, 0.8])
    C_bar = F_ANY.T @ F_ANY / np.linalg.det(F_ANY) ** (2 / 3)
    assert value(kin.isochoric_invariant_1(C, J)) == pytest.approx(np.trace(C_bar), rel=1e-14)
    minors = np.trace(np.linalg.inv(C_bar))  # as det C̄ = 1
    assert value(kin.isochoric_invariant_2(C, J)) == pytest.approx(minors, rel=1e-13)
    I4 = kin.isochoric_invariant_4(C, ufl.as_vector(a.tolist()), J)
    assert value(I4) == pytest.approx(a @ C_bar @ a, rel=1e-14)
    b = np.array([0.8, 0.0, -0.6])
    I5 = kin.isochoric_invariant_5(C, ufl.as_vector(a.tolist()), J)
    I8 = kin.isochoric_invariant_8(C, *map(ufl.as_vector, (a.tolist(), b.tolist())), J)
    assert value(I5) == pytest.approx(a @ C_bar @ C_bar @ a, rel=1e-14)
    assert value(I8) == pytest.approx(a @ C_bar @ b, rel=1e-13)


def test_two_dimensions_are_plane_strain():
    plane = F_ANY[:2, :2]
    solid = np.eye(3)
    solid[:2, :2] = plane
    C2, C3 = (kin.right_cauchy_green(variable(F)) for F in (plane, solid))
    for invariant in (kin.isochoric_invariant_1, kin.isochoric_invariant_2):
        assert value(invariant(C2)) == pytest.approx(value(invariant(C3)), rel=1e-14)


def test_cauchy_stress_by_hand():
    """Ψ = μ/2 (tr C − 3) has σ = μ F Fᵀ / J."""
    F = variable(F_ANY)
    sigma = value(kin.cauchy_stress(0.5 * 4.0 * (ufl.tr(kin.right_cauchy_green(F)) - 3), F))
    np.testing.assert_allclose(sigma, 4.0 * F_ANY @ F_ANY.T / np.linalg.det(F_ANY), rtol=1e-13)


def test_cauchy_stress_refuses_a_foreign_variable():
    psi = kin.jacobian(variable(F_ANY))
    for other in (variable(F_ANY), ufl.as_matrix(F_ANY.tolist())):
        with pytest.raises(ValueError, match="psi does not depend"):
            kin.cauchy_stress(psi, other)


def test_stress_magnitude():
    sigma = np.array([[1.0, 2.0, -1.0], [2.0, 3.0, 0.5], [-1.0, 0.5, -2.0]])
    by_hand = np.sqrt(1 + 9 + 4 + 2 * (4 + 1 + 0.25))
    assert value(kin.stress_magnitude(variable(sigma))) == pytest.approx(by_hand)
