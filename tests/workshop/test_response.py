# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Stresses along paths and moduli at small strains agree with closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import workshop_materials as energies
from cases import each
from scipy.optimize import brentq
from workshop_materials import ANGLE, C01, C10, FIBRE, HGO, LMBDA, MU, C, material, rotation

from dolfinx_feti.workshop import (
    biaxial,
    equibiaxial,
    inflation,
    pure_shear,
    respond,
    simple_shear,
    small_strain_moduli,
    uniaxial,
)
from dolfinx_feti.workshop.equilibrium import equilibrate
from dolfinx_feti.workshop.paths import STANDARD_PATHS

pytestmark = pytest.mark.serial

STRETCH = np.linspace(0.5, 2.0, 13)
SHEAR = np.linspace(-1.5, 1.5, 9)
exact = {"rtol": 1e-11, "atol": 1e-11}

# Cauchy stress of c₁₀ (I₁ − 3) + c₀₁ (I₂ − 3), incompressible, with the third direction free: σ₁₁
# in the first three (Treloar, The Physics of Rubber Elasticity).
RUBBER = {
    "uniaxial": (uniaxial, lambda x, c10, c01: 2 * (x**2 - 1 / x) * (c10 + c01 / x)),
    "equibiaxial": (equibiaxial, lambda x, c10, c01: 2 * (x**2 - x**-4) * (c10 + c01 * x**2)),
    "pure shear": (pure_shear, lambda x, c10, c01: 2 * (x**2 - x**-2) * (c10 + c01)),
}


@each(("make", "stress"), RUBBER)
def test_incompressible_rubber(make, stress):
    """Incompressible rubber has its closed-form stresses on each path."""
    neo_hookean = ((psi, C / 2, 0) for psi in (energies.neo_hookean, energies.unsplit))
    for psi, c10, c01 in (*neo_hookean, (energies.mooney_rivlin, C10, C01)):
        response = respond(material(psi), make(STRETCH))
        np.testing.assert_array_equal(response.converged, True)
        np.testing.assert_allclose(response.sigma[:, 0, 0], stress(STRETCH, c10, c01), **exact)
        np.testing.assert_allclose(response.P[:, 0, 0] * STRETCH, response.sigma[:, 0, 0], **exact)
        np.testing.assert_allclose(response.J, 1, rtol=1e-13)


def test_simple_shear_of_rubber():
    """σ₁₂ = 2 (c₁₀ + c₀₁) γ; σ₁₁ = 2 c₁₀ γ² and σ₂₂ = −2 c₀₁ γ² if σ₃₃ = 0."""
    sigma = respond(material(energies.mooney_rivlin), simple_shear(SHEAR)).sigma
    np.testing.assert_allclose(sigma[:, 0, 1], 2 * (C10 + C01) * SHEAR, **exact)
    np.testing.assert_allclose(sigma[:, 0, 0], 2 * C10 * SHEAR**2, **exact)
    np.testing.assert_allclose(sigma[:, 1, 1], -2 * C01 * SHEAR**2, **exact)
    np.testing.assert_allclose(sigma[:, 2], 0, atol=1e-11)


def wall_stresses(stretch, second):
    """Return σ₁₁ and σ₂₂ of the HGO energy for F = diag(λ, λ₂, 1/(λ λ₂)), σ₃₃ = 0, by hand."""
    cosine2 = np.cos(ANGLE) ** 2
    third2 = (stretch * second) ** -2.0
    E = np.maximum(stretch**2 * cosine2 + second**2 * (1 - cosine2) - 1, 0)
    fibres = 4 * HGO["k1"] * E * np.exp(HGO["k2"] * E**2)
    first = HGO["c"] * (stretch**2 - third2) + fibres * stretch**2 * cosine2
    return first, HGO["c"] * (second**2 - third2) + fibres * second**2 * (1 - cosine2)


@pytest.mark.parametrize("second", [1.0, 1.2])
def test_biaxial_tension_of_a_wall_with_fibres(second):
    """A wall in biaxial tension has the stresses derived on paper."""
    stretch = np.linspace(0.7, 1.6, 10)
    for path in (biaxial(stretch, second), inflation(stretch, axial=second)):
        sigma = respond(material(energies.hgo), path).sigma
        by_hand = wall_stresses(stretch, second)
        np.testing.assert_allclose(sigma[:, 0, 0], by_hand[0], **exact)
        np.testing.assert_allclose(sigma[:, 1, 1], by_hand[1], **exact)


def test_uniaxial_tension_of_a_wall_with_fibres():
    """In uniaxial tension the second stretch of a wall makes σ₂₂ vanish."""
    stretch = np.linspace(1.05, 1.6, 8)
    lateral = np.vectorize(lambda x: brentq(lambda y: wall_stresses(x, y)[1], 0.2, 1.0, xtol=1e-14))
    second = lateral(stretch)
    response = respond(material(energies.hgo), uniaxial(stretch))
    np.testing.assert_allclose(response.F[:, 1, 1], second, rtol=1e-12)
    np.testing.assert_allclose(response.sigma[:, 0, 0], wall_stresses(stretch, second)[0], **exact)
    assert abs(response.F[-1, 1, 1] - stretch[-1] ** -0.5) > 0.1


def test_compressible_bar():
    """A St Venant–Kirchhoff bar has S₁₁ = E E₁₁ and E₂₂ = −ν E₁₁."""
    young = MU * (3 * LMBDA + 2 * MU) / (LMBDA + MU)
    poisson = LMBDA / 2 / (LMBDA + MU)
    stretch = np.linspace(0.7, 1.3, 7)
    strain = (stretch**2 - 1) / 2
    response = respond(material(energies.saint_venant, kappa=0.0), uniaxial(stretch))
    np.testing.assert_allclose(response.P[:, 0, 0], stretch * young * strain, **exact)
    lateral = np.sqrt(1 - 2 * poisson * strain)
    np.testing.assert_allclose(response.F[:, 2, 2], lateral, rtol=1e-12)
    np.testing.assert_allclose(response.J, stretch * lateral**2, rtol=1e-12)
    np.testing.assert_array_equal(response.p, 0)


@pytest.mark.parametrize("psi", [energies.neo_hookean, energies.hgo])
def test_large_kappa_tends_to_incompressible(psi):
    """Responses converge to the incompressible ones at first order in 1/κ."""
    path = uniaxial(np.linspace(0.8, 1.4, 5))
    limit = respond(material(psi), path)
    soft, stiff = (respond(material(psi, kappa=kappa), path) for kappa in (1e4, 1e5))
    errors = [np.abs(each.sigma - limit.sigma).max() for each in (soft, stiff)]
    assert 9 < errors[0] / errors[1] < 11
    np.testing.assert_allclose(1e5 * (stiff.J - 1), limit.p, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("kappa", [np.inf, 20.0])
def test_oblique_fibres_let_a_specimen_shear(kappa):
    """In uniaxial tension σ₁₁ is the only stress, although oblique fibres cause shear."""
    response = respond(material(energies.oblique, kappa=kappa), uniaxial([0.8, 1.2, 1.5]))
    others = response.sigma.copy()
    others[:, 0, 0] = 0
    np.testing.assert_allclose(others, 0, atol=1e-10)
    assert np.abs(response.F[2, 0, 1]) > 0.05
    held = respond(material(energies.oblique, kappa=kappa), equibiaxial([1.2, 1.5]))
    np.testing.assert_array_equal(held.F[:, 0, 1], 0)
    assert np.abs(held.sigma[:, 0, 1]).min() > 0.1
    np.testing.assert_allclose(held.sigma[:, 2], 0, atol=1e-10)


ALONG = (np.cos(ANGLE), np.sin(ANGLE), 0)
ACROSS = (-2 * np.sin(ANGLE), 2 * np.cos(ANGLE), 0)


def fibre_stress(E):
    """Return 4 k₁ E exp(k₂ E²), of two families in one direction."""
    return 4 * HGO["k1"] * E * np.exp(HGO["k2"] * E**2)


def test_loading_along_an_oblique_fibre():
    """Tension along an oblique fibre causes no shear, and has the response of a fibre along x."""
    stretch = np.array([1.1, 1.4])
    response = respond(material(energies.oblique), uniaxial(stretch, along=ALONG))
    stress = C * (stretch**2 - 1 / stretch) + fibre_stress(stretch**2 - 1) * stretch**2
    np.testing.assert_allclose(response.sigma[:, 0, 0], stress, **exact)
    lateral = np.diag([0, 1, 1]) * stretch[:, None, None] ** -0.5
    np.testing.assert_allclose(response.F[:, 1:], lateral[:, 1:], atol=1e-11)
    wide = respond(material(energies.oblique), pure_shear(stretch, along=ALONG, across=ACROSS))
    stress = C * (stretch**2 - stretch**-2) + fibre_stress(stretch**2 - 1) * stretch**2
    np.testing.assert_allclose(wide.sigma[:, 0, 0], stress, **exact)


def test_shear_along_and_across_an_oblique_fibre():
    """Shear along a fibre keeps its length; across it, Ī₄ = 1 + γ² and F a = (γ, 1)."""
    along = respond(material(energies.oblique), simple_shear(SHEAR, along=ALONG, across=ACROSS))
    np.testing.assert_allclose(along.sigma[:, 0, 1], C * SHEAR, **exact)
    across = respond(material(energies.oblique), simple_shear(SHEAR, along=ACROSS, across=ALONG))
    stress = C * SHEAR + fibre_stress(SHEAR**2) * SHEAR
    np.testing.assert_allclose(across.sigma[:, 0, 1], stress, **exact)


@pytest.mark.parametrize("along", [(1, 0, 0), (0, 0, -3), (1, 2, 3)])
def test_frame_of_loading(along):
    """The frame of a path is a rotation to its direction, with orthonormal free entries."""
    path = uniaxial([1.3], along=along)
    R = path.frame
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1)
    np.testing.assert_allclose(R[:, 0] * np.linalg.norm(along), along, atol=1e-14)
    free = path.free.reshape(-1, 9)
    np.testing.assert_allclose(free @ free.T, np.eye(5), atol=1e-14)


def test_every_path_passes_through_rest():
    """Every path contains the state of rest."""
    for symbol, makers in STANDARD_PATHS.items():
        for make in makers:
            path = make([1.0 if symbol == "λ" else 0.0])
            if path.name != "inflation–extension":
                np.testing.assert_array_equal(path.F, [np.eye(3)])
            assert path.symbol == symbol


# -- states without equilibrium ----------------------------------------------------------------


def test_collapse_is_no_equilibrium():
    """The collapsed state F₃₃ = 0 of a St Venant–Kirchhoff solid is not an equilibrium.

    S₃₃ = 0 makes F₃₃² = 1 − 2 λ/(λ + 2 μ) (λ₁² − 1), zero at λ₁² = 1.9. Beyond, F₃₃ = 0 is a
    stationary point.
    """
    response = respond(material(energies.saint_venant, kappa=0.0), equibiaxial([1.0, 1.37, 1.6]))
    np.testing.assert_array_equal(response.converged, [True, True, False])
    assert response.F[1, 2, 2] ** 2 == pytest.approx(1 - 10 / 9 * (1.37**2 - 1), rel=1e-10)
    np.testing.assert_array_equal(response.sigma[2], np.nan)
    np.testing.assert_array_equal(response.psi[2], np.nan)


def test_states_that_are_no_numbers():
    """States with an energy of NaN are marked as not converged."""
    response = respond(material(energies.not_a_number), pure_shear([1.0, 1.1, 1.2]))
    np.testing.assert_array_equal(response.converged, [True, True, False])


def test_far_states_are_reached_in_steps(monkeypatch):
    """A state out of Newton's reach is found by steps from the last one."""
    import dolfinx_feti.workshop.equilibrium as module

    path = uniaxial([2.2])
    np.testing.assert_array_equal(respond(material(energies.hgo), path).converged, True)
    monkeypatch.setattr(module, "LOAD_STEPS", (1,))
    monkeypatch.setattr(module, "MAX_STEPS", 8)
    np.testing.assert_array_equal(respond(material(energies.hgo), path).converged, False)


# -- tables and bad input ----------------------------------------------------------------------


def test_path_without_free_entries_leaves_the_pressure_open():
    """A path without free entries needs a κ, as the pressure is undetermined."""
    nothing = np.empty((0, 3, 3))
    with pytest.raises(ValueError, match="no free entries"):
        equilibrate(material(energies.neo_hookean), np.eye(3)[None], nothing)
    Q = rotation(3)
    found, _ = equilibrate(material(energies.neo_hookean, kappa=10.0), Q[None], nothing)
    np.testing.assert_allclose(found, [Q], rtol=1e-14)


# -- moduli at small strains


@pytest.mark.parametrize(
    ("psi", "kappa", "bulk", "shear"),
    [
        (energies.neo_hookean, np.inf, np.inf, C),
        (energies.unsplit, np.inf, np.inf, C),
        (energies.mooney_rivlin, np.inf, np.inf, 2 * (C10 + C01)),
        (energies.fung, np.inf, np.inf, C),
        (energies.linear, np.inf, np.inf, MU),
        (energies.saint_venant, 0.0, LMBDA + 2 * MU / 3, MU),
        (energies.linear, 0.0, LMBDA + 2 * MU / 3, MU),
        (energies.saint_venant, 40.0, 40 + LMBDA + 2 * MU / 3, MU),
        (energies.mooney_rivlin, 30.0, 30.0, 2 * (C10 + C01)),
    ],
)
def test_isotropic_moduli(psi, kappa, bulk, shear):
    """Isotropic solids have E = 9 K μ/(3 K + μ) and ν = (3 K − 2 μ)/(6 K + 2 μ)."""
    moduli = small_strain_moduli(material(psi, kappa=kappa))
    assert (moduli.bulk, moduli.shear) == pytest.approx((bulk, shear), rel=1e-12)
    assert moduli.least == pytest.approx(2 * shear, rel=1e-12)
    share = shear / bulk
    np.testing.assert_allclose(moduli.young, 9 * shear / (3 + share), rtol=1e-12)
    off_diagonal = moduli.poisson[~np.eye(3, dtype=bool)]
    np.testing.assert_allclose(off_diagonal, (3 - 2 * share) / (6 + 2 * share), rtol=1e-11)
    stiffness = np.diag([2 * shear] * 3 + [shear] * 3)
    stiffness[:3, :3] += (0.0 if np.isinf(bulk) else bulk) - 2 * shear / 3
    np.testing.assert_allclose(moduli.stiffness, stiffness, atol=1e-11)


def test_moduli_of_fibres():
    """The stiffness of two fibre families is 2 c + Σ 4 k₁ M ⊗ M without trace, M = a ⊗ a − I/3."""
    moduli = small_strain_moduli(material(energies.hgo))
    projection = np.eye(6)[:, :3] @ (np.eye(3) - 1 / 3) @ np.eye(6)[:3]
    D = 2 * C * (projection + np.diag([0.0] * 3 + [0.5] * 3))
    for angle in (ANGLE, -ANGLE):
        c = np.cos(angle)
        s = np.sin(angle)
        M = np.array([c * c - 1 / 3, s * s - 1 / 3, -1 / 3, 0, 0, c * s])
        D += 4 * HGO["k1"] * np.outer(M, M)
    np.testing.assert_allclose(moduli.stiffness, D, atol=1e-12)
    # a family adds 4 k₁ M : M = 8/3 k₁ to the trace 10 μ
    assert moduli.shear == pytest.approx(C + 2 * 8 / 3 * HGO["k1"] / 10, rel=1e-12)


def test_one_family_is_transversely_isotropic():
    """One fibre family has E = 3 c + 4 k along it, and ν other than ½ across."""
    moduli = small_strain_moduli(material(energies.reinforced))
    young = moduli.young
    poisson = moduli.poisson
    assert young[0] == pytest.approx(3 * C + 4 * FIBRE, rel=1e-12)
    assert young[1] == pytest.approx(young[2], rel=1e-12)
    assert poisson[0, 1] == pytest.approx(0.5) and poisson[0, 2] == pytest.approx(0.5)
    assert poisson[1, 0] + poisson[1, 2] == pytest.approx(1)  # no change of volume
    assert poisson[1, 0] == pytest.approx(0.5 * young[1] / young[0])


@pytest.mark.parametrize("kappa", [np.inf, 50.0])
def test_slopes_of_response_curves(kappa):
    """Moduli and Poisson's ratios are the slopes of response curves in tension."""
    user = material(energies.reinforced, kappa=kappa)
    moduli = small_strain_moduli(user)
    h = 1e-5
    for i, e in enumerate(np.eye(3)):
        response = respond(user, uniaxial([1 - h, 1 + h], along=e))
        slope = np.diff(response.P[:, 0, 0])[0] / (2 * h)
        assert slope == pytest.approx(moduli.young[i], rel=1e-8)
        F = response.path.frame @ response.F @ response.path.frame.T
        contraction = -np.diff(F, axis=0)[0].diagonal() / (2 * h)
        others = np.arange(3) != i
        np.testing.assert_allclose(contraction[others], moduli.poisson[i, others], rtol=1e-8)


def test_nothing_resists_a_change_of_volume():
    """Without volumetric stiffness E and ν are NaN, and the text says not positive definite."""
    moduli = small_strain_moduli(material(energies.neo_hookean, kappa=0.0))
    np.testing.assert_array_equal(moduli.young, np.nan)
    np.testing.assert_array_equal(moduli.poisson, np.nan)
    assert moduli.bulk == pytest.approx(0, abs=1e-14)
    assert moduli.least == pytest.approx(0, abs=1e-14)
    assert "not positive definite" in str(moduli)


def test_stress_at_rest_is_no_stiffness():
    """A stress at rest does not contribute to the stiffness."""
    D = small_strain_moduli(material(energies.stressed)).stiffness
    np.testing.assert_allclose(D, D.T, atol=1e-13)


def test_no_finite_tangent_at_rest():
    """An infinite tangent at rest is refused."""
    with pytest.raises(ValueError, match="no finite number at F = I"):
        small_strain_moduli(material(energies.root))


def test_text_of_moduli():
    """The text of moduli states them by name."""
    text = str(small_strain_moduli(material(energies.neo_hookean)))
    for words in ("shear modulus 3 kPa, bulk modulus inf", "moduli 9, 9, 9 kPa", "0.5, 0.5"):
        assert words in text
    assert "moduli 16.49, 9.235" in str(small_strain_moduli(material(energies.hgo)))
