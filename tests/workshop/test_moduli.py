# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Moduli at small strains against closed forms, and against slopes of response curves."""

from __future__ import annotations

import numpy as np
import pytest
from workshop_materials import (
    ANGLE,
    C01,
    C10,
    FIBRE,
    HGO,
    LMBDA,
    MU,
    C,
    fung,
    hgo,
    linear,
    material,
    mooney_rivlin,
    neo_hookean,
    reinforced,
    root,
    saint_venant,
    stressed,
    unsplit,
    wrong_sign,
)

from dolfinx_feti.workshop import respond, small_strain_moduli, uniaxial
from dolfinx_feti.workshop.directions import hemisphere, minimise, tangents

pytestmark = pytest.mark.serial


@pytest.mark.parametrize(
    ("psi", "shear"),
    [(neo_hookean, C), (unsplit, C), (mooney_rivlin, 2 * (C10 + C01)), (fung, C), (linear, MU)],
)
def test_incompressible_isotropic(psi, shear):
    moduli = small_strain_moduli(material(psi))
    assert moduli.isotropic and moduli.compliance is not None
    assert moduli.shear == pytest.approx(shear, rel=1e-12)
    assert moduli.least == pytest.approx(2 * shear, rel=1e-12)
    assert moduli.bulk == np.inf
    np.testing.assert_allclose(moduli.compliance.young, 3 * shear, rtol=1e-12)
    assert moduli.compliance.young_range == pytest.approx((3 * shear, 3 * shear))
    off_diagonal = moduli.compliance.poisson[~np.eye(3, dtype=bool)]
    np.testing.assert_allclose(off_diagonal, 0.5, rtol=1e-12)
    assert moduli.compliance.anisotropy == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(
    ("psi", "kappa", "bulk", "shear"),
    [
        (saint_venant, 0.0, LMBDA + 2 * MU / 3, MU),
        (linear, 0.0, LMBDA + 2 * MU / 3, MU),
        (saint_venant, 40.0, 40 + LMBDA + 2 * MU / 3, MU),
        (mooney_rivlin, 30.0, 30.0, 2 * (C10 + C01)),
    ],
)
def test_compressible_isotropic(psi, kappa, bulk, shear):
    moduli = small_strain_moduli(material(psi, kappa=kappa))
    assert moduli.isotropic and moduli.compliance is not None
    assert (moduli.bulk, moduli.shear) == pytest.approx((bulk, shear), rel=1e-12)
    young, poisson = 9 * bulk * shear / (3 * bulk + shear), 1.5 * bulk - shear
    assert moduli.compliance.young[1] == pytest.approx(young, rel=1e-12)
    assert moduli.compliance.poisson[0, 2] == pytest.approx(poisson / (3 * bulk + shear), rel=1e-12)
    lmbda = bulk - 2 * shear / 3
    stiffness = np.diag([2 * shear] * 3 + [shear] * 3)
    stiffness[:3, :3] += lmbda
    np.testing.assert_allclose(moduli.stiffness, stiffness, atol=1e-12 * bulk)


def test_fibres():
    """D = 2 c + Σ 4 k₁ M ⊗ M on strains without trace, M = a ⊗ a − I/3."""
    moduli = small_strain_moduli(material(hgo))
    projection = np.eye(6)[:, :3] @ (np.eye(3) - 1 / 3) @ np.eye(6)[:3]
    D = 2 * C * (projection + np.diag([0.0] * 3 + [0.5] * 3))
    for angle in (ANGLE, -ANGLE):
        c, s = np.cos(angle), np.sin(angle)
        M = np.array([c * c - 1 / 3, s * s - 1 / 3, -1 / 3, 0, 0, c * s])
        D += 4 * HGO["k1"] * np.outer(M, M)
    np.testing.assert_allclose(moduli.stiffness, D, atol=1e-12)
    assert not moduli.isotropic
    # a family adds 4 k₁ M : M = 8/3 k₁ to the trace 10 μ
    assert moduli.shear == pytest.approx(C + 2 * 8 / 3 * HGO["k1"] / 10, rel=1e-12)


def test_one_family_is_transversely_isotropic():
    """E = 3 c + 4 k along the fibre: Ψ = 3/2 c ε² + k/2 (2 ε)²; across, ν differs from ½."""
    moduli = small_strain_moduli(material(reinforced))
    assert moduli.compliance is not None
    young, poisson = moduli.compliance.young, moduli.compliance.poisson
    assert young[0] == pytest.approx(3 * C + 4 * FIBRE, rel=1e-12)
    assert young[1] == pytest.approx(young[2], rel=1e-12)
    assert poisson[0, 1] == pytest.approx(0.5) and poisson[0, 2] == pytest.approx(0.5)
    assert poisson[1, 0] + poisson[1, 2] == pytest.approx(1)  # no change of volume
    assert poisson[1, 0] == pytest.approx(0.5 * young[1] / young[0])
    least, most = moduli.compliance.young_range
    assert most == pytest.approx(young[0]) and least < young[1]
    assert moduli.compliance.anisotropy > 0.1


@pytest.mark.parametrize("kappa", [np.inf, 50.0])
def test_slopes_of_response_curves(kappa):
    """Young's modulus along x, y and z, and Poisson's ratios, in tension where all fibres work."""
    user = material(reinforced, kappa=kappa)
    compliance = small_strain_moduli(user).compliance
    assert compliance is not None
    h = 1e-5
    for i, e in enumerate(np.eye(3)):
        response = respond(user, uniaxial([1 - h, 1 + h], along=e))
        slope = np.diff(response.P[:, 0, 0])[0] / (2 * h)
        assert slope == pytest.approx(compliance.young[i], rel=1e-8)
        F = response.path.frame @ response.F @ response.path.frame.T
        contraction = -np.diff(F, axis=0)[0].diagonal() / (2 * h)
        others = np.arange(3) != i
        np.testing.assert_allclose(contraction[others], compliance.poisson[i, others], rtol=1e-8)


def test_range_of_young_is_that_of_all_directions():
    moduli = small_strain_moduli(material(hgo, kappa=20.0))
    assert moduli.compliance is not None
    weights = np.array([1.0, 1, 1, 2, 2, 2])
    S = np.linalg.inv(moduli.stiffness * weights)  # in engineering strains: ε = S σ
    x, y, z = np.random.default_rng(97).standard_normal((3, 20000))
    m = np.stack([x * x, y * y, z * z, y * z, x * z, x * y]) / (x * x + y * y + z * z)
    young = 1 / np.einsum("an,ab,bn->n", m * weights[:, None], S, m)
    least, most = moduli.compliance.young_range
    assert least <= young.min() * (1 + 1e-12) and young.min() < 1.001 * least
    assert most >= young.max() * (1 - 1e-12) and young.max() > 0.999 * most


def test_nothing_resists_a_change_of_volume():
    moduli = small_strain_moduli(material(neo_hookean, kappa=0.0))
    assert moduli.compliance is None
    assert moduli.bulk == pytest.approx(0, abs=1e-14)
    assert moduli.least == pytest.approx(0, abs=1e-14)
    assert "not positive definite" in str(moduli)


def test_wrong_sign():
    moduli = small_strain_moduli(material(wrong_sign))
    assert moduli.compliance is None and moduli.shear == pytest.approx(-C)


def test_stress_at_rest_is_no_stiffness():
    """The fibre of Ī₄ has no second derivative along itself; its stress does not count."""
    D = small_strain_moduli(material(stressed)).stiffness
    np.testing.assert_allclose(D, D.T, atol=1e-13)


def test_no_finite_tangent_at_rest():
    with pytest.raises(ValueError, match="no finite number at F = I"):
        small_strain_moduli(material(root))


@pytest.mark.parametrize(
    ("psi", "words"),
    [
        (neo_hookean, ("shear modulus 3 kPa, bulk modulus inf", "isotropic: Young's modulus 9")),
        (hgo, ("(Voigt's averages)", "anisotropic: universal index 0.6471", "16.49, 9.235")),
    ],
)
def test_text(psi, words):
    text = str(small_strain_moduli(material(psi)))
    assert all(word in text for word in words)


# -- directions --------------------------------------------------------------------------------


def test_directions_cover_the_hemisphere():
    n = hemisphere(400)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, rtol=1e-14)
    anywhere = np.random.default_rng(5).standard_normal((2000, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    assert np.abs(anywhere @ n.T).max(axis=1).min() > np.cos(np.radians(8))


def test_tangents_are_orthonormal():
    n = np.vstack((hemisphere(50), np.eye(3)))
    frames = np.concatenate((tangents(n), n[:, :, None]), axis=2)
    products = frames.transpose(0, 2, 1) @ frames
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), products.shape), atol=1e-14)


def test_minimum_on_the_sphere():
    """nᵀ M n is least at an eigenvector."""
    M = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.4], [0.1, -0.4, 3.0]])
    w, V = np.linalg.eigh(M)
    start = hemisphere()[np.argmin([n @ M @ n for n in hemisphere()])]
    value, n = minimise(lambda n: float(n @ M @ n), start)
    assert value == pytest.approx(w[0], rel=1e-10)
    assert abs(n @ V[:, 0]) == pytest.approx(1, abs=1e-9)
