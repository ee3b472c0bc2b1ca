# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Conjugate gradients on the assembled interface, for a symmetric A.

.. math:: p = z + β p, \quad q = A p, \quad α = \frac{r^⊤ z}{p^⊤ q}, \quad
          x ← x + α p, \quad r ← r - α q, \quad β = \frac{r^⊤ z}{r_{last}^⊤ z_{last}}

If A has negative eigenvalues, the coarse space shows it, or a direction with
:math:`p^⊤ A p < 0` beyond rounding does; the solve then ends, unless the caller allows an
indefinite A.

An iteration waits for all processes three times: in the coarse problem, for rᵀ z, and for the sums
that yield pᵀ A p, the next ‖r‖, and η.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import scipy.linalg

from dolfinx_feti.feti.monitor import Monitor
from dolfinx_feti.feti.primal.krylov.base import (
    BestIterate,
    KrylovBasis,
    KrylovStart,
    start_from_coarse_space,
)
from dolfinx_feti.feti.primal.krylov.iteration import FRESH_START, IterationEnd, iterate
from dolfinx_feti.feti.primal.stopping import InterfaceErrorTest, StoppingTest
from dolfinx_feti.feti.primal.system import PrimalSystem
from dolfinx_feti.feti.solve_info import ErrorMeasurement, KrylovInfo
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all

Reason = PETSc.KSP.ConvergedReason

#: Share of ‖r‖² below which ‖r − α q‖² is computed from the vector, which takes a reduction. Above,
#: ‖r‖² − 2 α rᵀ q + α² ‖q‖² takes none. Its rounding errors are about 1e-16 ‖r‖², so that eight
#: digits are correct at this share; with half or twice of it, 7.7 or 8.3.
CANCELLATION_SHARE = 1e-8

#: The error is estimated in an iteration, at the cost of two scalar products, if ‖r‖ is at most
#: this multiple of its target. An iteration rarely reduces ‖r‖ by more than a factor of ten. If one
#: jumps from above this multiple to the target, the error has not been estimated, and the solve
#: applies the preconditioner once more. Half and twice of it take as many applications on the
#: artery path (``primal/__init__``).
ESTIMATION_RANGE = 30.0

#: Number of directions of negative curvature that a solve steps along if the caller allows an
#: indefinite A. Near a limit point A has one or two negative eigenvalues that A₀ does not have.
#: A choice: one and four change no iteration on the artery path.
MAX_NEGATIVE_CURVATURES = 2


def conjugate_gradients(
    system: PrimalSystem,
    f: Array,
    stopping: StoppingTest,
    *,
    monitor: Monitor,
    stored_iterations: int,
    allow_indefinite: bool,
) -> tuple[Array, KrylovInfo, KrylovBasis]:
    """Solve A x = Tᵀ f for a symmetric A. Collective.

    Arguments and results are those of :class:`~dolfinx_feti.feti.primal.krylov.base.KrylovMethod`.
    The solution is the iterate that meets the tolerances, or otherwise the one with the smallest
    residual.

    Near the target, η of the iterate before each step is estimated along the way. The iterate after
    the step is accepted by this η. Its own error is not larger: (x − x_k)ᵀ M⁻¹ (x − x_k) decreases
    from one iterate to the next (Hestenes, Stiefel, Methods of conjugate gradients for solving
    linear systems, 1952, theorem 6:3, for preconditioned vectors).
    """
    start = start_from_coarse_space(system, f, monitor)
    cg = _Recurrences(
        system,
        start,
        stored_iterations=stored_iterations,
        max_negative_curvatures=MAX_NEGATIVE_CURVATURES if allow_indefinite else 0,
    )
    if system.deflation.is_indefinite and not allow_indefinite:
        end = IterationEnd(Reason.DIVERGED_INDEFINITE_MAT)
    else:
        end = iterate(cg, stopping, monitor)
    ritz_values = on_all(cg.lanczos.extreme_ritz_values, system.copies.comm)
    has_error = end.has_converged and not np.isnan(end.error_estimate)  # nan without error test
    info = KrylovInfo(
        end.reason,
        cg.its,
        ritz_values,
        needs_fresh_start=end.needs_fresh_start,
        measured_error=ErrorMeasurement(end.error_estimate, cg.r) if has_error else None,
    )
    return cg.x if end.has_converged else cg.best.x, info, cg.lanczos.basis()


@dataclass(frozen=True, slots=True)
class _ProductsOfStep:
    """Scalar products along a direction p with q = A p, and η of the iterate before the step.

    Attributes:
        pq: Curvature pᵀ A p.
        rr: ‖r‖².
        rq: rᵀ q.
        qq: ‖q‖².
        error_estimate: η; nan if it has not been estimated.
    """

    pq: float
    rr: float
    rq: float
    qq: float
    error_estimate: float


class _Recurrences:
    """Vectors of conjugate gradients, by copies, (n_Γ,): a :class:`~.iteration.KrylovIteration`.

    Attributes:
        x: Iterate.
        r: Its residual b − A x, by recursion.
        norm: ‖r‖.
        error_estimate: η of the iterate before x, which bounds that of x; nan if it has not been
            estimated along the way.
        best: Iterate with the smallest residual.
        lanczos: Coefficients and vectors of the iterations before.
    """

    def __init__(
        self,
        system: PrimalSystem,
        start: KrylovStart,
        *,
        stored_iterations: int,
        max_negative_curvatures: int,
    ) -> None:
        """Create the state at the initial guess.

        Args:
            system: A and its preconditioner.
            start: Initial guess and its residual.
            stored_iterations: Largest number of iterations whose vectors are stored.
            max_negative_curvatures: Largest number of steps along directions of negative curvature.
        """
        self._system = system
        self._negative_curvatures_left = max_negative_curvatures
        self.x = start.x
        self.r = start.r
        self.norm = start.norm
        self.error_estimate = np.nan
        self.best = BestIterate(start)
        self.lanczos = _LanczosRecord(stored_iterations, len(start.x))
        self._z = np.zeros_like(start.x)  # Π M r
        self._rz = np.nan  # rᵀ z
        self._last_rz = np.inf  # rᵀ z of the step before; inf so that the first step has β = 0
        self._p = np.zeros_like(start.x)  # direction

    @property
    def its(self) -> int:
        """Number of iterations, those that :meth:`step` has completed."""
        return self.lanczos.iterations

    def precondition(self) -> None:
        """Compute z = Π M r and rᵀ z. Collective."""
        self._z, self._rz = self._system.precondition(self.r)

    def preconditioned_residual(self) -> Array:
        """Return z of the iterate, (n_Γ,)."""
        return self._z

    def iterate(self) -> Array:
        """Return the iterate x, (n_Γ,)."""
        return self.x

    def step(self, stopping: StoppingTest) -> IterationEnd | None:
        """Compute p = z + β p and q = A p, and step along p. Collective.

        Args:
            stopping: Its test of η is used near the target.

        Returns:
            None after a step, otherwise how the method ends at x.
        """
        if self._rz <= 0.0:
            return IterationEnd(Reason.DIVERGED_INDEFINITE_PC)
        β = self._rz / self._last_rz
        self._p = self._z + β * self._p
        q = self._system.apply(self._p)
        is_near_target = stopping.target < self.norm <= ESTIMATION_RANGE * stopping.target
        products = self._products(q, stopping.error_test if is_near_target else None)
        if products.pq <= 0.0:
            if not self._system.deflation.proves_indefinite(self._p, products.pq):
                return FRESH_START
            if self._negative_curvatures_left == 0:
                return IterationEnd(Reason.DIVERGED_INDEFINITE_MAT)
            self._negative_curvatures_left -= 1
        α = self._rz / products.pq
        self.lanczos.append(α, β, self.r, self._z, self._rz)
        self._update(α, q, products)
        self._last_rz = self._rz
        return None

    def needs_fresh_start(self, stopping: StoppingTest) -> bool:
        """Return True if the last iterations have not reduced ‖r‖."""
        return self.best.is_stagnating(self.its)

    def _products(self, q: Array, error_test: InterfaceErrorTest | None) -> _ProductsOfStep:
        """Compute the scalar products of the iteration, and η, in one reduction. Collective.

        Args:
            q: A p, (n_Γ,).
            error_test: Test of η, which adds two sums to the reduction; None to leave it out.
        """
        copies = self._system.copies
        pairs = ((self._p, q), (self.r, self.r), (self.r, q), (q, q))
        η = np.nan
        if error_test is None:
            pq, rr, rq, qq = copies.dots(*pairs)
        else:
            (pq, rr, rq, qq), squares = copies.dots_and_sums(
                pairs, error_test.squares(self._z, self.x)
            )
            η = error_test.estimate_from(squares)
        return _ProductsOfStep(pq=pq, rr=rr, rq=rq, qq=qq, error_estimate=η)

    def _update(self, α: float, q: Array, products: _ProductsOfStep) -> None:
        """Compute x + α p, r − α q, its norm, and what is known of x. Collective.

        Args:
            α: Step length.
            q: A p, (n_Γ,).
            products: Scalar products of the step.
        """
        self.x = self.x + α * self._p
        self.r = self.r - α * q
        square = products.rr - α * (2.0 * products.rq - α * products.qq)  # ‖r − α q‖²
        if square > CANCELLATION_SHARE * products.rr:
            self.norm = float(np.sqrt(square))
        else:
            self.norm = self._system.norm(self.r)
        self.error_estimate = products.error_estimate
        self.best.update(self.x, self.norm, self.its)


class _LanczosRecord:
    """The coefficients of conjugate gradients, and the vectors of the first iterations."""

    def __init__(self, stored_iterations: int, n: int) -> None:
        """Reserve address space for the vectors: a row takes memory only when it is written.

        Args:
            stored_iterations: Largest number of iterations whose vectors are stored.
            n: Length of a vector.
        """
        self._α: list[float] = []
        self._β: list[float] = []
        self._stored_iterations = stored_iterations
        self._R = np.empty((stored_iterations, n))
        self._Z = np.empty((stored_iterations, n))

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self._α)

    def append(self, α: float, β: float, r: Array, z: Array, rz: float) -> None:
        """Store an iteration; its vectors are scaled to rᵀ z = 1.

        Args:
            α: Step length along the direction p.
            β: Coefficient of the direction before in p.
            r: Residual before the step, (n_Γ,).
            z: Preconditioned residual Π M r, (n_Γ,).
            rz: rᵀ z.
        """
        k = self.iterations
        if k < self._stored_iterations:
            self._R[k] = r / np.sqrt(rz)
            self._Z[k] = z / np.sqrt(rz)
        self._α.append(α)
        self._β.append(β)

    def basis(self) -> KrylovBasis:
        """Return the stored vectors.

        The product of A with the last stored z contains the residual after it, which is not stored.
        Therefore Z has one vector less than R.
        """
        k = min(self.iterations, self._stored_iterations)
        H = _hessenberg(np.array(self._α[:k]), np.array(self._β[:k]))
        return KrylovBasis(self._R[:k], self._Z[: max(k - 1, 0)], H)

    def extreme_ritz_values(self) -> tuple[float, float]:
        """Return the extreme eigenvalues of Lanczos' tridiagonal matrix; nan if not known."""
        if not self._α or not np.all(np.isfinite(self._α)):
            return np.nan, np.nan
        α = np.array(self._α)
        β = np.array(self._β[1:])
        diagonal = 1.0 / α
        diagonal[1:] += β / α[:-1]
        ritz = scipy.linalg.eigvalsh_tridiagonal(diagonal, np.sqrt(β) / α[:-1])
        return float(ritz[0]), float(ritz[-1])


def _hessenberg(α: Array, β: Array) -> Array:
    """Return H with A Z = R H, (k + 1, k), for k + 1 iterations scaled to r_jᵀ z_j = 1.

    With σ_j = (r_jᵀ z_j)^½ before scaling, R has the columns r_j / σ_j, Z has z_j / σ_j, and the
    directions are P with the columns p_j / σ_j. The recurrences r_{j+1} = r_j − α_j A p_j and
    p_j = z_j + β_j p_{j−1} with β_j = (σ_j / σ_{j−1})² become

        A p_j / σ_j = (r_j / σ_j − √β_{j+1} r_{j+1} / σ_{j+1}) / α_j,   A P = R L,
        z_j / σ_j   = p_j / σ_j − √β_j p_{j−1} / σ_{j−1},              Z = P U,

    and hence A Z = R L U with a lower and an upper bidiagonal matrix.

    Args:
        α: Step length of each iteration, (k + 1,).
        β: Its coefficient of the direction before, (k + 1,).
    """
    k = max(len(α) - 1, 0)
    root = np.sqrt(β)
    L = (np.eye(k + 1, k) - np.diag(root[1:], -1)[:, :k]) / α[:k]
    U = np.eye(k) - np.diag(root[1:k], 1)
    return L @ U
