# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The dual form: the dual system set up for a matrix, and a displacement recovered from it.

.. math:: d = B K^+ f - c, \quad e = E^⊤ f, \qquad u = K^+(f - B^⊤ λ) + E s

(eq. 39, Augustin_eq:localSolutions; eq. 47 for the start, eq. 48 for s), on the interface alone
where the interior is eliminated. The copies that the Krylov method leaves apart are averaged,
:math:`u ← u - E_Γ B_D^⊤ (B u - c)`, and then one vector of the assembled problem holds u.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.coarse.space import AveragedColumns, AveragedSpace
from dolfinx_feti.feti.dual.coarse import Coarse
from dolfinx_feti.feti.dual.krylov import CG, choose_method, has_own_test, solve
from dolfinx_feti.feti.dual.preconditioner import Dirichlet, Identity, Lumped, Preconditioner
from dolfinx_feti.feti.dual.system import DualSystem
from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.pattern import Pattern
from dolfinx_feti.feti.regularity.singularity import require_regular
from dolfinx_feti.feti.setup import Inertia, Setup
from dolfinx_feti.feti.solution import CURVATURE, Monitor, Solution
from dolfinx_feti.feti.subdomain.modes import SubdomainModes
from dolfinx_feti.feti.subdomain.operator import Operator
from dolfinx_feti.feti.subdomain.pseudoinverse import PseudoInverse
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import Torn

PRECONDITIONERS: dict[str, Callable[..., Preconditioner]] = {
    "dirichlet": Dirichlet,
    "identity": Identity,
    "lumped": Lumped,
}


@dataclass(frozen=True, slots=True)
class DualForm:
    """The dual form of one matrix.

    Attributes:
        pattern: What depends on the pattern.
        operator: S, and K_II⁻¹.
        delta: Weight δ of every torn dof, (n,).
        inverse: K⁺, with R, E and D of each subdomain.
        preconditioner: M.
        coarse: G and N.
        inertia: Negative eigenvalues.
        method: PETSc's name of the Krylov method.
        dual: The dual system with its constraint preconditioner.
    """

    pattern: Pattern
    operator: Operator
    delta: Array
    inverse: PseudoInverse
    preconditioner: Preconditioner
    coarse: Coarse
    inertia: Inertia
    method: str
    dual: DualSystem

    formulation = "dual"
    solves_indefinite = True

    @property
    def torn(self) -> Torn:
        """Subdomains and copies."""
        return self.pattern.torn

    @property
    def modes(self) -> tuple[SubdomainModes, ...]:
        """R, E and D of each subdomain."""
        return self.inverse.modes

    @property
    def users_test(self) -> bool:
        """Whether the user's own tolerance of the Krylov method decides."""
        return has_own_test(self.pattern.prefix + "dual_")

    def solve(
        self,
        r: PETSc.Vec,
        u_D: Array,
        *,
        target: float,
        max_it: int,
        monitor: Monitor,
        saddles: bool = True,
    ) -> tuple[Array, Solution]:
        """Solve for an assembled right-hand side. Collective.

        The right-hand side r is (N,), the values u_D on the torn Dirichlet dofs (n,). Indefinite
        matrices are taken whatever ``saddles`` says. Returns u with single-valued copies, (n,), and
        how the Krylov method ended.
        """
        f = load(self, r, u_D)
        f_K, c = self.operator.load(f), self.pattern.gluing.gap(u_D)
        pair, rest = balanced_start(self, f_K, c)
        correction, solution = solve(
            self.dual,
            rest,
            self.method,
            self.pattern.prefix + "dual_",
            target=target,
            max_it=max_it,
            monitor=monitor,
        )
        if solution.reason in CURVATURE and self.inertia.definite:  # rounding: a fresh start
            solution = replace(solution, reason=PETSc.KSP.ConvergedReason.CONVERGED_ITS)
        u = recover(self, pair + correction, f_K, c)
        u = self.operator.complete(u, f)
        return np.where(self.pattern.dofs.fixed, u_D, u), solution

    def memory(self) -> float:
        """Return the memory of all factors of this process in MiB."""
        return self.operator.memory() + self.inverse.memory()


def create_dual_form(pattern: Pattern, setup: Setup, within: Lifetime) -> DualForm:
    """Build M, the coarse problem and the dual system of the present matrix. Collective.

    A SetUpError tells that the assembled problem is singular.
    """
    options, torn, modes = pattern.options, pattern.torn, setup.inverse.modes
    prefix = pattern.prefix + "coarse_"
    semidefinite = setup.inertia.definite
    semidefinite &= setup.inertia.interior == 0 or not setup.operator.eliminated
    create = PRECONDITIONERS[options.pc_type]
    B_D = within.own(pattern.gluing.scaled_jumps(torn, setup.delta))
    preconditioner = within.own(create(setup.operator, B_D, [m.stabilisation for m in modes]))
    with event("FETICoarse"):
        coarse = Coarse(
            pattern.gluing, setup.delta, modes, preconditioner, q=options.coarse_q, prefix=prefix
        )
        within.own(coarse)

        def averaged(s: Array) -> Array:
            """Return E s with its copies averaged, completed inside, zero on Dirichlet dofs."""
            w = torn.tear(torn.assemble(setup.delta * coarse.prolong(s)))
            w = setup.operator.complete(np.where(torn.dirichlet, 0.0, w), np.zeros(torn.n))
            return np.where(torn.dirichlet, 0.0, w)

        require_regular(
            torn,
            pattern.bodies,
            coarse.N,
            coarse.solver,
            field=averaged,
            definite=semidefinite,
            prefix=prefix,
        )
    inertia = replace(setup.inertia, assembled=_negative_assembled(pattern, setup, prefix))
    method = choose_method(torn.comm, definite=inertia.definite, prefix=pattern.prefix + "dual_")
    dual = within.own(
        DualSystem(pattern.gluing, setup.inverse, preconditioner, coarse, cg=method in CG)
    )
    own = setup.operator, setup.delta, setup.inverse
    return DualForm(pattern, *own, preconditioner, coarse, inertia, method, dual)


def load(form: DualForm, r: PETSc.Vec, u_D: Array) -> Array:
    """Share a load r, (N,), among the copies, f = δ T r, (n,), less K u_D of fixed dofs."""
    torn = form.torn
    f = form.delta * torn.tear(r.array_r)
    f -= torn.multiply(np.where(form.pattern.dofs.fixed, u_D, 0.0))
    f[torn.dirichlet] = 0.0
    return f


def balanced_start(form: DualForm, f: Array, c: Array) -> tuple[Array, Array]:
    """Return a balanced pair for a load f and a gap c, and the jump that it leaves, (m + K,) each.

    They are :math:`s_0 = N^{-1} e, λ_0 = Q G s_0`, with :math:`G^⊤ λ_0 + D s_0 = e`, and (d − F λ₀
    + G s₀, 0). For D = 0 any s is balanced, and s₀ is the best for λ₀.
    """
    dual, coarse = form.dual, form.coarse
    s = coarse.solve(coarse.restrict(f))  # s₀ = N⁻¹ e, e = Eᵀ f
    pair = np.concatenate([dual.weighted_jump(s), s])  # λ₀ = Q G s₀
    d = dual.B @ form.inverse.solve(f) - c  # d = B K⁺ f − c
    r = d - dual.jump(pair)  # d − F λ₀ + G s₀
    if dual.exact:
        r, w = dual.project(r)
        pair[dual.m :] += w
    return pair, np.concatenate([r, np.zeros(len(s))])


def recover(form: DualForm, pair: Array, f: Array, c: Array) -> Array:
    """Return u, (n,), on the dofs of K⁺, with single-valued copies, of a pair (λ, s), (m + K,)."""
    dual, coarse = form.dual, form.coarse
    lam, s = dual.split(pair)
    u = form.inverse.solve(f - dual.B.T @ lam)
    u += coarse.prolong(s)  # u = K⁺ (f − Bᵀ λ) + E s
    jump = dual.B @ u - c  # B u − c
    if dual.exact:
        jump, w = dual.project(jump)
        u -= coarse.prolong(w)  # s, at last
    w = form.preconditioner.B_D.T @ jump
    return np.asarray(u - form.preconditioner.extend(w))  # u ← u − E_Γ B_Dᵀ (B u − c)


def _negative_assembled(pattern: Pattern, setup: Setup, prefix: str) -> int | None:
    """Count negative eigenvalues that the assembled matrix is proved to have; None if not known.

    Those of K_II, and of A₀ for the motions E of the subdomains with their copies averaged.
    """
    S, inside = setup.operator, setup.inertia.interior
    if setup.inertia.definite:  # all K_i are positive semi-definite, but perhaps inside
        return inside or 0
    if inside is None:
        return None
    E = [m.E[on] for m, on in zip(setup.inverse.modes, S.on_interface, strict=True)]
    with Lifetime() as owned:
        copies = owned.own(Copies(pattern.torn, S.interface, setup.delta))
        V = owned.own(AveragedColumns(copies, E))
        negative = owned.own(AveragedSpace(V, S, prefix=prefix)).negative()
    return None if negative is None else inside + negative
