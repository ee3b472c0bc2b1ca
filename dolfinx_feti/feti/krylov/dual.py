# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The dual system and its preconditioner, in the pair (λ, s).

.. math:: \begin{pmatrix} F & -G \\ -G^⊤ & -D \end{pmatrix}
          \begin{pmatrix} λ \\ s \end{pmatrix} =
          \begin{pmatrix} d \\ -e \end{pmatrix}, \qquad
          F = B K^+ B^⊤, \quad d = B K^+ f - c

is the paper's system (eq. 42, Augustin_eq:classicalFetiF) with the defect D of the kernels in its
corner (``pseudoinverse``). The first residual is the jump :math:`r = B u - c`, the second the
balance of the subdomains. The *constraint preconditioner* keeps the second one zero in every
iterate, so that a Krylov method only sees the jump; with :math:`N = G^⊤ Q G + D` it is

.. math:: w = N^{-1} G^⊤ Q r, \quad y = M (r - G w), \quad v = N^{-1}(G^⊤ y - D w), \quad
          z = (y - Q G v,\; -w - v).

For D = 0 its λ-part is :math:`P M P^⊤ r`, the projected method of the paper
(eq. 45, Augustin_eq:dualProblem), in which s plays no part before the end: conjugate gradients then
leave s as it is (``frozen``), because where the spectrum of M F is far from one their rounding
errors in s grow without bound.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.coarse.coarse import Coarse
from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.preconditioner.preconditioner import Preconditioner
from dolfinx_feti.feti.subdomain.pseudoinverse import PseudoInverse

__all__ = ["ConstraintPreconditioner", "DualOperator", "DualVector"]

Array = npt.NDArray[np.float64]


class DualVector:
    """The two parts of a vector (λ, s), copied in and out of one PETSc vector.

    Attributes:
        lam: Multipliers, (m,).
        s: Coarse unknowns, (K,).
        comm: Their processes.
    """

    def __init__(self, gluing: Gluing, coarse: Coarse) -> None:
        self.lam = gluing.B.createVecLeft()
        self.s = coarse.N.createVecRight()
        self._m = self.lam.getLocalSize()
        self.comm = self.lam.comm.tompi4py()

    def read(self, x: PETSc.Vec) -> None:
        """Split x into λ and s."""
        values = x.array_r
        self.lam.array[:] = values[: self._m]
        self.s.array[:] = values[self._m :]

    def write(self, x: PETSc.Vec) -> None:
        """Join λ and s in x."""
        x.array[:] = np.concatenate([self.lam.array_r, self.s.array_r])

    def create(self) -> PETSc.Vec:
        """Allocate a joined vector, (m + K,)."""
        n = self._m + self.s.getLocalSize()
        return PETSc.Vec().createMPI((n, None), comm=self.lam.comm)

    def destroy(self) -> None:
        """Free both parts."""
        self.lam.destroy()
        self.s.destroy()


class DualOperator:
    """The dual system as a context of a PETSc matrix.

    Attributes:
        vector: Splits and joins (λ, s).
    """

    def __init__(
        self, gluing: Gluing, inverse: PseudoInverse, coarse: Coarse, vector: DualVector
    ) -> None:
        self._B = gluing.B
        self._inverse = inverse
        self._coarse = coarse
        self.vector = vector
        self._torn = gluing.B.createVecRight()
        self._u = gluing.B.createVecRight()
        self._jump = gluing.B.createVecLeft()

    def mult(self, _mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the dual system to a balanced pair, (F λ − G s, 0)."""
        v = self.vector
        v.read(x)
        self.jump(self._jump)
        self._jump.copy(v.lam)
        v.s.set(0.0)  # Gᵀ λ + D s = 0 up to rounding, which must not enter the Krylov method
        v.write(y)

    def jump(self, y: PETSc.Vec) -> None:
        """Compute the jump of the pair that ``vector`` holds, y = F λ − G s."""
        v = self.vector
        self.flexibility(v.lam, y)  # F λ
        v.s.scale(-1.0)
        self._coarse.G.multAdd(v.s, y, y)  # F λ − G s
        v.s.scale(-1.0)

    def flexibility(self, lam: PETSc.Vec, jump: PETSc.Vec) -> None:
        """Apply the flexibility F = B K⁺ Bᵀ."""
        self._B.multTranspose(lam, self._torn)  # Bᵀ λ
        u = np.zeros(self._u.getLocalSize())
        self._inverse.solve(self._torn.array_r, u)  # K⁺ Bᵀ λ
        self._u.array[:] = u
        self._B.mult(self._u, jump)  # B K⁺ Bᵀ λ

    def jumps(self, pairs: Array) -> Array:
        """Compute the jumps of many pairs at once, F Λ − G S, (m + K, r) → (m, r)."""
        v, jump = self.vector, self._jump
        m, r = v.lam.getLocalSize(), pairs.shape[1]
        t = np.empty((self._torn.getLocalSize(), r), order="F")
        for j in range(r):
            v.lam.array[:] = pairs[:m, j]
            self._B.multTranspose(v.lam, self._torn)
            t[:, j] = self._torn.array_r  # Bᵀ Λ
        u = self._inverse.solve_many(t)  # K⁺ Bᵀ Λ
        jumps = np.empty((m, r), order="F")
        for j in range(r):
            self._u.array[:] = u[:, j]
            v.s.array[:] = -pairs[m:, j]
            self._B.mult(self._u, jump)
            self._coarse.G.multAdd(v.s, jump, jump)
            jumps[:, j] = jump.array_r  # B K⁺ Bᵀ Λ − G S
        return jumps

    def destroy(self, _mat: PETSc.Mat | None = None) -> None:
        """Free the work vectors."""
        for owned in (self._torn, self._u, self._jump):
            owned.destroy()


class ConstraintPreconditioner:
    """The constraint preconditioner as a context of a PETSc preconditioner.

    Attributes:
        imbalance: Norm of the residual of the assembled system that the jump last preconditioned
            leaves once s is best, ‖Tᵀ t‖ for r − G w, see ``preconditioner``.
        exact: Whether D = 0, so that s may change alone.
        frozen: Whether s is left as it is.
    """

    def __init__(
        self, preconditioner: Preconditioner, coarse: Coarse, vector: DualVector, *, q_has_m: bool
    ) -> None:
        self._M = preconditioner
        self._coarse = coarse
        self._v = vector
        self._q_has_m = q_has_m
        self.exact = coarse.exact
        self.frozen = False
        self._y = vector.lam.duplicate()
        self._qr = vector.lam.duplicate()
        self._w = vector.s.duplicate()
        self._e = vector.s.duplicate()
        self.imbalance = np.inf

    def apply(self, _pc: PETSc.PC | None, x: PETSc.Vec, z: PETSc.Vec) -> None:
        """Apply the constraint preconditioner to a residual whose second part is zero."""
        coarse, vector, y, w, e = self._coarse, self._v, self._y, self._w, self._e
        vector.read(x)
        r, s = vector.lam, vector.s
        self.project(r)
        self._M.mult(r, y)  # y = M (r − G w)
        self._measure(r)
        coarse.D.mult(w, e)
        coarse.G_left.multTransposeAdd(y, e, e)
        coarse.solve(e, s)  # v = N⁻¹ (Gᵀ y − D w), the sign of w turned
        s.scale(-1.0)
        coarse.QG.multAdd(s, y, r)  # z_λ = y − Q G v
        s.axpy(1.0, w)  # z_s = −w − v
        if self.frozen:
            s.set(0.0)
        vector.write(z)

    def force(self, x: PETSc.Vec) -> float:
        """Return the residual of the assembled system, ‖Tᵀ t‖, that a jump leaves."""
        self._v.read(x)
        if self.exact:
            self.project(self._v.lam)
        self._M.mult(self._v.lam, self._y)
        self._measure(self._v.lam)
        return self.imbalance

    def project(self, r: PETSc.Vec) -> PETSc.Vec:
        """Take from a jump what a motion of the kernels can remove, r ← r − G w; return −w."""
        coarse, w, qr = self._coarse, self._w, self._qr
        if coarse.G_left is coarse.G:
            coarse.QG.multTranspose(r, self._e)
        else:
            self._M.mult(r, self._y)
            qr.pointwiseMult(coarse.q, r)
            qr.axpy(float(self._q_has_m), self._y)  # Q r
            coarse.G_left.multTranspose(qr, self._e)
        coarse.solve(self._e, w)  # w = N⁻¹ Gᵀ Q r
        w.scale(-1.0)
        coarse.G.multAdd(w, r, r)
        return w

    def balance(self, lam: Array) -> Array:
        """Balance multipliers, (m, r) → (m + K, r): (Λ − Q G V, −V) with V = N⁻¹ Gᵀ Λ.

        For D = 0 any s is balanced, and zero is taken.
        """
        coarse, y, v = self._coarse, self._y, self._w
        m, r = lam.shape
        pairs = np.zeros((m + v.getLocalSize(), r), order="F")
        for j in range(r):
            y.array[:] = lam[:, j]
            coarse.G_left.multTranspose(y, self._e)
            coarse.solve(self._e, v)  # v = N⁻¹ Gᵀ λ
            v.scale(-1.0)
            coarse.QG.multAdd(v, y, y)
            pairs[:m, j] = y.array_r  # λ − Q G v
            if not self.exact:
                pairs[m:, j] = v.array_r
        return pairs

    def _measure(self, r: PETSc.Vec) -> None:
        torn = self._M.torn
        force = torn.assemble(np.where(torn.dirichlet, 0.0, self._M.imbalance(r)))
        self.imbalance = float(np.sqrt(torn.comm.allreduce(force @ force)))

    def destroy(self, _pc: PETSc.PC | None = None) -> None:
        """Free the work vectors."""
        for owned in (self._y, self._qr, self._w, self._e):
            owned.destroy()
