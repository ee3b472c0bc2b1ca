# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""From loads to the dual right-hand side, and from (λ, s) back to the displacement.

.. math:: d = B K^+ f - c, \quad e = E^⊤ f, \qquad u = K^+(f - B^⊤ λ) + E s

(eq. 39, Augustin_eq:localSolutions; eq. 47 for the start, eq. 48 for s), on the interface alone
where the interior is eliminated. The copies that the Krylov method leaves apart are averaged,
:math:`u ← u - E_Γ B_D^⊤ (B u - c)`, and then one vector of the assembled problem holds u.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.setup import Parts
from dolfinx_feti.torn import Torn

__all__ = ["balanced_start", "load", "recover", "residual"]

Array = npt.NDArray[np.float64]


def load(parts: Parts, r: PETSc.Vec, u_D: Array) -> Array:
    """Share an assembled right-hand side among the copies, f = δ T r, (n,).

    Fixed dofs (classical FETI) have no equation; their prescribed values move to the right.

    Args:
        parts: The FETI system.
        r: Assembled right-hand side, (N,).
        u_D: Prescribed values on the torn Dirichlet dofs, (n,).
    """
    torn, fixed = parts.torn, parts.inverse.fixed
    f = parts.gluing.delta * torn.tear(r)
    f -= torn.multiply(np.where(fixed, u_D, 0.0))
    f[torn.dirichlet] = 0.0
    return f


def balanced_start(parts: Parts, f: Array, c: Array) -> tuple[Array, Array]:
    """Find a balanced pair and the jump that it leaves.

    Args:
        parts: The FETI system.
        f: Torn load on the dofs of the dual method, (n,).
        c: Gap, (m,).

    Returns:
        The pair :math:`s_0 = N^{-1} e, λ_0 = Q G s_0`, with :math:`G^⊤ λ_0 + D s_0 = e`, (m + K,),
        and the right-hand side (d − F λ₀ + G s₀, 0) of its correction, (m + K,). For D = 0 any s is
        balanced, and s₀ is the best for λ₀.
    """
    dual, coarse = parts.dual, parts.coarse
    s = coarse.solve(coarse.restrict(f))  # s₀ = N⁻¹ e, e = Eᵀ f
    pair = np.concatenate([dual.weighted_jump(s), s])  # λ₀ = Q G s₀
    d = dual.B @ parts.inverse.solve(f) - c  # d = B K⁺ f − c
    r = d - dual.jump(pair)  # d − F λ₀ + G s₀
    if dual.exact:
        r, w = dual.project(r)
        pair[dual.m :] += w
    return pair, np.concatenate([r, np.zeros(len(s))])


def recover(parts: Parts, pair: Array, f: Array, u_D: Array) -> Array:
    """Recover the displacement from multipliers and coarse unknowns.

    Args:
        parts: The FETI system.
        pair: (λ, s), (m + K,).
        f: Torn load, (n,).
        u_D: Prescribed values on the torn Dirichlet dofs, (n,).

    Returns:
        u with single-valued copies, (n,).
    """
    dual, coarse, fixed = parts.dual, parts.coarse, parts.inverse.fixed
    lam, s = dual.split(pair)
    u = parts.inverse.solve(parts.interior.condense(f) - dual.B.T @ lam)
    u += coarse.prolong(s)  # u = K⁺ (f − Bᵀ λ) + E s
    jump = dual.B @ u - parts.gluing.gap(u_D)  # B u − c
    if dual.exact:
        jump, w = dual.project(jump)
        u -= coarse.prolong(w)  # s, at last
    w = parts.preconditioner.B_D.T @ jump
    u -= parts.preconditioner.extend(w)  # u ← u − E_Γ B_Dᵀ (B u − c)
    u = parts.interior.extend(u, f)
    u[fixed] = u_D[fixed]
    return u


def residual(torn: Torn, b: PETSc.Vec, x: PETSc.Vec) -> PETSc.Vec:
    """Return b − A x on the free dofs of the assembled problem, zero on the Dirichlet dofs.

    Args:
        torn: The torn matrix.
        b: Right-hand side, (N,).
        x: Solution, (N,).

    Returns:
        The residual, (N,); the caller destroys it.
    """
    r = b.duplicate()
    force = torn.multiply(torn.tear(x))
    free = torn.assemble(torn.dirichlet.astype(np.float64)) < 0.5
    r.array[:] = np.where(free, b.array_r - torn.assemble(force), 0.0)  # b − Tᵀ K T x
    return r
