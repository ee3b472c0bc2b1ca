# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Equilibrium of a homogeneous deformation: its free entries, and the pressure.

With free directions D_k in the space of F, and the pressure p of Ψ + p (J − 1) − p²/(2κ),

    D_k : (P(F) + p cof F) = 0,   det F − 1 − p/κ = 0,   K_kl = D_k : (A + p D cof F) : D_l,

and (D cof F)_iJkL = ε_ikm ε_JLN F_mN. An incompressible material has 1/κ = 0, a complete energy no
p. Newton's method decreases the residual in each step, from the guess, or from rest in 8 or 64.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.workshop.compiled import Material, evaluate

__all__ = ["cofactor", "equilibrate", "stiffness_scale", "total_tangent"]

MAX_STEPS, MAX_HALVINGS = 40, 12
LOAD_STEPS = (1, 8, 64)
#: Newton increment of F at which a state has converged; the error left is its square.
LAST_INCREMENT = 1e-9
#: Residual, relative to the tangent, above which a small increment means that Newton is stuck.
BALANCED = 1e-7
#: Residual, relative to the tangent, that no step can make smaller.
RESIDUAL_ROUNDING = 1e-14
#: Volume ratio below which a body has collapsed; energies such as St Venant-Kirchhoff's let it.
COLLAPSED = 1e-6

PERMUTATION = np.array(
    [[[(i - j) * (j - k) * (k - i) / 2 for k in range(3)] for j in range(3)] for i in range(3)]
)
#: ε_ikm ε_JLN as a matrix from F_mN to (D cof F)_iJkL.
COFACTOR = np.einsum("ikm,JLN->iJkLmN", PERMUTATION, PERMUTATION).reshape(81, 9)


@dataclass(frozen=True, slots=True)
class _Trial:
    """Trial states."""

    F: Array
    p: Array
    r: Array  # residuals in x and p, without units, (n, m)
    K: Array  # their tangents, (n, m, m)
    norm: Array  # of r, infinite where something is no number, or the body flat, (n,)

    def below(self, tolerance: float) -> Mask:
        """Whether the residual is small compared with the tangent, (n,)."""
        return self.norm < tolerance * (1 + np.abs(self.K).max(axis=(1, 2), initial=0.0))


@dataclass(frozen=True, slots=True)
class _Balance:
    """The equations of equilibrium."""

    energy: Material  # without its volumetric part κ/2 (J − 1)²
    flexibility: float | None  # 1/κ [1/kPa]; None for an energy that is complete in itself
    free: Array  # directions of the free entries, (k, 3, 3)
    scale: np.float64  # unit of stress [kPa]

    def at(self, F: Array, p: Array) -> _Trial:
        """Return residuals and tangents; p where it is NaN gets the value that suits F best."""
        free, scale, D = self.free, self.scale, self.free.reshape(len(self.free), 9)
        states, cof = evaluate(self.energy, F), cofactor(F)
        r, A = _entries(states.P / scale, free), states.A
        if self.flexibility is None:
            p = np.zeros(len(F))
        else:
            volume = _entries(cof, free)
            best = -scale * (r * volume).sum(axis=1)
            best /= np.maximum((volume**2).sum(axis=1), COLLAPSED)
            p = np.where(np.isnan(p), best, p)
            r, A = r + (p / scale)[:, None] * volume, total_tangent(A, F, p)
        K = D @ (A / scale).reshape(len(F), 9, 9) @ D.T  # D_k : A : D_l
        if self.flexibility is not None:
            row, corner = volume[:, None], np.full((len(F), 1, 1), -scale * self.flexibility)
            K = np.block([[K, row.swapaxes(1, 2)], [row, corner]])
            J = np.einsum("nij,nij->n", cof, F) / 3
            r = np.column_stack((r, J - 1 - p * self.flexibility))
        norm = np.linalg.norm(r, axis=1)
        usable = np.isfinite(norm) & np.isfinite(K).all(axis=(1, 2))
        norm = np.where(usable & (np.linalg.det(F) > COLLAPSED), norm, np.inf)
        return _Trial(F, p, r, K, norm)


def equilibrate(material: Material, F: Array, free: Array) -> tuple[Array, Array]:
    """Find the free entries, along (k, 3, 3), of F, (n, 3, 3), and the pressures [kPa], (n,).

    F holds guesses. Pressures are κ (J − 1) if κ is finite. States that were not found hold NaN.
    Without free entries the pressure of an incompressible material is arbitrary: a ValueError.
    """
    if material.incompressible and not len(free):
        raise ValueError(
            "The path has no free entries, and then the pressure of an incompressible material is "
            "arbitrary: leave an entry free, or give a finite kappa."
        )
    bare = replace(material, kappa=0.0)
    flexibility = None if material.kappa == 0 else 1 / material.kappa
    balance = _Balance(bare, flexibility, free, np.float64(stiffness_scale(bare)))
    found, p = np.full_like(F, np.nan), np.full(len(F), np.nan)
    for steps in LOAD_STEPS:
        left = np.flatnonzero(np.isnan(p))
        if len(left):
            with np.errstate(all="ignore"):  # trial states may overflow
                found[left], p[left] = _approach(balance, F[left], steps)
    return found, p


def cofactor(F: Array) -> Array:
    """Cofactors ∂(det F)/∂F, (n, 3, 3)."""
    return np.einsum("niJkL,nkL->niJ", _cofactor_tangent(F), F) / 2


def total_tangent(A: Array, F: Array, p: Array) -> Array:
    """Tangent A + p D cof F with the pressure, (n, 3, 3, 3, 3)."""
    return A + p[:, None, None, None, None] * _cofactor_tangent(F)


def stiffness_scale(material: Material) -> float:
    """Largest entry of the tangent at F = I [kPa], or 1 where that is no positive number."""
    scale = float(np.abs(evaluate(material, np.eye(3)).A).max())
    return scale if 0.0 < scale < np.inf else 1.0


def _approach(balance: _Balance, F: Array, steps: int) -> tuple[Array, Array]:
    """Go from the reference to F in equal steps; the first and only one starts from the guess."""
    free, at_rest = balance.free, np.broadcast_to(np.eye(3), F.shape)
    x = _entries(F if steps == 1 else at_rest, free)
    start, end = (G - _combine(_entries(G, free), free) for G in (at_rest, F))
    p: Array = np.full(len(F), np.nan)
    alive: Mask = np.ones(len(F), dtype=np.bool_)
    for t in np.linspace(0.0, 1.0, steps + 1)[1:]:
        guess = start + t * (end - start) + _combine(x, free)
        state, converged = _newton(balance, guess, p, alive)
        x, p, alive = _entries(state.F, free), state.p, alive & converged
        if not alive.any():
            break
    return np.where(alive[:, None, None], state.F, np.nan), np.where(alive, p, np.nan)


def _newton(balance: _Balance, F: Array, p: Array, alive: Mask) -> tuple[_Trial, Mask]:
    """Newton's method for the states that are alive, and which of them have converged."""
    state, k = balance.at(F, p), len(balance.free)
    done: Mask = np.zeros(len(F), dtype=bool)
    going = alive
    for _ in range(MAX_STEPS):
        going = going & ~done & np.isfinite(state.norm)
        if not going.any():
            break
        K = np.where(going[:, None, None], state.K, np.eye(state.r.shape[1]))
        r = np.where(going[:, None], state.r, 0.0)
        try:
            step = np.linalg.solve(K, -r[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:  # a singular tangent: the shortest step
            step = -np.einsum("nab,nb->na", np.linalg.pinv(K), r)
        dx, dp = step[:, :k], balance.scale * step[:, k:].sum(axis=1)
        small = (np.abs(dx).max(axis=1, initial=0.0) < LAST_INCREMENT) & state.below(BALANCED)
        done = done | (going & (small | state.below(RESIDUAL_ROUNDING)))
        resting: Mask = done | ~going
        alpha: Array = np.ones(len(F))
        for _ in range(MAX_HALVINGS):
            by = _combine(alpha[:, None] * dx, balance.free)
            trial = balance.at(state.F + by, state.p + alpha * dp)
            moved = resting | (trial.norm <= (1 - 1e-4 * alpha) * state.norm)
            if moved.all():
                break
            alpha = np.where(moved, alpha, alpha / 2)
        state, going = trial, going & moved
    return state, done & np.isfinite(state.norm)


def _cofactor_tangent(F: Array) -> Array:
    """D cof F, (n, 3, 3, 3, 3)."""
    return (F.reshape(len(F), 9) @ COFACTOR.T).reshape(-1, 3, 3, 3, 3)


def _entries(F: Array, free: Array) -> Array:
    """Coordinates D_k : F, (n, k)."""
    return np.einsum("kiJ,niJ->nk", free, F)


def _combine(x: Array, free: Array) -> Array:
    """Σ x_k D_k, (n, 3, 3)."""
    return np.einsum("nk,kiJ->niJ", x, free)
