# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Loss of ellipticity against closed forms and brute force."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import workshop_materials as energies
from workshop_materials import FIBRE, C, material, rotation

from dolfinx_feti.workshop import (
    equibiaxial,
    evaluate,
    inflation,
    least_eigenvalues,
    pure_shear,
    scan_ellipticity,
    simple_shear,
    uniaxial,
)

pytestmark = pytest.mark.serial

KINK = np.sqrt(1 - C / (2 * FIBRE))


def spatial(F, A):
    """𝒜_ijkl = J⁻¹ A_iJkL F_jJ F_lL, by loops."""
    return np.einsum("iJkL,jJ,lL->ijkl", A, F, F) / np.linalg.det(F)


def brute_force(F, A, incompressible, n=200_000, seed=4099):
    """Least m · Q(n) m over many random pairs of unit vectors."""
    rng = np.random.default_rng(seed)
    normals, m = rng.standard_normal((2, n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    if incompressible:
        m -= np.sum(m * normals, axis=1, keepdims=True) * normals
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    tensor = spatial(F, A).transpose(0, 2, 1, 3).reshape(9, 9)
    mm = (m[:, :, None] * m[:, None]).reshape(n, 9)
    nn = (normals[:, :, None] * normals[:, None]).reshape(n, 9)
    return np.einsum("na,ab,nb->n", mm, tensor, nn, optimize=True).min()


@pytest.mark.parametrize("make", [uniaxial, equibiaxial, pure_shear, inflation])
def test_neo_hookean_is_elliptic_everywhere(make):
    """There m · Q(n) m = c |Fᵀ n|² for m ⟂ n, at least c times the smallest squared stretch."""
    scan = scan_ellipticity(material(energies.neo_hookean), make, np.linspace(0.5, 2.0, 7))
    stretches = np.linalg.svd(scan.path.F, compute_uv=False)
    np.testing.assert_allclose(scan.least, C * stretches[:, -1] ** 2, rtol=1e-7)
    assert scan.lost == ()


@pytest.mark.parametrize("make", [uniaxial, equibiaxial, pure_shear, partial(inflation, axial=1.2)])
def test_fibres_kink_in_compression(make):
    """Standard reinforcing model: n and m ⟂ n along and across the fibre, λ² (c + 2 k (λ² − 1)).

    So ellipticity is lost where the fibre is as short as λ² = 1 − c/(2 k), whatever the rest.
    """
    scan = scan_ellipticity(material(energies.reinforced), make, np.linspace(0.6, 1.4, 9))
    assert scan.lost == pytest.approx((KINK,), abs=1e-7)
    shortest = scan.path.values[0]
    assert scan.least[0] == pytest.approx(shortest**2 * (C + 2 * FIBRE * (shortest**2 - 1)))
    at = evaluate(material(energies.reinforced), scan.path.F[:1])  # the free entries are not its
    _, normal = least_eigenvalues(at.F, at.A, incompressible=True)
    np.testing.assert_allclose(np.abs(normal[0]), [1, 0, 0], atol=1e-5)


def test_fibres_that_do_not_push_do_not_kink():
    scan = scan_ellipticity(material(energies.hgo), uniaxial, np.linspace(0.6, 1.4, 9))
    assert scan.lost == () and (scan.least > 0).all()


def test_both_sides_are_searched():
    """The reinforcing fibres shorten in simple shear of either sign across them."""
    turned = partial(simple_shear, along=(0, 1, 1), across=(0, -1, 1))
    scan = scan_ellipticity(material(energies.reinforced), turned, np.linspace(-0.5, 0.5, 5))
    assert scan.lost == () and scan.rest == 0
    upward = scan_ellipticity(
        material(energies.reinforced),
        partial(equibiaxial, along=(0, 1, 0), across=(0, 0, 1)),
        [1.0, 1.1, 1.3],
    )
    assert upward.lost == pytest.approx((KINK**-0.5,), abs=1e-7)  # F₁₁ = λ⁻²


def bar(stretch):
    """Uniaxial strain: nothing is free."""
    path = uniaxial(stretch)
    F = np.tile(np.eye(3), (len(path.values), 1, 1))
    F[:, 0, 0] = path.values
    return replace(path, F=F, free=np.empty((0, 3, 3)))


def test_uniaxial_strain_of_saint_venant_kirchhoff():
    """With λ = 0 ellipticity is lost at λ₁ = 2 − √2, at an oblique n = (c, s).

    With y = λ₁², det Q/μ² = y (3 y − 1) c⁴ + [2 (3 y − 1) + y² − y] c² s² + 2 y s⁴, whose
    discriminant in c² and s² vanishes at y = 6 − 4 √2. Longitudinal waves stop at y = 1/3 only.
    """
    y = 6 - 4 * np.sqrt(2)
    discriminant = (2 * (3 * y - 1) + y**2 - y) ** 2 - 8 * y**2 * (3 * y - 1)
    assert discriminant == pytest.approx(0, abs=1e-14)
    scan = scan_ellipticity(material(energies.no_lambda, kappa=0.0), bar, np.linspace(0.5, 1.2, 8))
    assert scan.lost == pytest.approx((2 - np.sqrt(2),), abs=1e-7)


SHEARED, COMPRESSED = (0.75, 1.4, 1 / (0.75 * 1.4)), (0.6, 1.0, 1.0)
ELLIPTIC = [energies.mooney_rivlin, energies.hgo, energies.goh, energies.reinforced]


@pytest.mark.parametrize(
    ("psi", "kappa", "stretches"),
    [
        *((psi, kappa, SHEARED) for psi in ELLIPTIC for kappa in (np.inf, 30.0)),
        (energies.saint_venant, 0.0, COMPRESSED),
    ],
)
def test_least_eigenvalue_is_the_least_of_all(psi, kappa, stretches):
    """Also a negative one, with n and m neither along nor across the axis of compression."""
    user = material(psi, kappa=kappa)
    F = rotation(23) @ np.diag(stretches) @ rotation(29)
    at = evaluate(user, F)
    incompressible = user.incompressible
    (least,), (n,) = least_eigenvalues(at.F, at.A, incompressible=incompressible)
    A = spatial(F, at.A[0])
    Q = np.einsum("ijkl,j,l->ik", A, n, n)
    normal_part = np.outer(n, n) * 1e9 if incompressible else 0.0  # leaves m ⟂ n
    assert np.linalg.eigvalsh(Q + normal_part)[0] == pytest.approx(least, rel=1e-6)
    assert np.linalg.norm(n) == pytest.approx(1)
    found = brute_force(F, at.A[0], incompressible)
    assert least <= found + 1e-12 and found - least < 0.02 * np.abs(A).max()
    assert least < 0 or stretches is not COMPRESSED


def test_pressure_does_not_count_if_incompressible():
    """A finite κ adds κ J (m · n)², nothing for m ⟂ n."""
    F = np.diag([0.8, 1.25, 1.0])
    bare, stiff = (evaluate(material(energies.hgo, kappa=kappa), F) for kappa in (0.0, 500.0))
    values = [least_eigenvalues(s.F, s.A, incompressible=True)[0] for s in (bare, stiff)]
    assert values[0] == pytest.approx(values[1], rel=1e-8)


def test_loss_at_rest():
    scan = scan_ellipticity(material(energies.wrong_sign), uniaxial, [0.9, 1.0, 1.1])
    assert scan.lost == (1.0,) and scan.rest == 1.0


def test_states_without_equilibrium():
    scan = scan_ellipticity(material(energies.not_a_number), pure_shear, [0.9, 1.0, 1.1, 1.2, 1.3])
    np.testing.assert_array_equal(np.isnan(scan.least), [False, False, False, True, True])


@pytest.mark.parametrize("values", [[1.1, 1.0], [1.0, 1.0]])
def test_values_in_another_order(values):
    with pytest.raises(ValueError, match="ascending order"):
        scan_ellipticity(material(energies.neo_hookean), uniaxial, values)
