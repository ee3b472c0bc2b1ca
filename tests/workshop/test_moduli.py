# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Moduli at small strains against closed forms, and against slopes of response curves."""

from __future__ import annotations

import numpy as np
import pytest
import workshop_materials as energies
from workshop_materials import ANGLE, C01, C10, FIBRE, HGO, LMBDA, MU, C, material

from dolfinx_feti.workshop import respond, small_strain_moduli, uniaxial

pytestmark = pytest.mark.serial


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
def test_isotropic(psi, kappa, bulk, shear):
    """E = 9 K μ/(3 K + μ) and ν = (3 K − 2 μ)/(6 K + 2 μ)."""
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


def test_fibres():
    """D = 2 c + Σ 4 k₁ M ⊗ M on strains without trace, M = a ⊗ a − I/3."""
    moduli = small_strain_moduli(material(energies.hgo))
    projection = np.eye(6)[:, :3] @ (np.eye(3) - 1 / 3) @ np.eye(6)[:3]
    D = 2 * C * (projection + np.diag([0.0] * 3 + [0.5] * 3))
    for angle in (ANGLE, -ANGLE):
        c, s = np.cos(angle), np.sin(angle)
        M = np.array([c * c - 1 / 3, s * s - 1 / 3, -1 / 3, 0, 0, c * s])
        D += 4 * HGO["k1"] * np.outer(M, M)
    np.testing.assert_allclose(moduli.stiffness, D, atol=1e-12)
    # a family adds 4 k₁ M : M = 8/3 k₁ to the trace 10 μ
    assert moduli.shear == pytest.approx(C + 2 * 8 / 3 * HGO["k1"] / 10, rel=1e-12)


def test_one_family_is_transversely_isotropic():
    """E = 3 c + 4 k along the fibre: Ψ = 3/2 c ε² + k/2 (2 ε)²; across, ν differs from ½."""
    moduli = small_strain_moduli(material(energies.reinforced))
    young, poisson = moduli.young, moduli.poisson
    assert young[0] == pytest.approx(3 * C + 4 * FIBRE, rel=1e-12)
    assert young[1] == pytest.approx(young[2], rel=1e-12)
    assert poisson[0, 1] == pytest.approx(0.5) and poisson[0, 2] == pytest.approx(0.5)
    assert poisson[1, 0] + poisson[1, 2] == pytest.approx(1)  # no change of volume
    assert poisson[1, 0] == pytest.approx(0.5 * young[1] / young[0])


@pytest.mark.parametrize("kappa", [np.inf, 50.0])
def test_slopes_of_response_curves(kappa):
    """Young's modulus along x, y and z, and Poisson's ratios, in tension where all fibres work."""
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
    moduli = small_strain_moduli(material(energies.neo_hookean, kappa=0.0))
    assert np.isnan(moduli.young).all() and np.isnan(moduli.poisson).all()
    assert moduli.bulk == pytest.approx(0, abs=1e-14)
    assert moduli.least == pytest.approx(0, abs=1e-14)
    assert "not positive definite" in str(moduli)


def test_wrong_sign():
    moduli = small_strain_moduli(material(energies.wrong_sign))
    assert np.isnan(moduli.young).all() and moduli.shear == pytest.approx(-C)


def test_stress_at_rest_is_no_stiffness():
    """The fibre of Ī₄ has no second derivative along itself; its stress does not count."""
    D = small_strain_moduli(material(energies.stressed)).stiffness
    np.testing.assert_allclose(D, D.T, atol=1e-13)


def test_no_finite_tangent_at_rest():
    with pytest.raises(ValueError, match="no finite number at F = I"):
        small_strain_moduli(material(energies.root))


@pytest.mark.parametrize(
    ("psi", "words"),
    [
        (
            energies.neo_hookean,
            ("shear modulus 3 kPa, bulk modulus inf", "moduli 9, 9, 9 kPa", "0.5, 0.5"),
        ),
        (energies.hgo, ("Young's moduli 16.49, 9.235",)),
    ],
)
def test_text(psi, words):
    text = str(small_strain_moduli(material(psi)))
    assert all(word in text for word in words)
