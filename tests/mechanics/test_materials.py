# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Kinematics and energies of arteries and of the heart agree with derivations by hand."""

from __future__ import annotations

import dataclasses

from mpi4py import MPI

import numpy as np
import pytest
from ufl_values import scalar, value, variable
from walls import tube, wall

import dolfinx
import ufl

from dolfinx_feti import kinematics as kin
from dolfinx_feti import materials as mat
from dolfinx_feti.fem.quadrature import limit_quadrature_degree

KAPPA = 50.0
HGO = {"c": 3.0, "k1": 2.3632, "k2": 0.8393}
A1 = np.array([np.cos(0.5), np.sin(0.5), 0.0])
A2 = np.array([np.cos(0.5), -np.sin(0.5), 0.0])
STRETCHED = np.array([[1.2, 0.3, -0.1], [0.05, 0.9, 0.2], [-0.2, 0.1, 1.1]])
SQUEEZED = np.diag([0.8, 0.85, 1.5])
SHEARED = np.array([[1.0, 0.4, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def vector(a):
    return ufl.as_vector(a.tolist())


def fibred(F, J=None):
    C = kin.right_cauchy_green(F)
    return mat.holzapfel_gasser_ogden(C, vector(A1), vector(A2), **HGO, J=J)


def dispersed(F, dispersion):
    C = kin.right_cauchy_green(F)
    J = kin.jacobian(F)
    families = vector(A1), vector(A2)
    return mat.gasser_ogden_holzapfel(C, *families, **HGO, dispersion=dispersion, J=J)


def hand_stress(F):
    """Return the first Piola stress of the HGO energy, derived on paper."""
    J = np.linalg.det(F)
    inverse = np.linalg.inv(F).T
    scale = J ** (-2 / 3)
    piola = HGO["c"] * scale * (F - np.sum(F * F) / 3 * inverse)
    for a in (A1, A2):
        I4 = a @ F.T @ F @ a
        E = max(scale * I4 - 1, 0.0)
        factor = 2 * HGO["k1"] * E * np.exp(HGO["k2"] * E**2) * scale
        piola += factor * (np.outer(F @ a, a) - I4 / 3 * inverse)
    return piola


def piola(energy, F):
    F = variable(F)
    return value(ufl.diff(energy(F), F))


def test_fully_dispersed_fibres_are_isotropic():
    """With ϰ = 1/3 both families have E = (Ī₁ − 3)/3, whatever their direction."""
    E = value(kin.isochoric_invariant_1(variable(STRETCHED.T @ STRETCHED))) / 3 - 1
    psi = 4.5 * E + 2.3632 / 0.8393 * np.expm1(0.8393 * E**2)
    assert value(dispersed(variable(STRETCHED), 1 / 3)) == pytest.approx(psi, rel=1e-13)


# -- kinematics


def test_deformation_gradient_of_an_affine_displacement():
    """The deformation gradient of an affine displacement is its matrix."""
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2)
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,))))
    u.interpolate(lambda x: (STRETCHED - np.eye(3)) @ x)
    F = kin.deformation_gradient(u)
    for i, j in ((0, 0), (0, 1), (1, 0), (2, 1)):
        assert scalar(F[i, j] * ufl.dx) == pytest.approx(STRETCHED[i, j], abs=1e-13)


def test_every_deformation_gradient_gives_the_same_form():
    """Equal forms have one signature, as variables are numbered anew in each form."""
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 1, (3,))))
    first, second = (
        ufl.derivative(ufl.det(kin.deformation_gradient(u)) * ufl.dx, u) for _ in range(2)
    )
    assert first.signature() == second.signature()


@pytest.mark.parametrize("with_jacobian", [True, False])
def test_isochoric_invariants(with_jacobian):
    """Isochoric invariants are those of F̄ = J^(−1/3) F, with J given or not."""
    F = variable(STRETCHED)
    C = kin.right_cauchy_green(F)
    J = kin.jacobian(F) if with_jacobian else None
    a = np.array([0.6, 0.0, 0.8])
    C_bar = STRETCHED.T @ STRETCHED / np.linalg.det(STRETCHED) ** (2 / 3)
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
    """Invariants in two dimensions are those of plane strain."""
    plane = STRETCHED[:2, :2]
    solid = np.eye(3)
    solid[:2, :2] = plane
    C2, C3 = (kin.right_cauchy_green(variable(F)) for F in (plane, solid))
    for invariant in (kin.isochoric_invariant_1, kin.isochoric_invariant_2):
        assert value(invariant(C2)) == pytest.approx(value(invariant(C3)), rel=1e-14)
    a = np.array([0.6, 0.8, 0.0])
    for invariant in (kin.isochoric_invariant_4, kin.isochoric_invariant_5):
        solid = value(invariant(C3, vector(a)))
        assert value(invariant(C2, vector(a[:2]))) == pytest.approx(solid, rel=1e-14)


def test_cauchy_stress_by_hand():
    """The Cauchy stress of Ψ = μ/2 (tr C − 3) is μ F Fᵀ / J."""
    F = variable(STRETCHED)
    sigma = value(kin.cauchy_stress(0.5 * 4.0 * (ufl.tr(kin.right_cauchy_green(F)) - 3), F))
    np.testing.assert_allclose(
        sigma, 4.0 * STRETCHED @ STRETCHED.T / np.linalg.det(STRETCHED), rtol=1e-13
    )


def test_cauchy_stress_refuses_a_foreign_variable():
    """``cauchy_stress`` refuses an F on which the energy does not depend."""
    psi = kin.jacobian(variable(STRETCHED))
    for other in (variable(STRETCHED), ufl.as_matrix(STRETCHED.tolist())):
        with pytest.raises(ValueError, match="psi does not depend"):
            kin.cauchy_stress(psi, other)


def test_stress_magnitude():
    """The stress magnitude is the Frobenius norm."""
    sigma = np.array([[1.0, 2.0, -1.0], [2.0, 3.0, 0.5], [-1.0, 0.5, -2.0]])
    by_hand = np.sqrt(1 + 9 + 4 + 2 * (4 + 1 + 0.25))
    assert value(kin.stress_magnitude(variable(sigma))) == pytest.approx(by_hand)


# -- arteries


@pytest.mark.parametrize("F", [STRETCHED, SQUEEZED, SHEARED])
@pytest.mark.parametrize(
    "energy", [fibred, lambda F: fibred(F, kin.jacobian(F)), lambda F: dispersed(F, 0.0)]
)
def test_stress_is_the_one_derived_on_paper(energy, F):
    """The HGO stress is the one derived on paper, with J given or not, and with no dispersion."""
    np.testing.assert_allclose(piola(energy, F), hand_stress(F), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("length", [1 - 4e-16, 1.0, 1 + 4e-16])
def test_fibres_stiffen_the_reference_state_whatever_the_rounding(length):
    """At F = I, ∂²Ψ/∂F₁₁² is 4/3 c plus 8 k₁ (cos²θ − 1/3)² of two families, despite rounding."""
    F = variable(np.eye(3))
    a1 = vector(length * A1)
    a2 = vector(length * A2)
    psi = mat.holzapfel_gasser_ogden(kin.right_cauchy_green(F), a1, a2, **HGO)
    curvature = value(ufl.diff(ufl.diff(psi, F)[0, 0], F)[0, 0])
    by_hand = 4 / 3 * HGO["c"] + 2 * 4 * HGO["k1"] * (np.cos(0.5) ** 2 - 1 / 3) ** 2
    assert curvature == pytest.approx(by_hand, rel=1e-12)


def test_inverted_state_is_not_hidden():
    """An inverted state has no real energy: evaluating a power of its negative J fails."""
    F = variable(np.diag([-1.1, 1.0, 1.0]))
    with pytest.raises(TypeError):
        value(fibred(F, kin.jacobian(F)))


def test_perturbed_lagrangian_is_the_volumetric_energy_at_its_pressure():
    """At p = κ (J − 1) the perturbed Lagrangian is the volumetric energy."""
    J = 1.07
    pressure = KAPPA * (J - 1)
    field = ufl.variable(ufl.as_ufl(pressure))
    psi = mat.perturbed_lagrangian(ufl.as_ufl(J), field, KAPPA)
    assert value(psi) == pytest.approx(value(mat.volumetric(ufl.as_ufl(J), KAPPA)), rel=1e-13)
    assert value(ufl.diff(psi, field)) == pytest.approx(0, abs=1e-15)


def test_parameters_of_the_paper():
    """The default artery parameters are those of the paper, and immutable."""
    assert dataclasses.asdict(mat.ArteryParameters()) == HGO
    with pytest.raises(dataclasses.FrozenInstanceError):
        mat.ArteryParameters().c = 6.0


# -- the heart's muscle

LAND = {"c": 2.0, "b_f": 8.0, "b_t": 2.0, "b_fs": 4.0}
PIG = {
    "a": 0.059,
    "b": 8.023,
    "a_f": 18.472,
    "b_f": 16.026,
    "a_s": 2.481,
    "b_s": 11.120,
    "a_fs": 0.216,
    "b_fs": 11.436,
}
FIBRE = np.array([0.6, 0.0, 0.8])
SHEET = np.array([0.8, 0.0, -0.6])
ANY = np.array([[1.1, 0.15, -0.1], [0.05, 0.9, 0.1], [-0.1, 0.1, 1.1]])


def test_guccione_by_hand():
    """Guccione's Q is that of the strains in the frame (f, s, n), entry by entry."""
    frame = np.array([FIBRE, SHEET, [0.0, 1.0, 0.0]])
    E = frame @ (ANY.T @ ANY / np.linalg.det(ANY) ** (2 / 3) - np.eye(3)) @ frame.T / 2
    Q = 8.0 * E[0, 0] ** 2 + 2.0 * np.sum(E[1:, 1:] ** 2) + 4.0 * 2 * np.sum(E[0, 1:] ** 2)
    F = variable(ANY)
    psi = mat.guccione(kin.right_cauchy_green(F), vector(FIBRE), **LAND, J=kin.jacobian(F))
    assert value(psi) == pytest.approx(np.expm1(Q), rel=1e-13)


def holzapfel_ogden(F):
    C = kin.right_cauchy_green(F)
    J = kin.jacobian(F)
    return mat.holzapfel_ogden(C, vector(FIBRE), vector(SHEET), **PIG, J=J)


def test_holzapfel_ogden_by_hand():
    """In simple shear the Holzapfel–Ogden energy has its closed form, unchanged by volume.

    Shear of f along s by γ: I₁ = 3 + γ², I₄f = 1, I₄s = 1 + γ², I₈ = γ.
    """
    gamma = 0.3
    F = np.eye(3) + gamma * np.outer(FIBRE, SHEET)
    psi = 0.059 / (2 * 8.023) * np.expm1(8.023 * gamma**2)
    psi += 2.481 / (2 * 11.12) * np.expm1(11.12 * gamma**4)
    psi += 0.216 / (2 * 11.436) * np.expm1(11.436 * gamma**2)
    for scale in (1.0, 1.3):
        assert value(holzapfel_ogden(variable(scale * F))) == pytest.approx(psi, rel=1e-12)


def test_shortened_fibres_and_sheets_are_asleep():
    """Shortened fibres and sheets store no energy: F = diag(0.8, 0.8, 1/0.64)."""
    n = np.array([0.0, 1.0, 0.0])
    families = zip((0.8, 0.8, 1 / 0.64), (FIBRE, SHEET, n), strict=True)
    F = sum(stretch * np.outer(a, a) for stretch, a in families)
    I1 = 2 * 0.64 + 0.64**-2
    psi = 0.059 / (2 * 8.023) * np.expm1(8.023 * (I1 - 3))
    assert value(holzapfel_ogden(variable(F))) == pytest.approx(psi, rel=1e-12)


def contracting(F, tension=60.0):
    return mat.active_tension(kin.right_cauchy_green(F), vector(FIBRE), tension=tension)


def test_tension_is_a_second_piola_kirchhoff_stress_along_the_fibre():
    """Active tension gives P = T_a F f ⊗ f, a force T_a λ along a fibre stretched by λ."""
    I4 = FIBRE @ ANY.T @ ANY @ FIBRE
    assert value(contracting(variable(ANY))) == pytest.approx(30.0 * (I4 - 1), rel=1e-13)
    np.testing.assert_allclose(
        piola(contracting, ANY), 60.0 * np.outer(ANY @ FIBRE, FIBRE), rtol=1e-13, atol=1e-13
    )
    assert value(contracting(variable(ANY), tension=0.0)) == 0.0


# -- forms


@pytest.mark.serial
def test_code_of_all_forms_is_short(tmp_path):
    """The generated code of all forms is short, so that it compiles quickly."""
    body = wall(tube())
    for form in (body.F_u, body.F_p, body.J, ufl.derivative(body.F_u, body.p)):
        dolfinx.fem.form(form, jit_options={"cache_dir": tmp_path})
    code = {path.name: path.stat().st_size for path in tmp_path.rglob("*.c")}
    assert 0 < sum(code.values()) < 650_000, code


def test_limit_of_the_quadrature_degree():
    """The limit applies to integrals that state no degree, and derivatives inherit it."""
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
    u = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (3,))))
    dear = fibred(kin.deformation_gradient(u)) * ufl.dx
    cheap = ufl.inner(u, u) * ufl.dx
    assert limit_quadrature_degree(cheap) == cheap
    for degree, expected in ((None, 4), (5, 5), (0, 0)):
        limited = limit_quadrature_degree(dear, degree)
        residual = ufl.derivative(limited, u)
        for form in (limited, residual, ufl.derivative(residual, u)):
            assert [i.metadata() for i in form.integrals()] == [{"quadrature_degree": expected}]
    with pytest.raises(ValueError, match="degree = -1"):
        limit_quadrature_degree(dear, -1)
