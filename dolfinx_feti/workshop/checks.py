# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Checks of an energy at random states: identities, the reference state, and the derivatives.

At random states F, with rotations R: Ψ(R F) = Ψ(F), P(R F) = R P(F), P Fᵀ = F Pᵀ, A_iJkL = A_kLiJ,
derivatives against central differences, and P(I) = 0 (docs/workshop.md). All deviations are
relative to the largest entry of A at the same state, so a deviation of a stress is the strain that
would cause it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.workshop.compiled import States

__all__ = [
    "Check",
    "Law",
    "Outcome",
    "check_finite",
    "check_law",
    "compare_with_bound",
    "random_states",
    "state_text",
]

#: States of a material as a function of F, (n, 3, 3).
Law = Callable[[Array], States]

#: Outcomes of a check.
Outcome: TypeAlias = Literal["pass", "warn", "fail"]

#: Largest deviation from an identity that holds to rounding accuracy, with a margin.
IDENTITY_RTOL = 1e-9

#: Largest deviation from finite differences, whose errors are 1e-10 for smooth energies.
DIFFERENCE_RTOL = 1e-6

#: Relative change of the tangent from the reference to a state next to it, above which the tangent
#: has a kink at the reference.
KINK_RTOL = 1e-3

#: Increment of F in central differences: the cube root of the rounding unit, where the errors of
#: truncation and rounding are equal.
DIFFERENCE_STEP = 6e-6

#: Strain of the states next to the reference.
NEARBY_STRAIN = 1e-10

#: Number of random states.
N_STATES = 32

#: Seed of the random states: all reports use the same states.
SEED = 1729


@dataclass(frozen=True, slots=True)
class Check:
    """The outcome of a check."""

    name: str  #: The property
    outcome: Outcome  #: ``pass``, ``warn`` (a property that good models may lack) or ``fail``
    value: float | None  #: Relative deviation, number of states, or modulus [kPa], by the name
    bound: float | None  #: Largest value that passes; None for a modulus, which must be positive
    note: str = ""  #: The state, the meaning, or the remedy


def check_law(law: Law, *, strain: float, incompressible: bool) -> list[Check]:
    """Check identities, reference state and derivatives of a law at random states.

    Args:
        law: The states as a function of F.
        strain: Largest principal strain of the random states.
        incompressible: Whether the random states have det F = 1; the pressure at rest is then
            arbitrary.
    """
    rng = np.random.default_rng(SEED)
    all_states = law(random_states(rng, N_STATES, strain, incompressible=incompressible))
    finite = check_finite(all_states)
    if not all_states.finite.any():
        return [finite]
    states = law(all_states.F[all_states.finite])
    rest = law(np.eye(3)[None])
    R = _rotations(rng, len(states.F))
    H = rng.standard_normal((N_STATES, 3, 3))
    with np.errstate(all="ignore"):  # values at rest may be infinite
        nearby = law(np.eye(3) + NEARBY_STRAIN * 0.5 * (H + H.transpose(0, 2, 1)))
        return [
            finite,
            *_check_rest(rest, states, incompressible=incompressible),
            *_check_identities(states, law(R @ states.F), R),
            *_check_derivatives(law, states),
            _check_kink(rest, nearby),
        ]


def _check_rest(rest: States, states: States, *, incompressible: bool) -> list[Check]:
    """Check the stress and the energy at rest.

    Args:
        rest: The state of rest.
        states: Other states.
        incompressible: Whether the pressure at rest is arbitrary.
    """
    scale_at_rest = _scale(rest.A)
    pressure = np.trace(rest.P[0]) / 3 if incompressible else 0.0
    stress = rest.P - pressure * np.eye(3)
    below = np.maximum((rest.psi - states.psi) / _scale(states.A), 0.0)
    return [
        compare_with_bound(
            "stress-free reference",
            _largest(stress) / scale_at_rest,
            note="psi has a stress at F = I: give unit vectors as fibres, or correct its terms",
        ),
        compare_with_bound(
            "zero energy at the reference",
            np.abs(rest.psi) / scale_at_rest,
            note="psi has a constant term, without effect on the stress",
            is_required=False,
        ),
        compare_with_bound(
            "least energy at the reference",
            below,
            F=states.F,
            note="psi is smaller than at F = I: check the signs of its terms",
            is_required=False,
        ),
    ]


def _check_identities(states: States, rotated: States, R: Array) -> list[Check]:
    """Check frame indifference and symmetries.

    Args:
        states: States F.
        rotated: The states R F.
        R: The rotations, (n, 3, 3).
    """
    scale = _scale(states.A)
    tau = states.P @ states.F.transpose(0, 2, 1)  # P Fᵀ
    asymmetry = states.A - states.A.transpose(0, 3, 4, 1, 2)
    hint = "psi changes with a rotation: write it in C and J"

    def compare(name: str, deviation: Array, note: str = "") -> Check:
        return compare_with_bound(name, deviation / scale, F=states.F, note=note)

    return [
        compare("frame indifference of the energy", np.abs(rotated.psi - states.psi), hint),
        compare("frame indifference of the stress", _largest(rotated.P - R @ states.P), hint),
        compare("symmetry of the stress", _largest(tau - tau.transpose(0, 2, 1))),
        compare("symmetry of the tangent", _largest(asymmetry)),
    ]


def _check_derivatives(law: Law, states: States) -> list[Check]:
    """Compare stress and tangent with central differences."""
    F = states.F
    scale = _scale(states.A)
    P, A = _differences(law, F)
    P_error = _largest(states.P - P) / scale
    A_error = _largest(states.A - A) / scale
    return [
        compare_with_bound("stress against differences", P_error, DIFFERENCE_RTOL, F),
        compare_with_bound("tangent against differences", A_error, DIFFERENCE_RTOL, F),
    ]


def _check_kink(rest: States, nearby: States) -> Check:
    """Compare the tangents of states next to the reference with that at rest."""
    # relative to the moduli of shear: κ may be far larger, and would hide a kink
    shear = _scale(np.einsum("nijij->nij", rest.A) * (1 - np.eye(3)))
    return compare_with_bound(
        "tangent continuous at rest",
        _largest(nearby.A - rest.A) / shear,
        KINK_RTOL,
        note="tension and compression differ at small strains, as with fibres that do not push",
        is_required=False,
    )


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


def compare_with_bound(
    name: str,
    deviations: Array,
    bound: float = IDENTITY_RTOL,
    F: Array | None = None,
    *,
    note: str = "",
    is_required: bool = True,
) -> Check:
    """Compare the largest of several deviations with a bound.

    Args:
        name: Name of the check.
        deviations: Deviations at the states, (n,); NaN fails.
        bound: Largest deviation that passes.
        F: The states, (n, 3, 3), to show the worst one.
        note: Cause or remedy, if the bound is exceeded.
        is_required: Whether a deviation above the bound is a failure; if not, it is a warning.
    """
    worst = int(np.where(np.isnan(deviations), np.inf, deviations).argmax())
    value = float(deviations[worst])
    if value <= bound:
        return Check(name, "pass", value, bound)
    outcome: Outcome = "fail" if is_required else "warn"
    notes = [note]
    if np.isnan(value):
        outcome = "fail"
        notes = ["NaN: psi or a derivative is undefined there"]
    if F is not None:
        notes.append(f"at {state_text(F[worst])}")
    return Check(name, outcome, value, bound, "; ".join(text for text in notes if text))


def state_text(F: Array) -> str:
    """Return a state as text."""
    rows = []
    for row in F + 0.0:  # without negative zeros
        entries = ", ".join(f"{entry:.4g}" for entry in row)
        rows.append(f"[{entries}]")
    return f"F = [{', '.join(rows)}]"


def check_finite(states: States) -> Check:
    """Return a check that fails if states have values that are not finite."""
    not_finite = np.flatnonzero(~states.finite)
    if not len(not_finite):
        return Check("finite values", "pass", 0.0, 0.0)
    first = not_finite[0]
    parts = {"Ψ": states.psi, "P": states.P, "A": states.A}
    names = ", ".join(name for name, part in parts.items() if not np.isfinite(part[first]).all())
    note = (
        f"{names} at {len(not_finite)} of {len(states.F)} states, "
        f"the first at {state_text(states.F[first])}"
    )
    return Check("finite values", "fail", float(len(not_finite)), 0.0, note)


def _differences(law: Law, F: Array) -> tuple[Array, Array]:
    """Return P, (n, 3, 3), and A, (n, 3, 3, 3, 3), by central differences in F."""
    P = np.empty((len(F), 3, 3))
    A = np.empty((len(F), 3, 3, 3, 3))
    for i, j in np.ndindex(3, 3):
        H = np.zeros((3, 3))
        H[i, j] = DIFFERENCE_STEP
        up = law(F + H)
        down = law(F - H)
        P[:, i, j] = (up.psi - down.psi) / (2 * DIFFERENCE_STEP)
        A[..., i, j] = (up.P - down.P) / (2 * DIFFERENCE_STEP)
    return P, A


def _rotations(rng: np.random.Generator, n: int) -> Array:
    """Return random rotations, (n, 3, 3)."""
    Q, _ = np.linalg.qr(rng.standard_normal((n, 3, 3)))
    return Q * np.linalg.det(Q)[:, None, None]


def _largest(values: Array) -> Array:
    """Return the largest absolute value of the entries of each state, (n,)."""
    return np.abs(values).reshape(len(values), -1).max(axis=1)


def _scale(A: Array) -> Array:
    """Return the largest absolute entry of each tangent, (n,), or 1 if all are zero."""
    largest = _largest(A)
    return np.where(largest > 0, largest, 1.0)
