# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The report on a material: its checks, its moduli, and where it loses ellipticity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.values import require_positive, require_type
from dolfinx_feti.text_tables import format_number, format_value, text_table
from dolfinx_feti.workshop.checks import Check, Law, Outcome, check_law, state_text
from dolfinx_feti.workshop.compiled import Material, evaluate
from dolfinx_feti.workshop.ellipticity import Ellipticity, scan_ellipticity
from dolfinx_feti.workshop.moduli import ZERO_STIFFNESS, Moduli, small_strain_moduli
from dolfinx_feti.workshop.paths import STANDARD_PATHS, DeformationPath

__all__ = ["Report", "check"]


@dataclass(frozen=True, slots=True)
class Report:
    """Results of all checks of a material; ``str`` prints them."""

    material: Material  #: The material
    checks: tuple[Check, ...]  #: All checks
    moduli: Moduli | None  #: None if the energy has no finite tangent at rest
    ellipticity: tuple[Ellipticity, ...]  #: The acoustic tensor along each path

    @property
    def ok(self) -> bool:
        """Whether no check failed; warnings do not count."""
        return all(c.outcome != "fail" for c in self.checks)

    def __str__(self) -> str:
        """Return the report as text."""
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
        ValueError: A range does not contain the state of rest, or ``strain`` or ``n`` is too small.
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


def _check_finite_along(law: Law, paths: Sequence[DeformationPath]) -> Check:
    """Check that all values are finite along the paths, at the guesses of the free entries."""
    not_finite = [(path, k) for path in paths for k in np.flatnonzero(~law(path.F).finite)]
    name = "finite values along the paths"
    if not not_finite:
        return Check(name, "pass", 0.0, 0.0)
    path, k = not_finite[0]
    value = format_value(path.symbol, path.values[k])
    note = f"the first at {value} of {path.name}, {state_text(path.F[k])}"
    return Check(name, "fail", float(len(not_finite)), 0.0, note)


def _check_stiffness(moduli: Moduli) -> Check:
    """Check that the reference is stable: the smallest eigenvalue of its stiffness is positive."""
    zero = ZERO_STIFFNESS * np.abs(moduli.stiffness).max()
    outcome: Outcome = "pass"
    note = "kPa"
    if moduli.least < -zero:
        outcome = "fail"
        note = "kPa; a small strain lowers psi: check the signs of its terms"
    elif not moduli.least > zero:
        outcome = "warn"
        note = "kPa; nothing resists a change of volume, or another strain: give kappa"
    return Check("stiffness at rest positive", outcome, moduli.least, None, note)


def _check_ellipticity(scan: Ellipticity) -> Check:
    """Check that a path stays elliptic: a loss at rest is a failure, a later one a warning."""
    path = scan.path
    has_no_equilibrium = np.isnan(scan.least)
    name = f"strongly elliptic, {path.name}"
    if has_no_equilibrium.all():
        return Check(name, "fail", None, None, "no equilibrium at any state")
    k = int(np.nanargmin(scan.least))
    outcome: Outcome = "pass"
    notes = [f"kPa, at {format_value(path.symbol, path.values[k])}"]
    if scan.lost:
        outcome = "fail" if scan.rest in scan.lost else "warn"
        notes.append("lost at " + " and ".join(format_value(path.symbol, v) for v in scan.lost))
    if has_no_equilibrium.any():
        values = path.values[has_no_equilibrium]
        nearest = format_value(path.symbol, values[np.abs(values - scan.rest).argmin()])
        outcome = "fail" if outcome == "fail" else "warn"
        notes.append(f"no equilibrium at {len(values)} states, the nearest at {nearest}")
    return Check(name, outcome, float(scan.least[k]), None, "; ".join(notes))


def _range(name: str, ends: tuple[float, float], *, above: float, rest: float, n: int) -> Array:
    """Return n values between the ends, and the value at rest, in ascending order.

    Raises:
        ValueError: The value at rest is not between the ends, an end is not above the bound or not
            finite, or n is less than two.
    """
    first, last = ends
    if not above < first < rest < last < np.inf:
        raise ValueError(f"{name} = {ends}: give a range with {rest:g} (rest) inside.")
    if n < 2:
        raise ValueError(f"n = {n}: give at least 2, the two ends of each range.")
    return np.union1d(np.linspace(first, last, n), [rest])


def _describe(material: Material) -> str:
    """Return a line on the compressibility and the parameters of a material."""
    kind = f"kappa = {format_number(material.kappa)} kPa"
    if material.incompressible:
        kind = "incompressible"
    elif material.kappa == 0.0:
        kind = "psi as it is"
    values = [f"{name} = {format_number(value)}" for name, value in material.parameters.items()]
    return ", ".join([f"material: {kind}", *values])
