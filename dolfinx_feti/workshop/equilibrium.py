# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Equilibrium of a homogeneous deformation: its free entries, and the pressure.

With free directions D_k in the space of F, and the pressure p of Ψ + p (J − 1) − p²/(2κ),

    D_k : (P(F) + p cof F) = 0,   det F − 1 − p/κ = 0,   K_kl = D_k : (A + p D cof F) : D_l,

and (D cof F)_iJkL = ε_ikm ε_JLN F_mN. An incompressible material has 1/κ = 0, a complete energy has
no p. The steps of Newton's method are shortened until they decrease the residual. It starts from
the guess. States in which it fails are approached from rest, in 8 equal steps of F, then in 64.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.workshop.compiled import Material, evaluate

__all__ = ["cofactor", "equilibrate", "stiffness_scale", "total_tangent"]

#: Newton steps for one state: a bound; convergence takes fewer than ten.
MAX_STEPS = 40

#: Halvings of a Newton step: a bound; shorter steps would be below 1/4000 of it.
MAX_HALVINGS = 12

#: Numbers of steps from rest to F. Each is tried for the states in which all before it have failed.
#: A single step starts from the guess.
LOAD_STEPS = (1, 8, 64)

#: Newton increment of F at which a state has converged: its error is the square of this.
LAST_INCREMENT = 1e-9

#: Residual, relative to the tangent, above which a state with a small increment has not converged.
BALANCED_RTOL = 1e-7

#: Residual, relative to the tangent, that is rounding.
RESIDUAL_ROUNDING = 1e-14

#: Share of the predicted decrease of the residual that a Newton step must attain (Armijo's rule).
SUFFICIENT_DECREASE = 1e-4

#: Volume ratio up to which a trial state is rejected. Some energies, such as that of St Venant and
#: Kirchhoff, are finite at J = 0, and do not prevent collapse.
MIN_VOLUME_RATIO = 1e-6

#: Lower bound of Σ_k (D_k : cof F)² in the first guess of p, against a division by zero: the sum is
#: zero if no free entry changes the volume, and at least 1 at rest if a normal entry is free.
MIN_VOLUME_DERIVATIVE = 1e-6

#: ε_ijk, the permutation symbol.
PERMUTATION = np.linalg.det(np.eye(3)[np.indices((3, 3, 3)).transpose(1, 2, 3, 0)]).round()

#: ε_ikm ε_JLN as a matrix from F_mN to (D cof F)_iJkL.
COFACTOR = np.einsum("ikm,JLN->iJkLmN", PERMUTATION, PERMUTATION).reshape(81, 9)


@dataclass(frozen=True, slots=True)
class _Trial:
    """Trial states, with m unknowns each: the free entries x of F, and the pressure."""

    F: Array  #: (n, 3, 3)
    p: Array  #: [kPa], (n,)
    r: Array  #: Residuals in x and p, without units, (n, m)
    K: Array  #: Their tangents, (n, m, m)
    norm: Array  #: ‖r‖, (n,); infinite if a value is not finite, or J is almost zero or negative

    def has_residual_below(self, tolerance: float) -> Mask:
        """Return a mask of the states whose residual is small relative to the tangent, (n,)."""
        return self.norm < tolerance * (1 + np.abs(self.K).max(axis=(1, 2), initial=0.0))


@dataclass(frozen=True, slots=True)
class _Balance:
    """The equations of equilibrium."""

    energy: Material  #: Without its volumetric part κ/2 (J − 1)²
    flexibility: float | None  #: 1/κ [1/kPa]; None for an energy that is complete
    free: Array  #: Directions of the free entries, (k, 3, 3)
    scale: np.float64  #: Unit of stress [kPa]

    def at(self, F: Array, pressure: Array | None) -> _Trial:
        """Return residuals and tangents at states.

        Args:
            F: Deformation gradients, (n, 3, 3).
            pressure: p [kPa], (n,); None for the p with the smallest residuals r.
        """
        states = evaluate(self.energy, F)
        r = _entries(states.P / self.scale, self.free)
        if self.flexibility is None:
            p: Array = np.zeros(len(F))
            K = self._projected(states.A)
        else:
            cof = cofactor(F)
            volume = _entries(cof, self.free)  # D_k : cof F
            p = self._best_pressure(r, volume) if pressure is None else pressure
            J = np.einsum("nij,nij->n", cof, F) / 3
            r = r + (p / self.scale)[:, None] * volume
            r = np.column_stack((r, J - 1 - p * self.flexibility))
            row = volume[:, None]
            corner = np.full((len(F), 1, 1), -self.scale * self.flexibility)
            K_free = self._projected(total_tangent(states.A, F, p))
            K = np.block([[K_free, row.swapaxes(1, 2)], [row, corner]])
        norm = np.linalg.norm(r, axis=1)
        is_finite = np.isfinite(norm) & np.isfinite(K).all(axis=(1, 2))
        norm = np.where(is_finite & (np.linalg.det(F) > MIN_VOLUME_RATIO), norm, np.inf)
        return _Trial(F, p, r, K, norm)

    def _best_pressure(self, r: Array, volume: Array) -> Array:
        """Return the pressures that minimise ‖r + p/scale volume‖ [kPa], (n,).

        Args:
            r: Residuals without pressure, (n, k).
            volume: D_k : cof F, (n, k).
        """
        squares = np.maximum((volume**2).sum(axis=1), MIN_VOLUME_DERIVATIVE)
        return np.asarray(-self.scale * (r * volume).sum(axis=1) / squares)

    def _projected(self, A: Array) -> Array:
        """Return D_k : A : D_l without unit, (n, k, k), of tangents [kPa], (n, 3, 3, 3, 3)."""
        D = self.free.reshape(len(self.free), 9)
        return np.asarray(D @ (A / self.scale).reshape(len(A), 9, 9) @ D.T)


def equilibrate(material: Material, F: Array, free: Array) -> tuple[Array, Array]:
    """Solve for the free entries of F and the pressures.

    Args:
        material: The material.
        F: Deformation gradients with guesses of the free entries, (n, 3, 3).
        free: Directions of the free entries, (k, 3, 3).

    Returns:
        F, (n, 3, 3), and pressures [kPa], (n,), which are κ (J − 1) if κ is finite; NaN for states
        without equilibrium.

    Raises:
        ValueError: The material is incompressible and the path has no free entries, so the
            pressure is arbitrary.
    """
    if material.incompressible and not len(free):
        raise ValueError(
            "The path has no free entries, and then the pressure of an incompressible material is "
            "arbitrary: leave an entry free, or give a finite kappa."
        )
    bare = replace(material, kappa=0.0)
    flexibility = None if material.kappa == 0 else 1 / material.kappa
    balance = _Balance(bare, flexibility, free, np.float64(stiffness_scale(bare)))
    F_balanced = np.full_like(F, np.nan)
    p = np.full(len(F), np.nan)
    for steps in LOAD_STEPS:
        unsolved = np.flatnonzero(np.isnan(p))
        if len(unsolved):
            with np.errstate(all="ignore"):  # trial states may overflow
                F_balanced[unsolved], p[unsolved] = _approach(balance, F[unsolved], steps)
    return F_balanced, p


def cofactor(F: Array) -> Array:
    """Return the cofactors ∂(det F)/∂F, (n, 3, 3)."""
    return np.einsum("niJkL,nkL->niJ", _cofactor_tangent(F), F) / 2


def total_tangent(A: Array, F: Array, p: Array) -> Array:
    """Return the tangent with the pressure, A + p D cof F, (n, 3, 3, 3, 3)."""
    return A + p[:, None, None, None, None] * _cofactor_tangent(F)


def stiffness_scale(material: Material) -> float:
    """Return the largest entry of the tangent at F = I [kPa]; 1 if it is zero or not finite."""
    scale = float(np.abs(evaluate(material, np.eye(3)).A).max())
    return scale if 0.0 < scale < np.inf else 1.0


def _approach(balance: _Balance, F: Array, steps: int) -> tuple[Array, Array]:
    """Solve in equal steps from the reference to F; a single step starts from the guess.

    Args:
        balance: The equations.
        F: Deformation gradients with guesses of the free entries, (n, 3, 3).
        steps: Number of steps.

    Returns:
        F, (n, 3, 3), and pressures [kPa], (n,); NaN for states without equilibrium.
    """
    free = balance.free
    at_rest = np.broadcast_to(np.eye(3), F.shape)
    x = _entries(F if steps == 1 else at_rest, free)
    start = at_rest - _combine(_entries(at_rest, free), free)  # the prescribed parts
    end = F - _combine(_entries(F, free), free)
    p: Array | None = None
    is_solved: Mask = np.ones(len(F), dtype=np.bool_)  # at all steps so far
    for t in np.linspace(0.0, 1.0, steps + 1)[1:]:
        guess = start + t * (end - start) + _combine(x, free)
        state, has_converged = _newton(balance, guess, p, is_solved)
        x = _entries(state.F, free)
        p = state.p
        is_solved = is_solved & has_converged
        if not is_solved.any():
            break
    return np.where(is_solved[:, None, None], state.F, np.nan), np.where(is_solved, state.p, np.nan)


def _newton(balance: _Balance, F: Array, p: Array | None, is_wanted: Mask) -> tuple[_Trial, Mask]:
    """Solve for several states at once by Newton's method with step halving.

    Args:
        balance: The equations.
        F: Deformation gradients with guesses of the free entries, (n, 3, 3).
        p: Guesses of the pressures [kPa], (n,); None without any.
        is_wanted: Mask of the states to solve for, (n,).

    Returns:
        The last states, and a mask of those that have converged, (n,).
    """
    state = balance.at(F, p)
    k = len(balance.free)
    has_converged: Mask = np.zeros(len(F), dtype=bool)
    is_active = is_wanted
    for _ in range(MAX_STEPS):
        is_active = is_active & ~has_converged & np.isfinite(state.norm)
        if not is_active.any():
            break
        K = np.where(is_active[:, None, None], state.K, np.eye(state.r.shape[1]))
        r = np.where(is_active[:, None], state.r, 0.0)
        try:
            step = np.linalg.solve(K, -r[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:  # a singular tangent: the shortest step
            step = -np.einsum("nab,nb->na", np.linalg.pinv(K), r)
        dx = step[:, :k]
        dp = balance.scale * step[:, k:].sum(axis=1)
        is_small = np.abs(dx).max(axis=1, initial=0.0) < LAST_INCREMENT
        is_solved = is_small & state.has_residual_below(BALANCED_RTOL)
        is_solved |= state.has_residual_below(RESIDUAL_ROUNDING)
        has_converged = has_converged | (is_active & is_solved)
        needs_no_step: Mask = has_converged | ~is_active
        alpha: Array = np.ones(len(F))
        for _ in range(MAX_HALVINGS):  # of the steps that do not decrease the residual enough
            change = _combine(alpha[:, None] * dx, balance.free)
            trial = balance.at(state.F + change, state.p + alpha * dp)
            bound = (1 - SUFFICIENT_DECREASE * alpha) * state.norm
            is_accepted = needs_no_step | (trial.norm <= bound)
            if is_accepted.all():
                break
            alpha = np.where(is_accepted, alpha, alpha / 2)
        state = trial
        is_active = is_active & is_accepted  # all others have no step that decreases ‖r‖
    return state, has_converged & np.isfinite(state.norm)


def _cofactor_tangent(F: Array) -> Array:
    """Return D cof F, (n, 3, 3, 3, 3)."""
    return (F.reshape(len(F), 9) @ COFACTOR.T).reshape(-1, 3, 3, 3, 3)


def _entries(F: Array, free: Array) -> Array:
    """Return the free entries D_k : F, (n, k)."""
    return np.einsum("kiJ,niJ->nk", free, F)


def _combine(x: Array, free: Array) -> Array:
    """Return Σ x_k D_k, (n, 3, 3)."""
    return np.einsum("nk,kiJ->niJ", x, free)
