# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Properties that an energy has to have, each checked at many states, with a number.

With random states F and rotations R,

    Ψ(R F) = Ψ(F),  P(R F) = R P(F)     frame indifference,
    P Fᵀ = F Pᵀ                         symmetry of the stress, the balance of moments,
    A_iJkL = A_kLiJ                     major symmetry of the tangent, so that P has a potential,
    P = ∂Ψ/∂F,  A = ∂P/∂F               derivatives, against central differences,
    P(I) = 0                            no stress at rest (up to a pressure, if incompressible).

An energy Ψ(C, J) cannot fail the first two, one that is written in F can. All deviations are
relative to the largest entry of A at the same state; those of stresses are thereby errors of
strain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dolfinx_feti.workshop.compiled import States

__all__ = ["Check", "Law", "check_law", "judge", "random_states"]

Array = npt.NDArray[np.float64]
#: States of a material as a function of F, (n, 3, 3).
Law = Callable[[Array], States]

#: Deviations that pass: of identities that hold to rounding, and of finite differences.
IDENTITIES, DIFFERENCES = 1e-9, 1e-6
#: Jump of the tangent at rest that is no rounding.
KINK = 1e-3
#: Increments of F in finite differences, and next to the reference.
STEP, NEARBY = 6e-6, 1e-10
N_STATES = 32


@dataclass(frozen=True, slots=True)
class Check:
    """The outcome of a check.

    Attributes:
        name: The property.
        outcome: ``pass``, ``warn`` (a property that good models may lack) or ``fail``.
        value: What was found: a relative deviation, a number of states, or a modulus [kPa]; None if
            nothing could be computed.
        bound: What a deviation must not exceed; None for a modulus, which has to be positive.
        note: The state, the meaning, or the remedy.
    """

    name: str
    outcome: str
    value: float | None
    bound: float | None
    note: str = ""


def check_law(law: Law, *, strain: float, incompressible: bool, seed: int) -> list[Check]:
    """Check everything that does not need equilibrium.

    Args:
        law: Values of an energy and its derivatives as a function of F.
        strain: Size of the random strains, see :func:`random_states`.
        incompressible: Whether the states have J = 1, and the stress at rest is free up to a
            pressure.
        seed: Seed of the random numbers.
    """
    rng = np.random.default_rng(seed)
    F = random_states(rng, N_STATES, strain, incompressible=incompressible)
    states = law(F)
    finite = _check_finite(states)
    if not states.finite.any():
        return [finite]
    states, rest = law(F[states.finite]), law(np.eye(3)[None])
    with np.errstate(all="ignore"):  # values at rest may be infinite
        return [
            finite,
            *_check_rest(rest, states, incompressible),
            *_check_frame(law, states, _rotations(rng, len(states.F))),
            *_check_symmetry(states),
            *_check_derivatives(law, states),
            _check_kink(law, rest, rng.standard_normal((N_STATES, 3, 3))),
        ]


def random_states(
    rng: np.random.Generator, n: int, strain: float, *, incompressible: bool
) -> Array:
    """Return F = R exp H with random rotations R and strains H, (n, 3, 3).

    Args:
        rng: Source of the random numbers.
        n: Number of states.
        strain: The principal values of H are drawn from −strain to strain.
        incompressible: Whether their mean is then subtracted, so that J = 1.
    """
    logarithms = rng.uniform(-strain, strain, (n, 3))
    if incompressible:
        logarithms -= logarithms.mean(axis=1, keepdims=True)
    R, Q = _rotations(rng, n), _rotations(rng, n)
    return R @ Q @ (np.exp(logarithms)[:, :, None] * Q.transpose(0, 2, 1))


def judge(
    name: str,
    deviations: Array,
    bound: float,
    F: Array | None = None,
    *,
    otherwise: str = "fail",
    note: str = "",
) -> Check:
    """Compare the largest of several deviations with a bound; one that is no number fails.

    Args:
        name: The property.
        deviations: One per state, (n,).
        bound: The largest deviation that passes.
        F: The states, (n, 3, 3), if the worst one is to be shown.
        otherwise: The outcome if a deviation is larger, ``warn`` or ``fail``.
        note: What to add then.
    """
    worst = int(np.where(np.isnan(deviations), np.inf, deviations).argmax())
    value = float(deviations[worst])
    if value <= bound:
        return Check(name, "pass", value, bound)
    if np.isnan(value):
        otherwise, note = "fail", "no number"
    notes = [note] * bool(note) + ([] if F is None else [f"at {show(F[worst])}"])
    return Check(name, otherwise, value, bound, "; ".join(notes))


def show(F: Array) -> str:
    """Return a state as text."""
    rows = ("[" + ", ".join(f"{entry:.4g}" for entry in row) + "]" for row in F + 0.0)
    return f"F = [{', '.join(rows)}]"


def _check_finite(states: States) -> Check:
    """Count the states whose values are no finite numbers."""
    lost = np.flatnonzero(~states.finite)
    name = "finite values"
    if not len(lost):
        return Check(name, "pass", 0.0, 0.0)
    first = lost[0]
    parts = {"Ψ": states.psi, "P": states.P, "A": states.A}
    names = ", ".join(n for n, part in parts.items() if not np.isfinite(part[first]).all())
    return Check(
        name,
        "fail",
        float(len(lost)),
        0.0,
        f"{names} at {len(lost)} of {len(states.F)} states, the first at {show(states.F[first])}",
    )


def _check_rest(rest: States, states: States, incompressible: bool) -> list[Check]:
    """Energy and stress at the reference, and energies below that."""
    stress, scale = rest.P, _scale(rest.A)
    if incompressible:
        stress = stress - np.trace(stress[0]) / 3 * np.eye(3)
    below = (rest.psi - states.psi) / _scale(states.A)
    return [
        judge(
            "stress-free reference",
            _largest(stress) / scale,
            IDENTITIES,
            note="are the fibres unit vectors?",
        ),
        judge(
            "zero energy at the reference",
            np.abs(rest.psi) / scale,
            IDENTITIES,
            otherwise="warn",
            note="no stress follows from it",
        ),
        judge(
            "least energy at the reference",
            np.maximum(below, 0.0),
            IDENTITIES,
            states.F,
            otherwise="warn",
        ),
    ]


def _check_frame(law: Law, states: States, R: Array) -> list[Check]:
    """Energies and stresses after rotations R, (n, 3, 3)."""
    turned, scale = law(R @ states.F), _scale(states.A)
    energy = np.abs(turned.psi - states.psi) / scale
    stress = _largest(turned.P - R @ states.P) / scale
    note = "write psi in C and J"
    return [
        judge("frame indifference of the energy", energy, IDENTITIES, states.F, note=note),
        judge("frame indifference of the stress", stress, IDENTITIES, states.F, note=note),
    ]


def _check_symmetry(states: States) -> list[Check]:
    """Kirchhoff stress P Fᵀ, and major symmetry of A."""
    scale = _scale(states.A)
    tau = states.P @ states.F.transpose(0, 2, 1)
    stress = _largest(tau - tau.transpose(0, 2, 1)) / scale
    tangent = _largest(states.A - states.A.transpose(0, 3, 4, 1, 2)) / scale
    return [
        judge("symmetry of the stress", stress, IDENTITIES, states.F),
        judge("symmetry of the tangent", tangent, IDENTITIES, states.F),
    ]


def _check_derivatives(law: Law, states: States) -> list[Check]:
    """P and A against central differences in all nine entries of F."""
    scale = _scale(states.A)
    P, A = np.empty_like(states.P), np.empty_like(states.A)
    for i, j in np.ndindex(3, 3):
        H = np.zeros((3, 3))
        H[i, j] = STEP
        up, down = law(states.F + H), law(states.F - H)
        P[:, i, j] = (up.psi - down.psi) / (2 * STEP)
        A[..., i, j] = (up.P - down.P) / (2 * STEP)
    stress, tangent = _largest(states.P - P) / scale, _largest(states.A - A) / scale
    return [
        judge("stress against differences", stress, DIFFERENCES, states.F),
        judge("tangent against differences", tangent, DIFFERENCES, states.F),
    ]


def _check_kink(law: Law, rest: States, H: Array) -> Check:
    """Tangents next to the reference, on several sides of it, against the one at the reference."""
    near = law(np.eye(3) + NEARBY * 0.5 * (H + H.transpose(0, 2, 1)))
    shear = np.einsum("nijij->nij", rest.A) * (1 - np.eye(3))
    jump = _largest(near.A - rest.A) / _scale(shear)  # κ, which may be far larger, does not count
    return judge(
        "tangent continuous at rest",
        jump,
        KINK,
        otherwise="warn",
        note="tension and compression differ at small strains, as with fibres that do not push",
    )


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
