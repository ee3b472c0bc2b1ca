# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The dual system for (λ, s), its balanced start, and the constraint preconditioner.

.. math:: \begin{pmatrix} F & -G \\ -G^⊤ & -D \end{pmatrix}
          \begin{pmatrix} λ \\ s \end{pmatrix} = \begin{pmatrix} d \\ -e \end{pmatrix}, \qquad
          F = B K^+ B^⊤, \quad d = B K^+ f - c, \quad e = E^⊤ f

(eq. 41; eq. 42; eq. 43, where D = 0). The first row is the jump between the copies, the second the
balance of forces on each subdomain. The start

.. math:: s_0 = N^{-1} e, \qquad λ_0 = Q G s_0, \qquad N = G^⊤ Q G + D

(eq. 47) satisfies the second row. The constraint preconditioner maps a residual (r, 0) to a
correction z = (z_λ, z_s) with :math:`G^⊤ z_λ + D z_s = 0`,

.. math:: w = N^{-1} G^⊤ Q\, r, \quad y = M (r - G w), \quad v = N^{-1}(G^⊤ y - D w), \quad
          z = (y - Q G v,\; -w - v).

Start and corrections satisfy the second row, so all iterates do, all residuals are (r, 0), and only
the jump r is computed.

The weight Q is diag(q), or M + diag(q) with a small q that makes Q definite
(``coarse/dual_problem``). In the second case :math:`y = Q (r - G w)` replaces M (r − G w), and
:math:`G^⊤ Q (r - G w) = D w` yields v = 0. If D = 0 and Q = diag(q), z_λ is that of the projected
system (eq. 45), which does not contain s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.feti.coarse.dual_problem import DualCoarseProblem
from dolfinx_feti.feti.interface.gluing import Gluing
from dolfinx_feti.feti.preconditioners.base import Preconditioner
from dolfinx_feti.feti.subdomain.generalized_inverse import GeneralizedInverse
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.runtime.linear_map import LinearMap


@dataclass(frozen=True, slots=True)
class DualUnknowns:
    """A vector (λ, s) of the dual system.

    It is *balanced* for a load f if Gᵀ λ + D s = Eᵀ f: the forces on each subdomain balance.

    Attributes:
        lam: Multipliers λ of the gluing, (m,).
        s: Coarse unknowns s, the amplitudes of the motions of the subdomains, (n_c,).
    """

    lam: Array
    s: Array

    def __add__(self, other: DualUnknowns) -> DualUnknowns:
        """Return the sum of two vectors."""
        return DualUnknowns(self.lam + other.lam, self.s + other.s)


class DualSystem:
    """The dual system of one matrix with its constraint preconditioner.

    B and G are distributed matrices, with m rows on this process and n or n_c columns.

    Attributes:
        inverse: K⁺.
        preconditioner: M.
        coarse: Coarse problem: E, G, D, Q and the factored N.
        comm: Communicator of the torn matrix.
        B: Jump operator.
        G: B E.
        m: Number of multipliers of this process.
        has_exact_kernel: Whether D = 0. The balance is then a condition on λ alone.
        has_M_in_Q: Whether Q = M + diag(q) rather than diag(q).
        omits_s: Whether corrections z have s = 0, as the projected system has no s. :meth:`project`
            computes s after the iterations.
    """

    def __init__(
        self,
        gluing: Gluing,
        inverse: GeneralizedInverse,
        preconditioner: Preconditioner,
        coarse: DualCoarseProblem,
        *,
        is_cg: bool,
    ) -> None:
        """Combine the parts of the system; their owners destroy them.

        Args:
            gluing: The constraints, with B.
            inverse: K⁺.
            preconditioner: M.
            coarse: Coarse problem: E, G, D, Q and the factored N.
            is_cg: Whether the Krylov method is CG or FCG, and not a pipelined one. These two do not
                depend on s: their scalar products are those of λ alone. On the jump grids
                (``dual/__init__``), Q = diag(q), they take 4 % more iterations with s in z, and FCG
                up to 2.3 times as many.
        """
        self.inverse = inverse
        self.preconditioner = preconditioner
        self.coarse = coarse
        self._torn = preconditioner.operator.torn
        self.comm = self._torn.comm
        self.has_exact_kernel = coarse.has_exact_kernel
        self.has_M_in_Q = coarse.MG is not None
        self.omits_s = is_cg and self.has_exact_kernel and not self.has_M_in_Q
        self.B = LinearMap(gluing.B)
        self.G = LinearMap(coarse.G)
        self._D = LinearMap(coarse.D)
        self._q = coarse.q.array_r.copy()
        self.m = self.B.shape[0]

    # -- product and start ------------------------------------------------------------------------

    def flexibility(self, lam: Array) -> Array:
        """Return F λ, (m,) → (m,). Collective."""
        return self.B @ self.inverse.solve(self.B.T @ lam)  # F λ = B K⁺ Bᵀ λ

    def multiply(self, unknowns: DualUnknowns) -> Array:
        """Return the first row of the system times (λ, s), F λ − G s, (m,). Collective.

        The second row is zero for the corrections of the preconditioner, up to rounding errors.
        These are left out, because the preconditioner takes the second row of a residual as zero.
        """
        return self.flexibility(unknowns.lam) - self.G @ unknowns.s  # F λ − G s

    def balance(self, f: Array) -> DualUnknowns:
        """Compute (λ₀, s₀), which is balanced for a load f on the dofs of K⁺, (n,). Collective."""
        s = self.coarse.solve(self.coarse.restrict(f))  # s₀ = N⁻¹ e, e = Eᵀ f
        return DualUnknowns(self.weighted_jump(s), s)  # λ₀ = Q G s₀

    def start(self, f: Array, c: Array) -> tuple[DualUnknowns, Array]:
        """Compute the start of the Krylov method and its residual. Collective.

        Args:
            f: Load on the dofs of K⁺, (n,).
            c: Gap, (m,).

        Returns:
            (λ₀, s₀), and its jump r = d − F λ₀ + G s₀, (m,). If D = 0, s₀ is the one with the
            smallest jump, in the norm of Q, in place of N⁻¹ e.
        """
        start = self.balance(f)
        d = self.B @ self.inverse.solve(f) - c  # d = B K⁺ f − c
        r = d - self.multiply(start)  # r = d − F λ₀ + G s₀
        if self.has_exact_kernel:
            r, w = self.project(r)
            start = DualUnknowns(start.lam, start.s - w)  # s₀ ← s₀ − w has the jump r − G w
        return start, r

    # -- constraint preconditioner ----------------------------------------------------------------

    def precondition(self, r: Array) -> tuple[DualUnknowns, float]:
        """Apply the constraint preconditioner to a residual (r, 0). Collective.

        Args:
            r: Jump, (m,).

        Returns:
            z, and ‖Tᵀ t‖ of the jump r − G w. If D = 0, this is the norm of the residual of the
            assembled system that :func:`~dolfinx_feti.feti.dual.recovery.recover` leaves; otherwise
            an estimate, because :func:`recover` does not remove G w then.
        """
        projected, w = self.project(r)  # r − G w
        y, t = self.preconditioner.apply(projected)  # y = M (r − G w)
        if self.has_M_in_Q:  # v = 0
            z = DualUnknowns(y + self._q * projected, -w)  # (Q (r − G w), −w)
            return z, self._norm_of_force(t)
        # The coarse solve has to communicate; the sum of ‖Tᵀ t‖² over the processes travels along.
        e = self.G.T @ y - self._D @ w
        v, square = self.coarse.solve_and_sum(e, self._local_square(t))  # v = N⁻¹ (Gᵀ y − D w)
        s = np.zeros_like(w) if self.omits_s else -w - v
        z = DualUnknowns(y - self.weighted_jump(v), s)  # (y − Q G v, −w − v)
        return z, float(np.sqrt(square))

    def project(self, r: Array) -> tuple[Array, Array]:
        """Subtract the jump of subdomain motions from a jump, P r if D = 0. Collective.

        Args:
            r: Jump, (m,).

        Returns:
            r − G w, (m,), and the amplitudes w = N⁻¹ Gᵀ Q r, (n_c,). If D = 0, w minimises r − G w
            in the norm of Q.
        """
        w = self.coarse.solve(self._restrict(r))  # w = N⁻¹ Gᵀ Q r
        return r - self.G @ w, w

    def weighted_jump(self, s: Array) -> Array:
        """Return Q G s, (n_c,) → (m,). Collective."""
        diagonal = self._q * (self.G @ s)  # q G s
        MG = self.coarse.MG
        return diagonal if MG is None else diagonal + MG.multiply(s)

    def _restrict(self, r: Array) -> Array:
        """Return Gᵀ Q r, (m,) → (n_c,). Collective."""
        diagonal = self.G.T @ (self._q * r)  # Gᵀ q r
        MG = self.coarse.MG
        return diagonal if MG is None else diagonal + MG.multiply_transposed(r)

    # -- the residual of the assembled system -----------------------------------------------------

    def assembled_norm(self, r: Array) -> float:
        """Return the norm of the assembled residual that the recovery leaves. Collective.

        Args:
            r: Jump of (λ, s), (m,).

        Returns:
            ‖Tᵀ t‖ of r − G w if D = 0, and of r otherwise: the recovery corrects s in the first
            case alone.
        """
        if self.has_exact_kernel:
            r, _ = self.project(r)
        _, t = self.preconditioner.apply(r)
        return self._norm_of_force(t)

    def _norm_of_force(self, t: Array) -> float:
        """Return ‖Tᵀ t‖ on the free dofs for an unbalanced force t, (n,). Collective."""
        return float(np.sqrt(total_of(self._local_square(t), self.comm)))

    def _local_square(self, t: Array) -> float:
        """Return the part of ‖Tᵀ t‖² of the free dofs that this process owns, for t, (n,).

        Collective, because summing copies communicates; the parts are not summed.
        """
        force = self._torn.assemble(np.where(self._torn.is_dirichlet_copy, 0.0, t))
        return float(force @ force)

    def destroy(self) -> None:
        """Free the work vectors of the products."""
        for linear_map in (self.B, self.G, self._D):
            linear_map.destroy()
