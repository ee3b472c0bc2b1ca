# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The contract of a Krylov method, and what all methods share: their start and the best iterate.

.. math:: A\, x = b, \qquad b = T^⊤ f, \qquad x_0 ∈ \operatorname{span}(V, W), \qquad z = Π M r

All residuals are orthogonal to the coarse space (V, W) of ``deflation``: that of the start
:math:`x_0` is, and the projection Π keeps the later ones so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from petsc4py import PETSc

from dolfinx_feti.feti.krylov_limits import STAGNATION_ITERATIONS
from dolfinx_feti.feti.monitor import Monitor
from dolfinx_feti.feti.primal.stopping import StoppingTest
from dolfinx_feti.feti.primal.system import PrimalSystem
from dolfinx_feti.feti.solve_info import KrylovInfo
from dolfinx_feti.runtime.arrays import Array

Reason = PETSc.KSP.ConvergedReason


@dataclass(frozen=True, slots=True)
class KrylovBasis:
    """Vectors of the first k iterations of a solve, from which Ritz vectors are computed.

    In the notation of columns, Z = Π M R_k and A Z = R H, where R_k are the first k columns of R.
    The arrays have a *row* for each vector, stored by copies.

    Attributes:
        R: Residuals in any scale, (k + 1, n_Γ).
        Z: The first k of them preconditioned, (k, n_Γ).
        H: Upper Hessenberg matrix, (k + 1, k).
    """

    R: Array
    Z: Array
    H: Array


class KrylovMethod(Protocol):
    """A Krylov method; collective.

    M is symmetric also if A is not. It is positive definite, unless the matrix K_ρ of a subdomain
    has a negative eigenvalue: a method that divides by rᵀ z has to test its sign, and ends with
    ``DIVERGED_INDEFINITE_PC`` if it is not positive.

    A method has to

    - begin with :func:`start_from_coarse_space`, which calls ``monitor(0, ‖r₀‖)``, and go on with
      :func:`~dolfinx_feti.feti.primal.krylov.iteration.iterate`, which calls ``monitor(k, ‖r_k‖)``
      once after iteration k and tests when the method ends,
    - apply A and M by ``system.apply`` and ``system.precondition`` only,
    - compute z from the residual in each iteration. z is accurate to single precision only
      (``coarse.products``). So a recurrence for z itself, such as z ← z − α M A p of conjugate
      residuals, cannot reduce ‖r‖ below some 1e-6 ‖r₀‖ (measured for a tube),
    - guard local work of an iteration that may fail on one process, by ``system.copies.errors``.
      The methods of ``system`` return NaN if they fail; ‖r‖ is then NaN, too, and ``stopping`` ends
      the method on all processes.
    """

    def __call__(
        self,
        system: PrimalSystem,
        f: Array,
        stopping: StoppingTest,
        *,
        monitor: Monitor,
        stored_iterations: int,
        allow_indefinite: bool,
    ) -> tuple[Array, KrylovInfo, KrylovBasis]:
        """Solve A x = Tᵀ f.

        Args:
            system: A and its preconditioner.
            f: Torn load, condensed to the interface and not summed over copies, (n_Γ,).
            stopping: When the method ends.
            monitor: Called with the number of iterations and ‖r‖.
            stored_iterations: Largest number of iterations whose vectors are stored. The basis has
                at most as many vectors Z, and may have none (k = 0).
            allow_indefinite: Whether the solution is wanted if A has negative eigenvalues; if not,
                a method that notices them ends with ``DIVERGED_INDEFINITE_MAT``. A method that does
                not depend on their signs ignores it.

        Returns:
            The solution by its copies, (n_Γ,): the iterate that meets the tolerances, or the one
            with the smallest residual.

            How the method ended: ``reason``, ``iterations``, and Ritz values if it knows them. If
            it has neither converged nor failed, the reason is ``ITERATING`` and
            ``needs_fresh_start`` is True. If it has converged and ``stopping.error_test`` is given,
            ``measured_error`` may have η and the residual that belongs to the solution, (n_Γ,), so
            that the caller need not measure η again. The method leaves all other fields at their
            defaults.

            The vectors of its first iterations.
        """


@dataclass(frozen=True, slots=True)
class KrylovStart:
    """The initial guess of a solve, and its residual.

    Attributes:
        x: Initial guess in the coarse space, (n_Γ,).
        r: Its residual b − A x, orthogonal to the coarse space, (n_Γ,).
        norm: ‖r‖.
    """

    x: Array
    r: Array
    norm: float


def start_from_coarse_space(system: PrimalSystem, f: Array, monitor: Monitor) -> KrylovStart:
    """Compute the initial guess of the coarse space and its residual. Collective.

    Args:
        system: A and its preconditioner.
        f: Torn load, condensed to the interface and not summed over copies, (n_Γ,).
        monitor: Called with 0 and ‖r‖.
    """
    x = system.deflation.initial_guess(system.copies.sum(f))
    r = system.residual(f, x)
    norm = system.norm(r)
    monitor(0, norm)
    return KrylovStart(x, r, norm)


class BestIterate:
    """The iterate with the smallest residual so far.

    Attributes:
        x: The iterate, (n_Γ,).
        norm: Its ‖r‖.
        its: Its number of iterations.
    """

    def __init__(self, start: KrylovStart) -> None:
        """Store the initial guess."""
        self.x = start.x
        self.norm = start.norm
        self.its = 0

    def update(self, x: Array, norm: float, its: int) -> None:
        """Store the iterate after ``its`` iterations, x with ‖r‖ = norm, if its ‖r‖ is smaller."""
        if norm < self.norm:
            self.x = x
            self.norm = norm
            self.its = its

    def is_stagnating(self, its: int) -> bool:
        """Return True if ``STAGNATION_ITERATIONS`` iterations have not lowered the residual."""
        return its - self.its >= STAGNATION_ITERATIONS
