# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checks: good materials pass, and every broken energy fails the check that is meant for it."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import workshop_materials as energies
from workshop_materials import C, material

from dolfinx_feti.workshop import check, evaluate
from dolfinx_feti.workshop.report import check_law, judge, random_states

pytestmark = pytest.mark.serial

KINK = "tangent continuous at rest"


def outcomes(checks, *kinds):
    return {c.name for c in checks if c.outcome in kinds}


@pytest.mark.parametrize("kappa", [np.inf, 1000.0])
@pytest.mark.parametrize(
    "psi",
    [
        energies.neo_hookean,
        energies.mooney_rivlin,
        energies.hgo,
        energies.goh,
        energies.oblique,
        energies.fung,
        energies.holzapfel_ogden,
    ],
)
def test_good_materials_pass(psi, kappa):
    """Only the kink of fibres that do not push is worth a warning."""
    report = check(material(psi, kappa=kappa), n=9)
    assert report.ok
    fibres = psi in (energies.hgo, energies.goh, energies.oblique, energies.holzapfel_ogden)
    assert outcomes(report.checks, "warn", "fail") == ({KINK} if fibres else set())
    assert report.moduli is not None and len(report.ellipticity) == 5


def test_large_kappa_hides_nothing():
    """Ψ itself is checked, without κ/2 (J − 1)², which would set the scale of all deviations."""
    soft, stiff = (check(material(energies.hgo, kappa=kappa), n=5).checks for kappa in (10.0, 1e5))
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
    """In strong compression and tension, where fibres shorten, and where they kink."""
    report = check(material(psi, kappa=kappa), n=9)
    assert report.ok
    notes = {c.name: c.note for c in report.checks if c.outcome == "warn"}
    assert notes.keys() == {f"strongly elliptic, {path}" for path in lost}
    for path, where in lost.items():
        assert re.search(f"lost at .*{where}|{where} at", notes[f"strongly elliptic, {path}"])


BROKEN = {
    "not frame-indifferent": (
        energies.linear,
        {
            "frame indifference of the energy",
            "frame indifference of the stress",
            "symmetry of the stress",
        },
    ),
    "stress at rest": (energies.stressed, {"stress-free reference"}),
    "muscle that contracts": (energies.contracting, {"stress-free reference"}),
    "waves that differences miss": (
        energies.wavy,
        {"stress against differences", "tangent against differences"},
    ),
}


@pytest.mark.parametrize(("psi", "failures"), BROKEN.values(), ids=BROKEN)
def test_broken_energy_fails_its_check(psi, failures):
    report = check(material(psi), n=5)
    assert not report.ok
    found = outcomes(report.checks, "fail")
    assert {name for name in found if "elliptic" not in name} == failures


def test_wrong_sign_fails():
    report = check(material(energies.wrong_sign), n=5)
    found = outcomes(report.checks, "fail")
    assert "stiffness at rest positive" in found and "strongly elliptic, uniaxial" in found
    assert "least energy at the reference" in outcomes(report.checks, "warn")


def test_nothing_resists_a_change_of_volume():
    report = check(material(energies.neo_hookean, kappa=0.0), n=5)
    (found,) = (c for c in report.checks if c.name == "stiffness at rest positive")
    assert found.outcome == "warn" and "kappa" in found.note


def test_no_stiffness_at_rest():
    """Ψ = (Ī₁ − 3)²: everything at rest is zero, and nothing is divided by it."""
    report = check(material(energies.flat), n=5)
    assert "stiffness at rest positive" in outcomes(report.checks, "warn")
    failed = outcomes(report.checks, "fail")
    assert failed == {name for name in failed if "elliptic" in name} != set()
    assert report.moduli is not None and np.isnan(report.moduli.young).all()


def test_nan_is_reported_with_its_state():
    """The energy is NaN where C₁₁ > 1.3: in tension from λ = √1.3 = 1.14 on, not in shear."""
    report = check(material(energies.not_a_number), n=11)
    checks = {c.name: c for c in report.checks}
    finite, along = checks["finite values"], checks["finite values along the paths"]
    assert finite.outcome == "fail"
    assert finite.value is not None and finite.value > 0
    assert finite.note.startswith(
        f"Ψ, P, A at {finite.value:.0f} of 32 states, the first at F = [["
    )
    assert (along.outcome, along.value) == ("fail", 5 * 4)
    assert along.note.startswith("the first at λ = 1.2 of uniaxial, F = [[1.2, 0, 0]")
    note = checks["strongly elliptic, uniaxial"].note
    assert "no equilibrium at 5 states, the nearest at λ = 1.2" in note
    assert checks["frame indifference of the stress"].outcome == "pass"  # at the other states


def test_nan_at_rest():
    report = check(material(energies.root), n=5)
    assert report.moduli is None and report.ellipticity == ()
    failed = {c.name: c.note for c in report.checks if c.outcome == "fail"}
    assert failed["stress-free reference"] == "no number"
    assert "λ = 1 of uniaxial" in failed["finite values along the paths"]
    assert "no moduli" in str(report)


# -- laws that no energy can have --------------------------------------------------------------


def tampered(change):
    """States of a good material with a change of P or A."""

    def law(F):
        at = evaluate(material(energies.neo_hookean), F)
        return replace(at, **change(at))

    return law


def lopsided(at):
    """A tangent without major symmetry."""
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
            {"stress against differences", "tangent against differences"},
        ),
        (lambda at: {"A": 1.01 * at.A}, {"tangent against differences"}),
        (lambda at: {"psi": at.psi + 1.0}, set()),
    ],
)
def test_tampered_law(change, failures):
    found = check_law(tampered(change), strain=0.3, incompressible=True)
    assert outcomes(found, "fail") == failures


@pytest.mark.parametrize("kappa", [0.0, 1e5])
@pytest.mark.parametrize(
    ("psi", "jump"),
    [(energies.neo_hookean, False), (energies.saint_venant, False), (energies.hgo, True)],
)
def test_jump_of_the_tangent(psi, jump, kappa):
    """In compression all fibres drop out: 8 k₁ M₁₁² of A₁₁₁₁, more than the shear modulus c."""
    law = partial(evaluate, material(psi, kappa=kappa))
    found = check_law(law, strain=0.3, incompressible=True)
    (kink,) = (c for c in found if c.name == KINK)
    assert kink.value is not None
    assert kink.value > 0.5 if jump else kink.value < 2e-4


def test_nan_does_not_pass():
    found = judge("property", np.array([0.0, np.nan]), 1.0, np.eye(3)[None].repeat(2, axis=0))
    assert found.outcome == "fail" and found.note.startswith("no number; at F = ")


@pytest.mark.parametrize("incompressible", [True, False])
def test_random_states(incompressible):
    F = random_states(np.random.default_rng(3), 50, 0.4, incompressible=incompressible)
    stretches = np.log(np.linalg.svd(F, compute_uv=False))
    assert (np.linalg.det(F) > 0).all()
    assert np.abs(stretches).max() <= 0.4 * (2 if incompressible else 1)
    assert np.abs(stretches).max() > 0.3
    volume = np.abs(np.log(np.linalg.det(F))).max()
    assert volume < 1e-13 if incompressible else volume > 0.3


# -- the report --------------------------------------------------------------------------------


def test_text():
    report = check(material(energies.neo_hookean, kappa=1000.0, c=C), n=5)
    lines = str(report).splitlines()
    assert lines[0] == "material: kappa = 1000 kPa, c = 3"
    assert sum(line.startswith("pass") for line in lines) == len(report.checks)
    assert "Young's moduli 8.991, 8.991, 8.991 kPa along x, y, z" in lines
    assert "Poisson's ratios 0.4985, 0.4985, 0.4985 of xy, xz, yz" in lines
    assert "incompressible" in str(check(material(energies.neo_hookean), n=5)).splitlines()[0]
    assert "psi as it is" in str(check(material(energies.saint_venant, kappa=0.0), n=5))


def test_a_check_compiles_nothing(monkeypatch):
    """All states of two families of fibres go through the one energy that is compiled."""
    user = material(energies.hgo)
    monkeypatch.delattr("dolfinx.fem.Expression")
    assert check(user).ok


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"stretches": (1.1, 1.5)}, r"stretches = \(1\.1, 1\.5\): give a range with 1"),
        ({"stretches": (0.0, 1.5)}, r"stretches = \(0\.0, 1\.5\)"),
        ({"shears": (0.1, 1.0)}, r"shears = \(0\.1, 1\.0\): give a range with 0"),
        ({"strain": 0.0}, r"strain = 0\.0: give a positive number"),
        ({"n": 1}, "n = 1: give two states"),
    ],
)
def test_bad_input(arguments, message):
    with pytest.raises(ValueError, match=message):
        check(material(energies.neo_hookean), **arguments)
