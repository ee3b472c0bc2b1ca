# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""CG and GMRES on the assembled interface, preconditioned by FETI's local solves (docs/theory.md).

.. math:: z = Π\, T^⊤ δ\, K_ρ^{-1} δ\, T r, \qquad A = T^⊤ S T

with the projection Π of ``deflation`` (Mandel 1993; Fragakis and Papadrakakis 2003). An indefinite
A shows in A₀ or in a direction p with :math:`p^⊤ A p < 0` beyond rounding, and CG solves with it
where A₀ has as many negative eigenvalues, or one or two less, as near a limit point. GMRES is for
an unsymmetric A,

.. math:: A Z_k = Q_{k+1} H, \quad a = R^{-⊤} h, \quad \|r_k\| = \|r_0\| (1 + a^⊤ a)^{-1/2}

with an orthonormal basis Q of residuals, and the first row h of H above the triangle R (Saad and
Schultz 1986; Ayachour 2003). It keeps two vectors an iteration, up to :data:`RESTART`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import scipy.linalg

from dolfinx_feti.feti.coarse.space import MARGIN
from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.primal.deflation import DeflatedSpace, Trace
from dolfinx_feti.feti.solution import RESTART, STAGNATION, Monitor, Solution
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import deferred, on_all, total_of
from dolfinx_feti.torn.rounding import EPS

#: Share of ‖r‖² below which rounding would be felt in ‖r − α q‖² = ‖r‖² − 2 α rᵀ q + α² ‖q‖².
CANCELLED = 1e-8

#: Negative curvatures, one for each negative eigenvalue that A₀ misses, with which a solve goes on.
FEW = 2

Reason = PETSc.KSP.ConvergedReason


@dataclass(frozen=True, slots=True)
class PrimalSystem:
    """A and its preconditioner; vectors are copies on the torn interface, (n,).

    Attributes:
        copies: Copies of the interface dofs.
        space: The coarse space V, and W.
        multiply: Applies S of every subdomain, (n,) → (n,).
        solve: Applies :math:`K_ρ^{-1}` of every subdomain, restricted to the interface,
            (n,) → (n,).
    """

    copies: Copies
    space: DeflatedSpace
    multiply: Callable[[Array], Array]
    solve: Callable[[Array], Array]

    def residual(self, f: Array, x: Array) -> Array:
        """Return b − A x, with b = Tᵀ f for a torn load f. Collective."""
        return self.copies.sum(f - self.multiply(x))  # Tᵀ (f − S T x)

    def precondition(self, r: Array) -> tuple[Array, float]:
        """Return z = Π Tᵀ δ K_ρ⁻¹ δ T r + V A₀⁻¹ Vᵀ r, that for rounding, and rᵀ z. Collective."""
        w = self.solve(self.copies.delta * r)  # w = K_ρ⁻¹ δ T r
        return self.space.correct_with_product(self.copies.average(w), r)

    def norm(self, r: Array) -> float:
        """Return ‖r‖ of the assembled vector. Collective."""
        return float(np.sqrt(self.copies.dots((r, r))[0]))


def conjugate_gradients(
    system: PrimalSystem,
    f: Array,
    *,
    target: float,
    max_it: int,
    monitor: Monitor,
    traced: int = 0,
    saddles: bool = False,
) -> tuple[Array, Solution, Trace]:
    """Solve A x = Tᵀ f. Collective.

    The torn load f is condensed to the interface, (n,), and not summed over copies. Of up to
    ``traced`` iterations the vectors are kept; ``saddles`` go on where A has negative eigenvalues.

    Returns:
        The iterate with the least residual, by its copies, (n,), how the method ended, and its
        first iterations. The reason ``CONVERGED_ITS`` asks for a fresh start.
    """
    copies, space = system.copies, system.space
    x = space.initial_guess(copies.sum(f))
    p: Array = np.zeros_like(x)
    ρ = np.inf
    r = system.residual(f, x)
    norm = system.norm(r)
    monitor(0, norm)
    α: list[float] = []
    β: list[float] = []
    R, Z = np.empty((2, traced, len(x)))  # a row takes memory once it is written
    left = FEW * saddles
    best, least, at = x, norm, 0
    in_vain = space.indefinite and not saddles
    reason = Reason.DIVERGED_INDEFINITE_MAT if in_vain else Reason.ITERATING
    while not reason and not (reason := _converged_reason(norm, target, len(α), max_it)):
        last = ρ
        z, ρ = system.precondition(r)
        β.append(ρ / last)
        p = z + β[-1] * p
        q = copies.sum(system.multiply(p))  # q = A p
        curvature, rr, rq, qq = copies.dots((p, q), (r, r), (r, q), (q, q))
        if ρ <= 0.0:
            reason = Reason.DIVERGED_INDEFINITE_PC
        elif curvature <= 0.0 and not (real := curvature < -MARGIN * space.rounding(p)):
            reason = Reason.CONVERGED_ITS  # by rounding
        elif curvature <= 0.0 and real and not left:
            reason = Reason.DIVERGED_INDEFINITE_MAT
        else:
            left -= curvature < 0.0
            if len(α) < traced:
                R[len(α)], Z[len(α)] = r / np.sqrt(ρ), z / np.sqrt(ρ)
            α.append(ρ / curvature)
            x = x + α[-1] * p
            r -= α[-1] * q
            squared = rr - α[-1] * (2.0 * rq - α[-1] * qq)  # ‖r − α q‖²
            norm = np.sqrt(squared) if squared > CANCELLED * rr else system.norm(r)
            monitor(len(α), norm)
            if norm < least:
                best, least, at = x, norm, len(α)
            elif len(α) - at >= STAGNATION:
                reason = Reason.CONVERGED_ITS
    k = min(len(α), traced)
    trace = Trace(R[:k], Z[: max(k - 1, 0)], _hessenberg(np.array(α[:k]), np.array(β[:k])))
    ends = on_all(lambda: _extreme_ritz_values(α, β), copies.comm)
    return best, Solution(reason, len(α), ends), trace


def gmres(
    system: PrimalSystem, f: Array, *, target: float, max_it: int, monitor: Monitor, traced: int = 0
) -> tuple[Array, Solution, Trace]:
    """Solve A x = Tᵀ f, with arguments and results of ``conjugate_gradients``. Collective."""
    copies = system.copies
    x = system.space.initial_guess(copies.sum(f))
    r = system.residual(f, x)
    norm = first = system.norm(r)
    monitor(0, norm)
    most = min(max_it, RESTART)
    Q, Z = np.empty((2, most + 1, len(x)))  # a row takes memory once it is written
    H, a, k = np.zeros((most + 1, most)), np.zeros(most), 0
    if not (reason := _converged_reason(norm, target, 0, max_it)):
        Q[0] = r / first
    while not reason:
        Z[k], _ = system.precondition(Q[k])
        q = copies.sum(system.multiply(Z[k]))  # q = A z
        H[: k + 2, k], Q[k + 1] = _orthonormalised(copies, Q[: k + 1], q)
        if H[k + 1, k] == 0.0:
            reason = Reason.CONVERGED_ITS  # A z = 0
            break
        a[k] = (H[0, k] - H[1 : k + 1, k] @ a[:k]) / H[k + 1, k]  # a = R⁻ᵀ h
        k += 1
        norm = float(first / np.sqrt(1.0 + a @ a))
        monitor(k, norm)
        reason = _converged_reason(norm, target, k, max_it)
        if not reason and k == most:
            reason = Reason.CONVERGED_ITS
    if k and np.isfinite(norm):
        y = deferred(lambda: scipy.linalg.solve_triangular(H[1 : k + 1, :k], a[:k]), k)
        x = x + Z[:k].T @ (y * (first / (1.0 + a @ a)))
    m = min(k, traced)
    trace = Trace(Q[: m + 1], Z[:m], H[: m + 1, :m])
    return x, Solution(reason, k), trace


def _orthonormalised(copies: Copies, Q: Array, q: Array) -> tuple[Array, Array]:
    """Return h with q = Σ h_j q_j, (k + 1,), and the last q_j, (n,), orthonormal to Q, (k, n).

    Gram–Schmidt, twice. Collective.
    """
    δ, comm = copies.delta, copies.comm
    h = total_of(Q @ (δ * q), comm)
    q = q - h @ Q
    *own, square = total_of(np.append(Q @ (δ * q), q @ (δ * q)), comm)
    more = np.array(own)
    q, h = q - more @ Q, h + more
    size = np.sqrt(h @ h + square)  # ‖A z‖
    last = np.sqrt(max(square - more @ more, (EPS * size) ** 2))  # or all of q is rounding
    return np.append(h, last), q / last if last > 0.0 else q


def _converged_reason(norm: float, target: float, its: int, max_it: int) -> int:
    """Return the converged reason after an iteration."""
    if not np.isfinite(norm):
        return Reason.DIVERGED_NANORINF
    if norm <= target:
        return Reason.CONVERGED_RTOL
    return Reason.DIVERGED_MAX_IT if its == max_it else Reason.ITERATING


def _hessenberg(α: Array, β: Array) -> Array:
    """Return H with A Z = R H for iterations that are scaled to rᵀ z = 1, (k, k − 1)."""
    k, root = max(len(α) - 1, 0), np.sqrt(β)
    L = (np.eye(k + 1, k) - np.diag(root[1:], -1)[:, :k]) / α[:k]
    return L @ (np.eye(k) - np.diag(root[1:k], 1))  # A P = R L, z_j = p_j − √β_j p_{j−1}


def _extreme_ritz_values(α: list[float], β: list[float]) -> tuple[float, float]:
    """Return the extreme eigenvalues of Lanczos' matrix from the coefficients; nan if unknown."""
    if not α or not np.all(np.isfinite(α)):
        return np.nan, np.nan
    a, b = np.array(α), np.array(β[1 : len(α)])
    diagonal = 1.0 / a
    diagonal[1:] += b / a[:-1]
    ritz = scipy.linalg.eigvalsh_tridiagonal(diagonal, np.sqrt(b) / a[:-1])
    return float(ritz[0]), float(ritz[-1])
