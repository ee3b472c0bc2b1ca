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

import numpy as np
import scipy.linalg

from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.krylov_limits import GMRES_DIRECTIONS
from dolfinx_feti.feti.monitor import Monitor
from dolfinx_feti.feti.primal.krylov.base import KrylovBasis, KrylovStart, start_from_coarse_space
from dolfinx_feti.feti.primal.krylov.iteration import FRESH_START, IterationEnd, iterate
from dolfinx_feti.feti.primal.stopping import StoppingTest
from dolfinx_feti.feti.primal.system import PrimalSystem
from dolfinx_feti.feti.solve_info import KrylovInfo
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.torn.rounding import EPS


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
    iteration = _Iteration(system, start, max_k=min(stopping.max_it, GMRES_DIRECTIONS))
    end = iterate(iteration, stopping, monitor)
    info = KrylovInfo(end.reason, iteration.its, needs_fresh_start=end.needs_fresh_start)
    x = iteration.iterate() if np.isfinite(iteration.norm) else start.x
    return x, info, iteration.arnoldi.basis(stored_iterations)


class _Iteration:
    """The iterates of GMRES: a :class:`~.iteration.KrylovIteration`.

    Attributes:
        norm: ‖r‖.
        arnoldi: R, Z and H.
        error_estimate: Always nan: η is not estimated along the way.
    """

    error_estimate = np.nan

    def __init__(self, system: PrimalSystem, start: KrylovStart, *, max_k: int) -> None:
        """Start from the initial guess.

        Args:
            system: A and its preconditioner.
            start: Initial guess and its residual.
            max_k: Largest number of iterations.
        """
        self._system = system
        self._start = start
        self._max_k = max_k
        self.norm = start.norm
        self.arnoldi = _ArnoldiBasis(system.copies, start, max_k)

    @property
    def its(self) -> int:
        """Number of iterations."""
        return self.arnoldi.k

    def precondition(self) -> None:
        """Compute and store Π M r of the last column r of R. Collective."""
        z, _ = self._system.precondition(self.arnoldi.last_column)
        self.arnoldi.store(z)

    def preconditioned_residual(self) -> Array:
        """Return z of the iterate, (n_Γ,)."""
        return self.arnoldi.preconditioned_residual()

    def iterate(self) -> Array:
        """Return the iterate x, (n_Γ,)."""
        return self._start.x + self.arnoldi.correction()

    def step(self, stopping: StoppingTest) -> IterationEnd | None:
        """Append A z to the basis. Collective.

        Returns:
            None after a step, otherwise how the method ends at x.
        """
        if self.its == self._max_k:
            return FRESH_START  # ‖r‖ has reached its target, but η has not
        if not self.arnoldi.extend(self._system.apply(self.arnoldi.last_preconditioned)):
            return FRESH_START  # A z is zero: the basis cannot grow
        self.norm = self.arnoldi.residual_norm()
        return None

    def needs_fresh_start(self, stopping: StoppingTest) -> bool:
        """Return True if the basis is full and there is nothing to measure.

        The basis is full after ``max_k`` iterations. If ``max_k`` equals ``max_it``, the stopping
        test ends the method instead. If ‖r‖ has met its target, η has yet to be measured. Otherwise
        the last column needs no z.
        """
        is_full = self.its == self._max_k
        has_iterations_left = self._max_k < stopping.max_it
        return is_full and has_iterations_left and stopping.target < self.norm < np.inf


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

    @property
    def last_preconditioned(self) -> Array:
        """Stored z = Π M r of the last column r of R, (n_Γ,)."""
        return self._Z[self.k]

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
