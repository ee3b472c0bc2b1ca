# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""From loads to the dual right-hand side, and from (λ, s) back to the displacement.

.. math:: d = B K^+ f - c, \quad e = E^⊤ f, \qquad u = K^+(f - B^⊤ λ) + E s

(eq. 39, Augustin_eq:localSolutions), on the interface alone where the interior is eliminated. The
copies that the Krylov method leaves apart are averaged, :math:`u ← u - E_Γ B_D^⊤ (B u - c)`, and
then one vector of the assembled problem holds u.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.setup import Parts
from dolfinx_feti.torn import Torn

__all__ = ["load", "recover", "residual", "start"]

Array = npt.NDArray[np.float64]


def load(parts: Parts, r: PETSc.Vec, u_D: Array) -> Array:
    """Share an assembled right-hand side among the copies, f = δ T r, (n,).

    Fixed dofs (classical FETI) have no equation; their prescribed values move to the right.
    """
    f = parts.gluing.delta * parts.torn.tear(r)
    f -= parts.torn.multiply(np.where(parts.inverse.fixed, u_D, 0.0))
    f[parts.torn.dirichlet] = 0.0
    return f


def start(parts: Parts, f: Array, c: PETSc.Vec) -> tuple[PETSc.Vec, PETSc.Vec]:
    """Find a balanced pair and put the jump that it leaves into the Krylov method.

    Args:
        parts: The FETI system.
        f: Torn load on the dofs of the dual method, (n,).
        c: Gap, (m,).

    Returns:
        :math:`s_0 = N^{-1} e, λ_0 = Q G s_0`, with :math:`G^⊤ λ_0 + D s_0 = e`, as (λ₀, s₀). For
        D = 0 any s is balanced, and s₀ is the best for λ₀.
    """
    B, coarse, v = parts.gluing.B, parts.coarse, parts.operator.vector
    e = coarse.restrict(f)  # e = Eᵀ f
    coarse.solve(e, v.s)  # s₀ = N⁻¹ e
    coarse.QG.mult(v.s, v.lam)  # λ₀ = Q G s₀
    pair = v.lam.copy(), v.s.copy()
    r = c.duplicate()
    parts.operator.jump(r)
    r.axpy(1.0, c)
    u = np.zeros_like(f)
    parts.inverse.solve(f, u)
    torn = B.createVecRight()
    torn.array[:] = u
    r.scale(-1.0)
    B.multAdd(torn, r, r)  # d − F λ₀ + G s₀, d = B K⁺ f − c
    if coarse.exact:
        pair[1].axpy(-1.0, parts.constraint.project(r))
    r.copy(v.lam)
    v.s.set(0.0)
    v.write(parts.krylov.b)
    for owned in (e, r, torn):
        owned.destroy()
    return pair


def recover(parts: Parts, pair: tuple[PETSc.Vec, PETSc.Vec], f: Array, u_D: Array) -> Array:
    """Recover the displacement from the correction of (λ, s) that the Krylov method holds.

    Args:
        parts: The FETI system.
        pair: The start (λ₀, s₀); destroyed.
        f: Torn load, (n,).
        u_D: Prescribed values on the torn Dirichlet dofs, (n,).

    Returns:
        u with single-valued copies, (n,).
    """
    condensed = parts.matrices.condense(f)
    v, B = parts.operator.vector, parts.gluing.B
    v.read(parts.krylov.x)
    for part, first in zip((v.lam, v.s), pair, strict=True):
        part.axpy(1.0, first)
        first.destroy()
    t = B.createVecRight()
    B.multTranspose(v.lam, t)
    u = np.zeros_like(f)
    parts.inverse.solve(condensed - t.array_r, u)
    u += parts.coarse.prolong(v.s)  # u = K⁺ (f − Bᵀ λ) + E s
    t.array[:] = u
    jump = parts.gluing.gap(u_D)
    jump.scale(-1.0)
    B.multAdd(t, jump, jump)  # B u − c
    if parts.coarse.exact:
        u += parts.coarse.prolong(parts.constraint.project(jump))  # s, at last
    parts.gluing.B_D.multTranspose(jump, t)
    u -= parts.preconditioner.extend(t.array_r)  # u ← u − E_Γ B_Dᵀ (B u − c)
    u = parts.matrices.extend(u, f)
    u[parts.inverse.fixed] = u_D[parts.inverse.fixed]
    t.destroy()
    jump.destroy()
    return u


def residual(torn: Torn, b: PETSc.Vec, x: PETSc.Vec) -> PETSc.Vec:
    """Return b − A x on the free dofs of the assembled problem, zero on the Dirichlet dofs."""
    r = b.duplicate()
    force = torn.multiply(torn.tear(x))
    free = torn.assemble(torn.dirichlet.astype(np.float64)) < 0.5
    r.array[:] = np.where(free, b.array_r - torn.assemble(force), 0.0)  # b − Tᵀ K T x
    return r
