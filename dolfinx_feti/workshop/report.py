# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The report on a material: all checks, its moduli, and where it loses ellipticity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from dolfinx_feti.mechanics.values import require_positive
from dolfinx_feti.runtime.tables import number, state, table
from dolfinx_feti.workshop.checks import Check, Law, check_law, show
from dolfinx_feti.workshop.compiled import Material, evaluate
from dolfinx_feti.workshop.ellipticity import Ellipticity, scan_ellipticity
from dolfinx_feti.workshop.moduli import ZERO_STIFFNESS, Moduli, small_strain_moduli
from dolfinx_feti.workshop.paths import STANDARD_PATHS, MaterialTest

__all__ = ["Report", "check"]

Array = npt.NDArray[np.float64]

SEED = 1729


@dataclass(frozen=True, slots=True)
class Report:
    """What the checks found; ``str`` prints it.

    Attributes:
        material: The material.
        checks: All checks.
        moduli: Moduli at small strains; None if the energy has no finite tangent at rest.
        ellipticity: The acoustic tensor along each path.
    """

    material: Material
    checks: tuple[Check, ...]
    moduli: Moduli | None
    ellipticity: tuple[Ellipticity, ...]

    @property
    def ok(self) -> bool:
        """Whether no check failed; warnings do not count."""
        return all(c.outcome != "fail" for c in self.checks)

    def __str__(self) -> str:
        """Return the tables."""
        rows = [[c.outcome, c.name, c.value, c.bound, c.note] for c in self.checks]
        parts = [
            _describe(self.material),
            table(["", "check", "value", "bound", ""], rows),
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
    ranges = {
        "λ": _range("stretches", stretches, above=0.0, rest=1.0, n=n),
        "γ": _range("shears", shears, above=-np.inf, rest=0.0, n=n),
    }
    require_positive(strain=strain)
    tests = [(make, ranges[symbol]) for symbol in ranges for make in STANDARD_PATHS[symbol]]
    law = partial(evaluate, replace(material, kappa=0.0))  # a large κ would hide deviations
    checks = check_law(law, strain=strain, incompressible=material.incompressible, seed=SEED)
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
    name = "finite values along the paths"
    if not lost:
        return Check(name, "pass", 0.0, 0.0)
    path, k = lost[0]
    where = f"{state(path.symbol, path.values[k])} of {path.name}, {show(path.F[k])}"
    return Check(name, "fail", float(len(lost)), 0.0, f"the first at {where}")


def _check_stiffness(moduli: Moduli) -> Check:
    """Whether the reference is stable: the least eigenvalue of its stiffness is positive."""
    zero = ZERO_STIFFNESS * np.abs(moduli.stiffness).max()
    outcome, note = "pass", "kPa"
    if moduli.least < -zero:
        outcome, note = "fail", "kPa; a wrong sign?"
    elif not moduli.least > zero:
        outcome = "warn"
        note = "kPa; nothing resists a change of volume, or another strain: give a kappa?"
    return Check("stiffness at rest positive", outcome, moduli.least, None, note)


def _check_ellipticity(scan: Ellipticity) -> Check:
    """Whether a path stays elliptic; a loss at rest is a failure, one further on a warning."""
    path, missing = scan.path, np.isnan(scan.least)
    name = f"strongly elliptic, {path.name}"
    if missing.all():
        return Check(name, "fail", None, None, "no equilibrium at any state")
    k = int(np.nanargmin(scan.least))
    outcome, notes = "pass", [f"kPa, at {state(path.symbol, path.values[k])}"]
    if scan.lost:
        outcome = "fail" if scan.rest in scan.lost else "warn"
        notes.append("lost at " + " and ".join(state(path.symbol, v) for v in scan.lost))
    if missing.any():
        lost = path.values[missing]
        nearest = state(path.symbol, lost[np.abs(lost - scan.rest).argmin()])
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
    kind = words.get(material.kappa, f"kappa = {number(material.kappa)} kPa")
    values = [f"{name} = {number(value)}" for name, value in material.parameters.items()]
    return ", ".join([f"material: {kind}", *values])
