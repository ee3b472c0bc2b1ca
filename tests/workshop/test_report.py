# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Good materials pass all checks, and each broken one fails the check made for it."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import workshop_materials as energies
from workshop_materials import (
    FIBRE,
    C,
    fung,
    goh,
    hgo,
    holzapfel_ogden,
    material,
    oblique,
    rotation,
)

import ufl

from dolfinx_feti.workshop import (
    check,
    equibiaxial,
    evaluate,
    inflation,
    least_eigenvalues,
    pure_shear,
    scan_ellipticity,
    simple_shear,
    uniaxial,
)
from dolfinx_feti.workshop.checks import check_law, compare_with_bound, random_states
from dolfinx_feti.workshop.ellipticity import _first_loss

pytestmark = pytest.mark.serial

KINK = "tangent continuous at rest"
ELLIPTIC = "strongly elliptic, "
DIFFERENCES = {"stress against differences", "tangent against differences"}


def outcomes(checks, *kinds):
    return {c.name for c in checks if c.outcome in kinds}


@pytest.mark.parametrize("kappa", [np.inf, 1000.0])
@pytest.mark.parametrize(
    "psi", [hgo, goh, oblique, holzapfel_ogden, fung, energies.neo_hookean, energies.mooney_rivlin]
)
def test_good_materials_pass(psi, kappa):
    """Good materials pass, with at most a warning of the kink of fibres without compression."""
    report = check(material(psi, kappa=kappa), n=9)
    assert report.ok
    fibres = psi in (hgo, goh, oblique, holzapfel_ogden)
    assert outcomes(report.checks, "warn", "fail") == ({KINK} if fibres else set())
    assert report.moduli is not None and len(report.ellipticity) == 5


def test_large_kappa_hides_nothing():
    """Checks scale with Ψ itself, so that a large κ does not hide its errors."""
    soft, stiff = (check(material(hgo, kappa=kappa), n=5).checks for kappa in (10.0, 1e5))
    assert [c.value for c in soft[:11]] == [c.value for c in stiff[:11]]
    assert "elliptic" in soft[-1].name and soft[-1].value != stiff[-1].value


KINKS = ("uniaxial", "equibiaxial", "pure shear", "inflation–extension")


@pytest.mark.parametrize(
    ("psi", "kappa", "lost"),
    [
        (energies.saint_venant, 0.0, {"equibiaxial": "lost", "pure shear": "lost"}),
        (energies.guccione, np.inf, {"equibiaxial": "λ = 0.8165", "simple shear": "γ = -0.7174"}),
        (energies.reinforced, np.inf, dict.fromkeys(KINKS, "λ = 0.7906")),
    ],
)
def test_loss_of_ellipticity_is_a_warning_with_the_stretch(psi, kappa, lost):
    """A loss of ellipticity is a warning that states the stretch."""
    report = check(material(psi, kappa=kappa), n=9)
    assert report.ok
    notes = {c.name: c.note for c in report.checks if c.outcome == "warn"}
    assert notes.keys() == {f"{ELLIPTIC}{path}" for path in lost}
    for path, where in lost.items():
        assert re.search(f"lost at .*{where}|{where} at", notes[f"{ELLIPTIC}{path}"])


@pytest.mark.parametrize(
    ("psi", "failures"),
    [
        (
            energies.linear,
            {f"frame indifference of the {it}" for it in ("energy", "stress")}
            | {"symmetry of the stress"},
        ),
        (energies.stressed, {"stress-free reference"}),
        (energies.contracting, {"stress-free reference"}),
        (energies.wavy, DIFFERENCES),
    ],
)
def test_broken_energy_fails_its_check(psi, failures):
    """Each broken energy fails exactly the checks made for it, ellipticity aside."""
    report = check(material(psi), n=5)
    assert not report.ok
    found = outcomes(report.checks, "fail")
    assert {name for name in found if "elliptic" not in name} == failures


def test_wrong_sign_fails():
    """An energy of the wrong sign fails stiffness and ellipticity, and has no Young's modulus."""
    report = check(material(energies.wrong_sign), n=5)
    assert outcomes(report.checks, "fail") >= {"stiffness at rest positive", f"{ELLIPTIC}uniaxial"}
    assert "least energy at the reference" in outcomes(report.checks, "warn")
    np.testing.assert_array_equal(report.moduli.young, np.nan)
    assert report.moduli.shear == pytest.approx(-C)


def test_nothing_resists_a_change_of_volume():
    """An energy that resists no change of volume fails its check."""
    report = check(material(energies.neo_hookean, kappa=0.0), n=5)
    (found,) = (c for c in report.checks if c.name == "stiffness at rest positive")
    assert found.outcome == "warn" and "kappa" in found.note


def test_no_stiffness_at_rest():
    """An energy without stiffness at rest, (Ī₁ − 3)², is reported without a division by zero."""
    report = check(material(energies.flat), n=5)
    assert "stiffness at rest positive" in outcomes(report.checks, "warn")
    failed = outcomes(report.checks, "fail")
    assert failed == {name for name in failed if "elliptic" in name} != set()
    assert report.moduli is not None
    np.testing.assert_array_equal(report.moduli.young, np.nan)


def test_nan_is_reported_with_its_state():
    """The report names the states whose energy is NaN, here C₁₁ > 1.3."""
    report = check(material(energies.not_a_number), n=11)
    checks = {c.name: c for c in report.checks}
    finite = checks["finite values"]
    along = checks["finite values along the paths"]
    assert finite.outcome == "fail"
    assert finite.value is not None and finite.value > 0
    said = f"Ψ, P, A at {finite.value:.0f} of 32 states, the first at F = [["
    assert finite.note.startswith(said)
    assert (along.outcome, along.value) == ("fail", 5 * 4)
    assert along.note.startswith("the first at λ = 1.2 of uniaxial, F = [[1.2, 0, 0]")
    note = checks[f"{ELLIPTIC}uniaxial"].note
    assert "no equilibrium at 5 states, the nearest at λ = 1.2" in note
    assert checks["frame indifference of the stress"].outcome == "pass"  # at the other states


def test_nan_at_rest():
    """An energy that is NaN at rest fails, and has no moduli and no scan of ellipticity."""
    report = check(material(energies.root), n=5)
    assert report.moduli is None and report.ellipticity == ()
    failed = {c.name: c.note for c in report.checks if c.outcome == "fail"}
    assert failed["stress-free reference"].startswith("NaN: psi or a derivative")
    assert "λ = 1 of uniaxial" in failed["finite values along the paths"]
    assert "no moduli" in str(report)


# -- laws that no energy can have --------------------------------------------------------------


def tampered(change):
    """Return states of a good material with a change of P or A."""

    def law(F):
        at = evaluate(material(energies.neo_hookean), F)
        return replace(at, **change(at))

    return law


def lopsided(at):
    """Return a change that removes the major symmetry of the tangent."""
    A = at.A.copy()
    A[:, 0, 0, 1, 1] *= 1.01
    return {"A": A}


@pytest.mark.parametrize(
    ("change", "failures"),
    [
        (lambda at: {}, set()),
        (lopsided, {"symmetry of the tangent", "tangent against differences"}),
        (
            lambda at: {"P": 1.01 * at.P},
            {f"{it} against differences" for it in ("stress", "tangent")},
        ),
        (lambda at: {"A": 1.01 * at.A}, {"tangent against differences"}),
        (lambda at: {"psi": at.psi + 1.0}, set()),
    ],
)
def test_tampered_law(change, failures):
    """A wrong stress or tangent fails its check."""
    found = check_law(tampered(change), strain=0.3, incompressible=True)
    assert outcomes(found, "fail") == failures


@pytest.mark.parametrize("kappa", [0.0, 1e5])
@pytest.mark.parametrize(
    ("psi", "jump"), [(energies.neo_hookean, False), (energies.saint_venant, False), (hgo, True)]
)
def test_jump_of_the_tangent(psi, jump, kappa):
    """A tangent that jumps where fibres drop out has a large kink, and a smooth one almost none.

    It is 8 k₁ M₁₁² of A₁₁₁₁, more than the shear modulus c.
    """
    law = partial(evaluate, material(psi, kappa=kappa))
    found = check_law(law, strain=0.3, incompressible=True)
    (kink,) = (c for c in found if c.name == KINK)
    assert kink.value is not None
    assert kink.value > 0.5 if jump else kink.value < 2e-4


@pytest.mark.parametrize("is_required", [True, False])
def test_nan_does_not_pass(is_required):
    """A comparison with NaN fails, with the state in its note."""
    F = np.eye(3)[None].repeat(2, axis=0)
    found = compare_with_bound("property", np.array([0.0, np.nan]), 1.0, F, is_required=is_required)
    assert found.outcome == "fail" and found.note.startswith(
        "NaN: psi or a derivative is undefined there; at F = "
    )


@pytest.mark.parametrize("incompressible", [True, False])
def test_random_states(incompressible):
    """Random states have bounded stretches, and keep their volume if incompressible."""
    F = random_states(np.random.default_rng(3), 50, 0.4, incompressible=incompressible)
    stretches = np.log(np.linalg.svd(F, compute_uv=False))
    assert np.linalg.det(F).min() > 0
    assert np.abs(stretches).max() <= 0.4 * (2 if incompressible else 1)
    assert np.abs(stretches).max() > 0.3
    volume = np.abs(np.log(np.linalg.det(F))).max()
    assert volume < 1e-13 if incompressible else volume > 0.3


# -- the report --------------------------------------------------------------------------------


def test_report_prints_each_check_with_its_outcome():
    """The report prints each check with its outcome."""
    report = check(material(energies.neo_hookean, kappa=1000.0, c=C), n=5)
    lines = str(report).splitlines()
    assert lines[0] == "material: kappa = 1000 kPa, c = 3"
    assert sum(line.startswith("pass") for line in lines) == len(report.checks)
    assert "Young's moduli 8.991, 8.991, 8.991 kPa along x, y, z" in lines
    assert "Poisson's ratios 0.4985, 0.4985, 0.4985 of xy, xz, yz" in lines
    assert "incompressible" in str(check(material(energies.neo_hookean), n=5)).splitlines()[0]
    assert "psi as it is" in str(check(material(energies.saint_venant, kappa=0.0), n=5))


def test_a_check_compiles_nothing(monkeypatch):
    """A check compiles nothing beyond the material itself."""
    user = material(hgo)
    monkeypatch.delattr("dolfinx.fem.Expression")
    assert check(user).ok


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"stretches": (1.1, 1.5)}, r"stretches = \(1\.1, 1\.5\): give a range with 1"),
        ({"stretches": (0.0, 1.5)}, r"stretches = \(0\.0, 1\.5\)"),
        ({"shears": (0.1, 1.0)}, r"shears = \(0\.1, 1\.0\): give a range with 0"),
        ({"strain": 0.0}, r"strain = 0\.0: give a positive number"),
        ({"n": 1}, "n = 1: give at least 2"),
    ],
)
def test_bad_input(arguments, message):
    """Arguments of a check out of range are refused."""
    with pytest.raises(ValueError, match=message):
        check(material(energies.neo_hookean), **arguments)


# -- loss of ellipticity against closed forms and brute force

SHORTEST = np.sqrt(1 - C / (2 * FIBRE))


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
    """A neo-Hookean solid is elliptic with at least c times the least squared stretch.

    There m · Q(n) m = c |Fᵀ n|² for m ⟂ n.
    """
    scan = scan_ellipticity(material(energies.neo_hookean), make, np.linspace(0.5, 2.0, 7))
    stretches = np.linalg.svd(scan.path.F, compute_uv=False)
    np.testing.assert_allclose(scan.least, C * stretches[:, -1] ** 2, rtol=1e-7)
    assert scan.lost == ()


@pytest.mark.parametrize("make", [uniaxial, equibiaxial, pure_shear, partial(inflation, axial=1.2)])
def test_fibres_kink_in_compression(make):
    """The standard reinforcing model loses ellipticity at λ² = 1 − c/(2 k) along the fibre.

    With n and m ⟂ n along and across the fibre, m · Q(n) m is λ² (c + 2 k (λ² − 1)), whatever the
    other stretches are.
    """
    scan = scan_ellipticity(material(energies.reinforced), make, np.linspace(0.6, 1.4, 9))
    assert scan.lost == pytest.approx((SHORTEST,), abs=1e-7)
    shortest = scan.path.values[0]
    assert scan.least[0] == pytest.approx(shortest**2 * (C + 2 * FIBRE * (shortest**2 - 1)))
    at = evaluate(material(energies.reinforced), scan.path.F[:1])  # the free entries are not its
    _, normal = least_eigenvalues(at.F, at.A, incompressible=True)
    np.testing.assert_allclose(np.abs(normal[0]), [1, 0, 0], atol=1e-5)


def test_both_sides_are_searched():
    """A loss of ellipticity is found for either sign of the shear."""
    turned = partial(simple_shear, along=(0, 1, 1), across=(0, -1, 1))
    scan = scan_ellipticity(material(energies.reinforced), turned, np.linspace(-0.5, 0.5, 5))
    assert scan.lost == () and scan.rest == 0
    upward = scan_ellipticity(
        material(energies.reinforced),
        partial(equibiaxial, along=(0, 1, 0), across=(0, 0, 1)),
        [1.0, 1.1, 1.3],
    )
    assert upward.lost == pytest.approx((SHORTEST**-0.5,), abs=1e-7)  # F₁₁ = λ⁻²


def test_uniaxial_strain_of_saint_venant_kirchhoff():
    """With λ = 0 ellipticity is lost at λ₁ = 2 − √2, at an oblique n = (c, s).

    With y = λ₁², det Q/μ² = y (3 y − 1) c⁴ + [2 (3 y − 1) + y² − y] c² s² + 2 y s⁴, whose
    discriminant in c² and s² vanishes at y = 6 − 4 √2. Longitudinal waves stop at y = 1/3 only.
    """
    y = 6 - 4 * np.sqrt(2)
    discriminant = (2 * (3 * y - 1) + y**2 - y) ** 2 - 8 * y**2 * (3 * y - 1)
    assert discriminant == pytest.approx(0, abs=1e-14)

    def bar(stretch):  # uniaxial strain: nothing is free
        F = np.eye(3) + np.subtract(stretch, 1)[:, None, None] * np.diag([1, 0, 0])
        return replace(uniaxial(stretch), F=F, free=np.empty((0, 3, 3)))

    scan = scan_ellipticity(material(energies.no_lambda, kappa=0.0), bar, np.linspace(0.5, 1.2, 8))
    assert scan.lost == pytest.approx((2 - np.sqrt(2),), abs=1e-7)


SHEARED = (0.75, 1.4, 1 / (0.75 * 1.4))
COMPRESSED = (0.6, 1.0, 1.0)
UNLOST = [energies.mooney_rivlin, hgo, goh, energies.reinforced]


@pytest.mark.parametrize(
    ("psi", "kappa", "stretches"),
    [
        *((psi, kappa, SHEARED) for psi in UNLOST for kappa in (np.inf, 30.0)),
        (energies.saint_venant, 0.0, COMPRESSED),
    ],
)
def test_least_eigenvalue_is_the_least_of_all(psi, kappa, stretches):
    """The least eigenvalue is that of a brute-force search over n and m."""
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
    if stretches is COMPRESSED:
        assert least < 0


def test_pressure_does_not_count_if_incompressible():
    """For incompressible solids κ does not contribute, as κ J (m · n)² = 0 for m ⟂ n."""
    F = np.diag([0.8, 1.25, 1.0])
    bare, stiff = (evaluate(material(energies.hgo, kappa=kappa), F) for kappa in (0.0, 500.0))
    values = [least_eigenvalues(s.F, s.A, incompressible=True)[0] for s in (bare, stiff)]
    assert values[0] == pytest.approx(values[1], rel=1e-8)


@pytest.mark.parametrize(("shear", "lost"), [(1e-8, ()), (1e-12, (1.0,))], ids=["soft", "rounding"])
def test_eigenvalue_of_rounding_is_zero(shear, lost):
    """An eigenvalue below ZERO_EIGENVALUE of the bulk modulus counts as zero."""

    def fluid(C, J):
        return shear * (ufl.tr(C) - 3 - 2 * ufl.ln(J)) / 2 + (J - 1) ** 2 / 2

    scan = scan_ellipticity(material(fluid, kappa=0.0), uniaxial, [0.999, 1.0, 1.001])
    assert scan.lost == lost


@pytest.mark.parametrize(
    ("least", "value"),
    [
        ([2.0, 1.0, -1.0, -2.0], 1.5),  # a root of the function, halfway
        ([2.0, np.nan, -1.0, -2.0], None),  # without equilibrium before a loss is seen
        ([2.0, 1.0, 0.5, 0.1], None),
        ([-1.0, 1.0, 1.0, 1.0], 0.0),  # at rest
    ],
    ids=["root", "no-equilibrium", "elliptic", "rest"],
)
def test_first_loss_is_a_root_or_none(least, value):
    """The first loss is a root between elliptic and other states, or None if there is none."""
    values = np.arange(4.0)
    found = _first_loss(lambda x: 3.0 - 2.0 * x, values, np.array(least), zero=1e-12)
    assert found == (None if value is None else pytest.approx(value, abs=1e-8))


def test_first_loss_next_to_states_without_equilibrium():
    """If the root has no equilibrium, the first loss is the first state that is not elliptic."""

    def least_at(value: float) -> float:
        return np.nan if 1.0 < value < 2.0 else 1.5 - value

    found = _first_loss(least_at, np.arange(3.0), np.array([1.5, 0.5, -0.5]), zero=0.0)
    assert found == 2.0


def test_loss_at_rest():
    """A material that is not elliptic at rest is lost at the stretch 1."""
    scan = scan_ellipticity(material(energies.wrong_sign), uniaxial, [0.9, 1.0, 1.1])
    assert scan.lost == (1.0,) and scan.rest == 1.0


def test_states_without_equilibrium():
    """States without equilibrium have NaN as their least eigenvalue."""
    scan = scan_ellipticity(material(energies.not_a_number), pure_shear, [0.9, 1.0, 1.1, 1.2, 1.3])
    np.testing.assert_array_equal(np.isnan(scan.least), [False, False, False, True, True])


@pytest.mark.parametrize("values", [[1.1, 1.0], [1.0, 1.0]])
def test_values_in_another_order(values):
    """Values that do not ascend are refused."""
    with pytest.raises(ValueError, match="ascending order"):
        scan_ellipticity(material(energies.neo_hookean), uniaxial, values)
