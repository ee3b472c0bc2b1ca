# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""GMRES on the assembled interface, for an unsymmetric matrix (docs/theory.md).

.. math:: z_j = Π\, T^⊤ δ\, K_ρ^{-1} δ\, T q_j, \quad A Z_k = Q_{k+1} H, \quad a = R^{-⊤} h, \quad
          \|r_k\| = \|r_0\| (1 + a^⊤ a)^{-1/2}

with the preconditioner of ``cg`` for the symmetric part, an orthonormal basis Q of residuals, and
the first row h of H above the triangle R (Saad and Schultz 1986; Ayachour 2003). It keeps two
interface vectors an iteration, up to :data:`RESTART`; then a fresh start follows.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import scipy.linalg

from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.primal.cg import PrimalSystem, converged_reason
from dolfinx_feti.feti.primal.deflation import Trace
from dolfinx_feti.feti.solution import RESTART, Monitor, Solution
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import deferred, total_of
from dolfinx_feti.torn.rounding import EPS

__all__ = ["gmres"]

Reason = PETSc.KSP.ConvergedReason


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
    if not (reason := converged_reason(norm, target, 0, max_it)):
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
        reason = converged_reason(norm, target, k, max_it)
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
