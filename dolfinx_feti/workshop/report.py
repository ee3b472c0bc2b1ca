# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The report on a material: checks with a number each, its moduli, and where it loses ellipticity.

At random states F, with rotations R: Ψ(R F) = Ψ(F), P(R F) = R P(F), P Fᵀ = F Pᵀ, A_iJkL = A_kLiJ,
derivatives against central differences, and P(I) = 0 (docs/workshop.md). All deviations are
relative to the largest entry of A at the same state; those of stresses are thereby errors of
strain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dolfinx_feti.mechanics.values import require_positive, require_type
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.text_tables import format_number, format_value, text_table
from dolfinx_feti.workshop.compiled import Material, States, evaluate
from dolfinx_feti.workshop.ellipticity import Ellipticity, scan_ellipticity
from dolfinx_feti.workshop.moduli import ZERO_STIFFNESS, Moduli, small_strain_moduli
from dolfinx_feti.workshop.paths import STANDARD_PATHS, MaterialTest

__all__ = ["Check", "Law", "Report", "check", "check_law", "judge", "random_states"]

#: States of a material as a function of F, (n, 3, 3).
Law = Callable[[Array], States]

#: Largest deviation from an identity that holds to rounding accuracy, with a margin.
IDENTITIES = 1e-9

#: Largest deviation from finite differences, whose errors are 1e-10 for smooth energies.
DIFFERENCES = 1e-6

#: Change of the tangent next to the reference above which it has a kink there.
CONTINUITY = 1e-3

#: Increment of F in central differences: the cube root of the rounding unit, where the errors of
#: truncation and rounding are equal.
STEP = 6e-6

#: Strain of the states next to the reference.
NEARBY = 1e-10

#: Number of random states.
N_STATES = 32

#: Notes on failed checks.
UNIT = "are the fibres unit vectors?"
CONSTANT = "no stress follows from it"
KINK = "tension and compression differ at small strains, as with fibres that do not push"

#: Seed of the random states: every report has the same.
SEED = 1729


@dataclass(frozen=True, slots=True)
class Check:
    """The outcome of a check."""

    name: str  #: The property
    outcome: str  #: ``pass``, ``warn`` (a property that good models may lack) or ``fail``
    value: float | None  #: A relative deviation, a number of states, a modulus [kPa], or nothing
    bound: float | None  #: Most of a deviation; None for a modulus, which has to be positive
    note: str = ""  #: The state, the meaning, or the remedy


def check_law(law: Law, *, strain: float, incompressible: bool) -> list[Check]:
    """Check identities, reference state and derivatives of a law at random states.

    Args:
        law: The states as a function of F.
        strain: Largest principal strain of the random states.
        incompressible: Whether they have det F = 1, and the pressure at rest is arbitrary.
    """
    rng = np.random.default_rng(SEED)
    every = law(random_states(rng, N_STATES, strain, incompressible=incompressible))
    finite = _check_finite(every)
    if not every.finite.any():
        return [finite]
    states = law(every.F[every.finite])
    rest = law(np.eye(3)[None])
    R = _rotations(rng, len(states.F))
    H = rng.standard_normal((N_STATES, 3, 3))
    with np.errstate(all="ignore"):  # values at rest may be infinite
        F = states.F
        scale = _scale(states.A)
        scale_at_rest = _scale(rest.A)
        stress = rest.P - (np.trace(rest.P[0]) / 3 if incompressible else 0.0) * np.eye(3)
        below = np.maximum((rest.psi - states.psi) / scale, 0.0)
        turned = law(R @ F)
        frame = "write psi in C and J"
        tau = states.P @ F.transpose(0, 2, 1)  # P Fᵀ
        asymmetry = states.A - states.A.transpose(0, 3, 4, 1, 2)
        P, A = _differences(law, F)
        near = law(np.eye(3) + NEARBY * 0.5 * (H + H.transpose(0, 2, 1)))
        # without κ, which may be far larger than the moduli of shear
        shear = _scale(np.einsum("nijij->nij", rest.A) * (1 - np.eye(3)))
        kink = _largest(near.A - rest.A) / shear
        identities: list[tuple[str, Array, str]] = [
            ("frame indifference of the energy", np.abs(turned.psi - states.psi), frame),
            ("frame indifference of the stress", _largest(turned.P - R @ states.P), frame),
            ("symmetry of the stress", _largest(tau - tau.transpose(0, 2, 1)), ""),
            ("symmetry of the tangent", _largest(asymmetry), ""),
        ]
        return [
            finite,
            judge("stress-free reference", _largest(stress) / scale_at_rest, note=UNIT),
            judge("zero energy at the reference", np.abs(rest.psi) / scale_at_rest, warn=CONSTANT),
            judge("least energy at the reference", below, F=F, warn="a wrong sign?"),
            *(judge(name, d / scale, F=F, note=note) for name, d, note in identities),
            judge("stress against differences", _largest(states.P - P) / scale, DIFFERENCES, F),
            judge("tangent against differences", _largest(states.A - A) / scale, DIFFERENCES, F),
            judge("tangent continuous at rest", kink, CONTINUITY, warn=KINK),
        ]


def random_states(
    rng: np.random.Generator, n: int, strain: float, *, incompressible: bool
) -> Array:
    """Return F = R exp H with random rotations R and strains H, (n, 3, 3).

    Args:
        rng: Generator of random numbers.
        n: Number of states.
        strain: Principal values of H are uniformly distributed from −strain to strain.
        incompressible: Whether their mean is subtracted, so that det F = 1.
    """
    logarithms = rng.uniform(-strain, strain, (n, 3))
    if incompressible:
        logarithms -= logarithms.mean(axis=1, keepdims=True)
    R = _rotations(rng, n)
    Q = _rotations(rng, n)
    return R @ Q @ (np.exp(logarithms)[:, :, None] * Q.transpose(0, 2, 1))


def judge(
    name: str,
    deviations: Array,
    bound: float = IDENTITIES,
    F: Array | None = None,
    *,
    note: str = "",
    warn: str = "",
) -> Check:
    """Compare the largest of several deviations with a bound.

    Args:
        name: Name of the check.
        deviations: Deviations at the states, (n,); NaN fails.
        bound: Largest deviation that passes.
        F: The states, (n, 3, 3), to show the worst one.
        note: Explanation of a failure.
        warn: Explanation of a warning; if given, deviations above the bound are a warning.
    """
    worst = int(np.where(np.isnan(deviations), np.inf, deviations).argmax())
    value = float(deviations[worst])
    if value <= bound:
        return Check(name, "pass", value, bound)
    outcome = "warn" if warn else "fail"
    notes = [note or warn]
    if np.isnan(value):
        outcome = "fail"
        notes = ["no number"]
    if F is not None:
        notes.append(f"at {show(F[worst])}")
    return Check(name, outcome, value, bound, "; ".join(text for text in notes if text))


def show(F: Array) -> str:
    """Return a state as text."""
    rows = []
    for row in F + 0.0:  # without negative zeros
        entries = ", ".join(f"{entry:.4g}" for entry in row)
        rows.append(f"[{entries}]")
    return f"F = [{', '.join(rows)}]"


def _check_finite(states: States) -> Check:
    """Return a check that fails if states have values that are not finite."""
    lost = np.flatnonzero(~states.finite)
    note = ""
    if len(lost):
        parts = {"Ψ": states.psi, "P": states.P, "A": states.A}
        names = ", ".join(n for n, part in parts.items() if not np.isfinite(part[lost[0]]).all())
        first = show(states.F[lost[0]])
        note = f"{names} at {len(lost)} of {len(states.F)} states, the first at {first}"
    return Check("finite values", "fail" if note else "pass", float(len(lost)), 0.0, note)


def _differences(law: Law, F: Array) -> tuple[Array, Array]:
    """Return P, (n, 3, 3), and A, (n, 3, 3, 3, 3), by central differences in F."""
    P = np.empty((len(F), 3, 3))
    A = np.empty((len(F), 3, 3, 3, 3))
    for i, j in np.ndindex(3, 3):
        H = np.zeros((3, 3))
        H[i, j] = STEP
        up = law(F + H)
        down = law(F - H)
        P[:, i, j] = (up.psi - down.psi) / (2 * STEP)
        A[..., i, j] = (up.P - down.P) / (2 * STEP)
    return P, A


def _rotations(rng: np.random.Generator, n: int) -> Array:
    """Random rotations, (n, 3, 3)."""
    Q, _ = np.linalg.qr(rng.standard_normal((n, 3, 3)))
    return Q * np.linalg.det(Q)[:, None, None]


def _largest(values: Array) -> Array:
    """Largest entry of each state, (n,)."""
    return np.abs(values).reshape(len(values), -1).max(axis=1)


def _scale(A: Array) -> Array:
    """Largest entry of each state, or 1 where all are zero, (n,)."""
    largest = _largest(A)
    return np.where(largest > 0, largest, 1.0)


@dataclass(frozen=True, slots=True)
class Report:
    """What the checks found; ``str`` prints it."""

    material: Material  #: The material
    checks: tuple[Check, ...]  #: All checks
    moduli: Moduli | None  #: None if the energy has no finite tangent at rest
    ellipticity: tuple[Ellipticity, ...]  #: The acoustic tensor along each path

    @property
    def ok(self) -> bool:
        """Whether no check failed; warnings do not count."""
        return all(c.outcome != "fail" for c in self.checks)

    def __str__(self) -> str:
        """Return the tables."""
        rows = [[c.outcome, c.name, c.value, c.bound, c.note] for c in self.checks]
        parts = [
            _describe(self.material),
            text_table(["", "check", "value", "bound", ""], rows),
            "kPa: least eigenvalues, of the stiffness at rest and of the acoustic tensor",
            str(self.moduli) if self.moduli is not None else "no moduli",
        ]
        return "\n\n".join(parts)


def check(
    material: Material,
    *,
    strain: float = 0.3,
    stretches: tuple[float, float] = (0.6, 1.6),
    shears: tuple[float, float] = (-1.0, 1.0),
    n: int = 41,
) -> Report:
    """Check a material: its derivatives, symmetries, state of rest, moduli and ellipticity.

    Args:
        material: The compiled energy.
        strain: Size of the random principal logarithmic strains.
        stretches: Range of the stretches along the paths, with 1 inside.
        shears: Range of the amount of shear, with 0 inside.
        n: Number of states along a path.

    Raises:
        ValueError: A range does not hold the state of rest, or ``strain`` or ``n`` is too small.
    """
    require_type(Material, material=material)
    ranges = {
        "λ": _range("stretches", stretches, above=0.0, rest=1.0, n=n),
        "γ": _range("shears", shears, above=-np.inf, rest=0.0, n=n),
    }
    require_positive(strain=strain)
    tests = [(make, ranges[symbol]) for symbol in ranges for make in STANDARD_PATHS[symbol]]
    law = partial(evaluate, replace(material, kappa=0.0))  # a large κ would hide deviations
    checks = check_law(law, strain=strain, incompressible=material.incompressible)
    checks.append(_check_finite_along(law, [make(values) for make, values in tests]))
    if not law(np.eye(3)).finite.all():
        return Report(material, tuple(checks), None, ())
    moduli = small_strain_moduli(material)
    scans = tuple(scan_ellipticity(material, make, values) for make, values in tests)
    checks.append(_check_stiffness(moduli))
    checks += [_check_ellipticity(scan) for scan in scans]
    return Report(material, tuple(checks), moduli, scans)


def _check_finite_along(law: Law, paths: Sequence[MaterialTest]) -> Check:
    """Count the states of all paths, with guesses in their free entries, that are no numbers."""
    lost = [(path, k) for path in paths for k in np.flatnonzero(~law(path.F).finite)]
    note = ""
    for path, k in lost[:1]:
        where = f"{format_value(path.symbol, path.values[k])} of {path.name}, {show(path.F[k])}"
        note = f"the first at {where}"
    outcome = "fail" if lost else "pass"
    return Check("finite values along the paths", outcome, float(len(lost)), 0.0, note)


def _check_stiffness(moduli: Moduli) -> Check:
    """Whether the reference is stable: the least eigenvalue of its stiffness is positive."""
    zero = ZERO_STIFFNESS * np.abs(moduli.stiffness).max()
    outcome = "pass"
    note = "kPa"
    if moduli.least < -zero:
        outcome = "fail"
        note = "kPa; a wrong sign?"
    elif not moduli.least > zero:
        outcome = "warn"
        note = "kPa; nothing resists a change of volume, or another strain: give a kappa?"
    return Check("stiffness at rest positive", outcome, moduli.least, None, note)


def _check_ellipticity(scan: Ellipticity) -> Check:
    """Whether a path stays elliptic; a loss at rest is a failure, one further on a warning."""
    path = scan.path
    missing = np.isnan(scan.least)
    name = f"strongly elliptic, {path.name}"
    if missing.all():
        return Check(name, "fail", None, None, "no equilibrium at any state")
    k = int(np.nanargmin(scan.least))
    outcome = "pass"
    notes = [f"kPa, at {format_value(path.symbol, path.values[k])}"]
    if scan.lost:
        outcome = "fail" if scan.rest in scan.lost else "warn"
        notes.append("lost at " + " and ".join(format_value(path.symbol, v) for v in scan.lost))
    if missing.any():
        lost = path.values[missing]
        nearest = format_value(path.symbol, lost[np.abs(lost - scan.rest).argmin()])
        outcome = "fail" if outcome == "fail" else "warn"
        notes.append(f"no equilibrium at {len(lost)} states, the nearest at {nearest}")
    return Check(name, outcome, float(scan.least[k]), None, "; ".join(notes))


def _range(name: str, ends: tuple[float, float], *, above: float, rest: float, n: int) -> Array:
    """Return n values between the ends, and the value at rest."""
    least, most = ends
    if not above < least < rest < most < np.inf:
        raise ValueError(f"{name} = {ends}: give a range with {rest:g} (rest) inside.")
    if n < 2:
        raise ValueError(f"n = {n}: give two states at least.")
    return np.union1d(np.linspace(least, most, n), [rest])


def _describe(material: Material) -> str:
    """Return what the material is, in one line."""
    words = {np.inf: "incompressible", 0.0: "psi as it is"}
    kind = words.get(material.kappa, f"kappa = {format_number(material.kappa)} kPa")
    values = [f"{name} = {format_number(value)}" for name, value in material.parameters.items()]
    return ", ".join([f"material: {kind}", *values])
