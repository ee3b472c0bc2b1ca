# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The dual system and its preconditioner, in the pair (λ, s) (docs/theory.md).

.. math:: \begin{pmatrix} F & -G \\ -G^⊤ & -D \end{pmatrix}
          \begin{pmatrix} λ \\ s \end{pmatrix} = \begin{pmatrix} d \\ -e \end{pmatrix}, \qquad
          w = N^{-1} G^⊤ Q\, r, \quad y = M (r - G w), \quad v = N^{-1}(G^⊤ y - D w), \quad
          z = (y - Q G v,\; -w - v)

(eq. 41; eq. 42, Augustin_eq:classicalFetiF; eq. 43). For D = 0, and no M in Q, CG leaves s as it is
(``frozen``; eq. 45, Augustin_eq:dualProblem), or its rounding errors might grow.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.dual.coarse import Coarse
from dolfinx_feti.feti.dual.preconditioner import LinearMap, Preconditioner
from dolfinx_feti.feti.gluing.jump import Gluing
from dolfinx_feti.feti.subdomain.pseudoinverse import PseudoInverse
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import total


class DualSystem:
    """The dual system and its constraint preconditioner on the local parts of (λ, s), (m + K,).

    Attributes:
        comm: Communicator of the torn matrix.
        m: Multipliers of this process.
        size: Multipliers and coarse unknowns of this process, m + K.
        exact: Whether D = 0, so that s may change alone.
        frozen: Whether the preconditioner leaves s as it is.
        B: Jumps, (m, n).
        G: B E, (m, K).
        norm: Residual of the assembled system that the vector which was last preconditioned leaves.
    """

    def __init__(
        self,
        gluing: Gluing,
        inverse: PseudoInverse,
        preconditioner: Preconditioner,
        coarse: Coarse,
        *,
        cg: bool,
    ) -> None:
        """Take B, K⁺, M, and G, Q, D and N, for CG or another method."""
        self._inverse = inverse
        self._M = preconditioner
        self._coarse = coarse
        self._torn = preconditioner.operator.torn
        self.comm = self._torn.comm
        self.exact = coarse.exact
        self.frozen = cg and coarse.MG is None and coarse.exact
        self.B, self.G = LinearMap(gluing.B), LinearMap(coarse.G)
        self._D, self._q = LinearMap(coarse.D), coarse.q.array_r.copy()
        self.m = self.B.shape[0]
        self.size = self.m + coarse.size
        self.norm = np.inf

    # -- the system -------------------------------------------------------------------------------

    def split(self, x: Array) -> tuple[Array, Array]:
        """Return views of λ, (m,), and s, (K,)."""
        return x[: self.m], x[self.m :]

    def flexibility(self, lam: Array) -> Array:
        """Apply the flexibility, F λ = B K⁺ Bᵀ λ, (m,)."""
        return self.B @ self._inverse.solve(self.B.T @ lam)  # B K⁺ Bᵀ λ

    def jump(self, x: Array) -> Array:
        """Compute the jump of pairs, F λ − G s, (m + K,) → (m,)."""
        lam, s = self.split(x)
        return self.flexibility(lam) - self.G @ s  # F λ − G s

    def weighted_jump(self, s: Array) -> Array:
        """Return Q G s, (K,) → (m,)."""
        diagonal = self._q * (self.G @ s)  # q G s
        MG = self._coarse.MG
        return diagonal if MG is None else diagonal + MG.multiply(s)

    def multiply(self, x: Array) -> Array:
        """Apply the dual system to a balanced pair, (F λ − G s, 0).

        The second part, Gᵀ λ + D s, is zero up to rounding, which must not enter a Krylov method.
        """
        return np.concatenate([self.jump(x), np.zeros(self.size - self.m)])

    # -- PETSc's calls ----------------------------------------------------------------------------

    def mult(self, _mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the system."""
        y.array[:] = self.multiply(x.array_r)

    def apply(self, _pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Apply the preconditioner."""
        z.array[:], self.norm = self.precondition(r.array_r)

    # -- its preconditioner -----------------------------------------------------------------------

    def precondition(self, x: Array) -> tuple[Array, float]:
        """Apply the constraint preconditioner to a residual (r, 0); return z, (m + K,), and ‖Tᵀ t‖.

        That is the residual of the assembled system which r leaves once s is best. Collective.
        """
        r, w = self.project(x[: self.m])
        y, t = self._M.apply(r)  # y = M (r − G w)
        if self._coarse.MG is not None:
            return np.concatenate([y + self._q * r, -w]), self._norm(t)  # (Q (r − G w), −w)
        e = self.G.T @ y - self._D @ w
        v, square = self._coarse.solve_and_sum(e, self._square(t))  # v = N⁻¹ (Gᵀ y − D w)
        s = np.zeros_like(w) if self.frozen else -w - v
        z = np.concatenate([y - self.weighted_jump(v), s])  # (y − Q G v, −w − v)
        return z, float(np.sqrt(square))

    def project(self, r: Array) -> tuple[Array, Array]:
        """Take from a jump what a motion of the kernels can remove, r − G w; return it and w."""
        e = self._restrict(r)
        w = self._coarse.solve(e)  # w = N⁻¹ Gᵀ Q r
        return r - self.G @ w, w

    def unbalanced(self, x: Array) -> float:
        """Return the residual of the assembled system, ‖Tᵀ t‖, that a residual (r, 0) leaves."""
        r = self.project(x[: self.m])[0] if self.exact else x[: self.m]
        return self._norm(self._M.apply(r)[1])

    def _restrict(self, r: Array) -> Array:
        """Return Gᵀ Q r, (m,) → (K,)."""
        weighed, MG = self.G.T @ (self._q * r), self._coarse.MG
        return weighed if MG is None else weighed + MG.restrict(r)

    def _norm(self, t: Array) -> float:
        """Return ‖Tᵀ t‖ on the free dofs for a torn force, (n,)."""
        return float(np.sqrt(total(self._square(t), self.comm)))

    def _square(self, t: Array) -> float:
        """Return the process's part of ‖Tᵀ t‖²."""
        force = self._torn.assemble(np.where(self._torn.dirichlet, 0.0, t))
        return float(force @ force)

    def destroy(self) -> None:
        """Free the work vectors."""
        for owned in (self.B, self.G, self._D):
            owned.destroy()
