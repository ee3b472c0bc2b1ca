# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The heart's muscle: energies and stresses by hand, and the tension of its fibres."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from ufl_values import scalar, value, variable

import dolfinx
import ufl

from dolfinx_feti import kinematics as kin
from dolfinx_feti import materials as mat

pytestmark = pytest.mark.serial

LAND = {"c": 2.0, "b_f": 8.0, "b_t": 2.0, "b_fs": 4.0}
PIG = {
    "a": 0.059, "b": 8.023, "a_f": 18.472, "b_f": 16.026,
    "a_s": 2.481, "b_s": 11.120, "a_fs": 0.216, "b_fs": 11.436,
}  # fmt: skip
FIBRE, SHEET = np.array([0.6, 0.0, 0.8]), np.array([0.8, 0.0, -0.6])
ANY = np.array([[1.1, 0.15, -0.1], [0.05, 0.9, 0.1], [-0.1, 0.1, 1.1]])


def vector(a):
    return ufl.as_vector(a.tolist())


def guccione(F, fibre=FIBRE, **changes):
    C, J = kin.right_cauchy_green(F), kin.jacobian(F)
    return mat.guccione(C, vector(fibre), **(LAND | changes), J=J)


def holzapfel_ogden(F, fibre=FIBRE, sheet=SHEET):
    C, J = kin.right_cauchy_green(F), kin.jacobian(F)
    return mat.holzapfel_ogden(C, vector(fibre), vector(sheet), **PIG, J=J)


def contracting(F, fibre=FIBRE, tension=60.0):
    return mat.active_tension(kin.right_cauchy_green(F), vector(fibre), tension=tension)


passive = pytest.mark.parametrize("energy", [guccione, holzapfel_ogden])


def piola(energy, F):
    F = variable(F)
    return value(ufl.diff(energy(F), F))


# -- by hand -----------------------------------------------------------------------------------


def test_guccione_by_hand():
    """Q of the strains in a frame (f, s, n), entry by entry, as in the benchmark's problem 1."""
    frame = np.array([FIBRE, SHEET, [0.0, 1.0, 0.0]])
    E = frame @ (ANY.T @ ANY / np.linalg.det(ANY) ** (2 / 3) - np.eye(3)) @ frame.T / 2
    Q = 8.0 * E[0, 0] ** 2 + 2.0 * np.sum(E[1:, 1:] ** 2) + 4.0 * 2 * np.sum(E[0, 1:] ** 2)
    assert value(guccione(variable(ANY))) == pytest.approx(np.expm1(Q), rel=1e-13)


def test_guccione_with_equal_exponents_is_isotropic():
    same = {"b_f": 3.0, "b_t": 3.0, "b_fs": 3.0}
    found = [value(guccione(variable(ANY), a, **same)) for a in (FIBRE, SHEET)]
    assert found[0] == pytest.approx(found[1], rel=1e-13)


def test_guccione_in_the_plane_is_plane_strain():
    solid = np.diag([1.2, 0.9, 1.0])
    a = np.array([0.6, 0.8, 0.0])
    plane = guccione(variable(solid[:2, :2]), a[:2])
    assert value(plane) == pytest.approx(value(guccione(variable(solid), a)), rel=1e-13)


def test_holzapfel_ogden_by_hand():
    """Simple shear of f along s by γ: I₁ = 3 + γ², I₄f = 1, I₄s = 1 + γ², I₈ = γ; det F = 1."""
    gamma = 0.3
    F = np.eye(3) + gamma * np.outer(FIBRE, SHEET)
    psi = 0.059 / (2 * 8.023) * np.expm1(8.023 * gamma**2)
    psi += 2.481 / (2 * 11.12) * np.expm1(11.12 * gamma**4)
    psi += 0.216 / (2 * 11.436) * np.expm1(11.436 * gamma**2)
    assert value(holzapfel_ogden(variable(F))) == pytest.approx(psi, rel=1e-12)


def test_shortened_fibres_and_sheets_are_asleep():
    """F = diag(0.8, 0.8, 1/0.64) in the frame (f, s, n): the matrix material alone resists."""
    n = np.array([0.0, 1.0, 0.0])
    families = zip((0.8, 0.8, 1 / 0.64), (FIBRE, SHEET, n), strict=True)
    F = sum(stretch * np.outer(a, a) for stretch, a in families)
    I1 = 2 * 0.64 + 0.64**-2
    psi = 0.059 / (2 * 8.023) * np.expm1(8.023 * (I1 - 3))
    assert value(holzapfel_ogden(variable(F))) == pytest.approx(psi, rel=1e-12)


def test_tension_is_a_second_piola_kirchhoff_stress_along_the_fibre():
    """T_a/2 (I₄ − 1), P = T_a F f ⊗ f; along a fibre that is pulled by λ the force is T_a λ."""
    I4 = FIBRE @ ANY.T @ ANY @ FIBRE
    assert value(contracting(variable(ANY))) == pytest.approx(30.0 * (I4 - 1), rel=1e-13)
    np.testing.assert_allclose(
        piola(contracting, ANY), 60.0 * np.outer(ANY @ FIBRE, FIBRE), rtol=1e-13, atol=1e-13
    )
    assert value(contracting(variable(ANY), tension=0.0)) == 0.0


def test_tension_of_a_part():
    """A Function: T_a = 60 kPa in one half of a cube that is stretched by 1.2 along f."""
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2)
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,))))
    u.interpolate(lambda x: np.array([0.2, 0.0, 0.0])[:, None] * x)
    tension = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    tension.interpolate(lambda x: 60.0 * (x[2] < 0.5))
    C = kin.right_cauchy_green(kin.deformation_gradient(u))
    psi = mat.active_tension(C, vector(np.eye(3)[0]), tension=tension)
    assert scalar(psi * ufl.dx) == pytest.approx(0.5 * 30.0 * 0.44, rel=1e-12)


# -- properties --------------------------------------------------------------------------------


@passive
def test_change_of_volume_is_not_seen(energy):
    found = [value(energy(variable(s * ANY))) for s in (1.0, 1.3)]
    assert found[0] == pytest.approx(found[1], rel=1e-12)
