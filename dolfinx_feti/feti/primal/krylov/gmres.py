# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""GMRES on the assembled interface, for any A.

.. math:: A Z_k = R_{k+1} H, \quad a = U^{-⊤} h, \quad \|r_k\| = \|r_0\| (1 + a^⊤ a)^{-1/2}, \quad
          x_k = x_0 + \frac{\|r_0\|}{1 + a^⊤ a}\, Z_k U^{-1} a

with an orthonormal basis R of the residuals and :math:`Z = Π M R`, where :math:`h^⊤` is the first
row of H and U the triangle below it (Saad, Schultz, GMRES, 1986; Ayachour, A fast implementation
for GMRES method, 2003). An iteration stores two vectors.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import scipy.linalg

from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.krylov_limits import GMRES_DIRECTIONS
from dolfinx_feti.feti.monitor import Monitor
from dolfinx_feti.feti.primal.krylov.base import KrylovBasis, KrylovStart, start_from_coarse_space
from dolfinx_feti.feti.primal.stopping import StoppingTest
from dolfinx_feti.feti.primal.system import PrimalSystem
from dolfinx_feti.feti.solve_info import KrylovInfo
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.torn.rounding import EPS

Reason = PETSc.KSP.ConvergedReason


def gmres(
    system: PrimalSystem,
    f: Array,
    stopping: StoppingTest,
    *,
    monitor: Monitor,
    stored_iterations: int,
    allow_indefinite: bool,
) -> tuple[Array, KrylovInfo, KrylovBasis]:
    """Solve A x = Tᵀ f for any A. Collective.

    Arguments and results are those of :class:`~dolfinx_feti.feti.primal.krylov.base.KrylovMethod`.
    ``allow_indefinite`` has no effect, as the method does not depend on the signs of eigenvalues.

    Each iteration preconditions the last column of R only: a residual r = R v has z = Z v.
    """
    start = start_from_coarse_space(system, f, monitor)
    norm = start.norm
    max_k = min(stopping.max_it, GMRES_DIRECTIONS)
    reason = stopping.reason_of_residual(norm, 0)
    arnoldi = _ArnoldiBasis(system.copies, start, max_k)
    η = np.nan
    needs_fresh_start = False
    while reason == Reason.ITERATING:
        z, _ = system.precondition(arnoldi.last_column)
        arnoldi.store(z)
        if stopping.needs_error_estimate(norm):
            η = stopping.estimate_error(
                arnoldi.preconditioned_residual(), start.x + arnoldi.correction()
            )
            reason = stopping.reason_of_error(η, arnoldi.k)
            if reason != Reason.ITERATING:
                break
        if arnoldi.k == max_k:
            needs_fresh_start = True  # ‖r‖ has reached its target, but η has not
            break
        if not arnoldi.extend(system.apply(z)):
            needs_fresh_start = True  # A z is zero: the basis cannot grow
            break
        norm = arnoldi.residual_norm()
        monitor(arnoldi.k, norm)
        reason = stopping.reason_of_residual(norm, arnoldi.k)
        if reason == Reason.ITERATING and arnoldi.k == max_k and norm > stopping.target:
            needs_fresh_start = True  # nothing to measure, so the last column needs no z
            break
    x = start.x + arnoldi.correction() if np.isfinite(norm) else start.x
    basis = arnoldi.basis(stored_iterations)
    return x, KrylovInfo(reason, arnoldi.k, needs_fresh_start=needs_fresh_start), basis


class _ArnoldiBasis:
    """R, Z and H of GMRES, A Z = R H, and the smallest residual in their span.

    R and Z have a row for each vector, stored by copies, (n_Γ,).

    Attributes:
        k: Number of columns of H.
    """

    def __init__(self, copies: Copies, start: KrylovStart, max_k: int) -> None:
        """Scale the residual of the initial guess to the first column of R.

        Args:
            copies: Copies of the interface dofs.
            start: Initial guess and its residual.
            max_k: Largest number of iterations. A row of R and Z takes memory only when it is
                written.
        """
        self.k = 0
        self._copies = copies
        self._first_norm = start.norm
        self._R = np.empty((max_k + 1, len(start.r)))
        self._Z = np.empty((max_k + 1, len(start.r)))
        self._H = np.zeros((max_k + 1, max_k))
        self._a = np.zeros(max_k)  # a = U⁻ᵀ h
        if start.norm > 0.0:
            self._R[0] = start.r / start.norm

    @property
    def last_column(self) -> Array:
        """The last column of R, a unit vector, (n_Γ,)."""
        return self._R[self.k]

    def store(self, z: Array) -> None:
        """Store z = Π M r of the last column r of R, (n_Γ,)."""
        self._Z[self.k] = z

    def extend(self, Az: Array) -> bool:
        """Orthonormalise A z of the last z and append it to R. Collective.

        Args:
            Az: A z, (n_Γ,).

        Returns:
            False if A z is zero.
        """
        k = self.k
        self._H[: k + 2, k], self._R[k + 1] = _orthonormalised(self._copies, self._R[: k + 1], Az)
        if self._H[k + 1, k] == 0.0:
            return False
        h = self._H[:, k]
        self._a[k] = (h[0] - h[1 : k + 1] @ self._a[:k]) / h[k + 1]  # last row of Uᵀ a = h
        self.k = k + 1
        return True

    def residual_norm(self) -> float:
        """Return ‖r_k‖ = ‖r₀‖ (1 + aᵀ a)^−½."""
        return float(self._first_norm / np.sqrt(1.0 + self._a @ self._a))

    def correction(self) -> Array:
        """Return x_k − x₀ = ‖r₀‖ / (1 + aᵀ a) Z U⁻¹ a, (n_Γ,).

        If U is singular, the result is NaN, and the error is raised after the iterations.
        """
        k = self.k
        if k == 0:
            return np.zeros(self._Z.shape[1])
        a = self._a[:k]
        U = self._H[1 : k + 1, :k]
        # y = U⁻¹ a
        y = self._copies.errors.guard(lambda: scipy.linalg.solve_triangular(U, a), shape=k)
        return np.asarray(self._Z[:k].T @ (y * (self._first_norm / (1.0 + a @ a))))

    def preconditioned_residual(self) -> Array:
        """Return z of r_k = ‖r₀‖ / (1 + aᵀ a) (r̂₀ − Σ a_j r̂_{j+1}), (n_Γ,), from the stored Z.

        The columns of R are r̂_j.
        """
        k = self.k
        a = self._a[:k]
        factor = self._first_norm / (1.0 + a @ a)
        return np.asarray(factor * (self._Z[0] - a @ self._Z[1 : k + 1]))

    def basis(self, stored_iterations: int) -> KrylovBasis:
        """Return the vectors of the first iterations."""
        k = min(self.k, stored_iterations)
        return KrylovBasis(self._R[: k + 1], self._Z[:k], self._H[: k + 1, :k])


def _orthonormalised(copies: Copies, R: Array, t: Array) -> tuple[Array, Array]:
    """Orthonormalise an assembled vector to others by Gram–Schmidt, twice. Collective.

    It takes two reductions.

    Args:
        copies: Copies of the interface dofs.
        R: Orthonormal vectors r_j by copies, one in each row, (k, n_Γ).
        t: The vector by copies, (n_Γ,).

    Returns:
        Coefficients h with t = Σ h_j r_j, (k + 1,), and the new unit vector r_k, (n_Γ,). Its
        coefficient h_k is the norm of what R does not span; it is zero only if t = 0.
    """
    δ = copies.delta
    h = total_of(R @ (δ * t), copies.comm)
    t = t - h @ R
    sums = total_of(np.append(R @ (δ * t), t @ (δ * t)), copies.comm)
    second_h = sums[:-1]
    square = sums[-1]  # ‖t‖² between the two passes
    t = t - second_h @ R
    h = h + second_h
    t_norm = np.sqrt(h @ h + square)  # of the argument t
    # The difference of squares is below zero by rounding if R spans t.
    remaining_norm = np.sqrt(max(square - second_h @ second_h, (EPS * t_norm) ** 2))
    if remaining_norm > 0.0:
        t = t / remaining_norm
    return np.append(h, remaining_norm), t
