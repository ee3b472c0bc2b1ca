# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Recovery of the displacement u from (λ, s), with equal copies.

.. math:: u = K^+(f - B^⊤ λ) + E s, \qquad u ← u - E_Γ B_D^⊤ (B u - c)

(eq. 39; eq. 48 for s). The Krylov method leaves a jump between the copies. Averaging removes it,
and u is then a vector of the assembled problem.
"""

from __future__ import annotations

from dolfinx_feti.feti.dual.system import DualSystem, DualUnknowns
from dolfinx_feti.runtime.arrays import Array


def recover(system: DualSystem, unknowns: DualUnknowns, f: Array, c: Array) -> Array:
    """Return the displacement u of (λ, s), with equal copies. Collective.

    Args:
        system: The dual system.
        unknowns: λ and s. If D = 0, λ alone determines the balance, and s is replaced by the one
            with the smallest jump, in the norm of Q.
        f: Load on the dofs of K⁺, (n,).
        c: Gap, (m,).

    Returns:
        u on the dofs of K⁺, (n,).
    """
    u = system.inverse.solve(f - system.B.T @ unknowns.lam)  # K⁺ (f − Bᵀ λ)
    u += system.coarse.prolong(unknowns.s)  # u = K⁺ (f − Bᵀ λ) + E s
    jump = system.B @ u - c
    if system.has_exact_kernel:
        jump, w = system.project(jump)
        u -= system.coarse.prolong(w)  # s ← s − w
    return average_copies(system, u, jump)


def average_copies(system: DualSystem, u: Array, jump: Array) -> Array:
    """Remove the jump of a displacement by averaging its copies. Collective.

    Args:
        system: The dual system, with B_D and E_Γ.
        u: Displacement on the dofs of K⁺, (n,).
        jump: Its jump B u − c, (m,).

    Returns:
        u − E_Γ B_Dᵀ (B u − c), (n,).
    """
    w = system.preconditioner.B_D.T @ jump
    return u - system.preconditioner.extend(w)  # u ← u − E_Γ B_Dᵀ (B u − c)
