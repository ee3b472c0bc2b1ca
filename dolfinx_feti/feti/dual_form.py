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

from contextlib import ExitStack
from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.events import event
from dolfinx_feti.feti.coarse.coarse import Coarse
from dolfinx_feti.feti.coarse.singularity import require_regular
from dolfinx_feti.feti.coarse.stability import negative_eigenvalues
from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.inertia import Inertia
from dolfinx_feti.feti.krylov.dual import DualSystem
from dolfinx_feti.feti.krylov.method import Method, Solution, choose_method, solve
from dolfinx_feti.feti.krylov.recycling import DeflatedSystem, Directions
from dolfinx_feti.feti.krylov.stopping import Monitor
from dolfinx_feti.feti.options import FETIOptions
from dolfinx_feti.feti.preconditioner.base import Preconditioner
from dolfinx_feti.feti.setup import Factored, Pattern
from dolfinx_feti.feti.subdomain.matrices import SubdomainMatrices
from dolfinx_feti.feti.subdomain.modes import Modes
from dolfinx_feti.feti.subdomain.pseudoinverse import PseudoInverse
from dolfinx_feti.torn import Torn

__all__ = ["DualForm", "balanced_start", "create_dual_form", "load", "recover"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DualForm:
    """The dual form of one matrix, with the parts of its pattern.

    Attributes:
        options: The choices made.
        torn: Blocks and copies.
        symmetric: Whether K is symmetric.
        gluing: B and B_D.
        matrices: The matrix of each subdomain, K or S.
        inverse: K⁺.
        modes: R, E and D of each subdomain.
        preconditioner: M.
        coarse: G and N.
        inertia: Negative eigenvalues.
        method: The Krylov method.
        dual: The dual system with its constraint preconditioner.
        system: The same, deflated by directions of earlier solves if there are any.
    """

    options: FETIOptions
    torn: Torn
    symmetric: bool
    gluing: Gluing
    matrices: SubdomainMatrices
    inverse: PseudoInverse
    modes: Modes
    preconditioner: Preconditioner
    coarse: Coarse
    inertia: Inertia
    method: Method
    dual: DualSystem
    system: DualSystem | DeflatedSystem

    @property
    def users_test(self) -> bool:
        """Whether the user's own tolerance of the Krylov method decides."""
        return self.method.users_test

    def deflated(self, directions: Directions | None) -> DualForm:
        """Return the form deflated by directions of earlier solves, if the options ask for it.

        Note:
            Collective.
        """
        most = self.options.recycle
        if not most:
            return self
        return replace(self, system=DeflatedSystem(self.dual, directions, most=most))

    @property
    def recycled(self) -> int:
        """Number of directions of earlier solves."""
        return self.system.count if isinstance(self.system, DeflatedSystem) else 0

    def directions(self) -> Directions | None:
        """Return what the solves with this form leave to later ones.

        Note:
            Collective.
        """
        return self.system.directions() if isinstance(self.system, DeflatedSystem) else None

    def solve(
        self, r: PETSc.Vec, u_D: Array, *, target: float, max_it: int, monitor: Monitor
    ) -> tuple[Array, Solution]:
        """Solve for an assembled right-hand side.

        Args:
            r: Assembled right-hand side, (N,).
            u_D: Prescribed values on the torn Dirichlet dofs, (n,).
            target: Wanted norm of the residual of the assembled system.
            max_it: Most iterations.
            monitor: Called with (iteration, norm of the residual of the assembled system).

        Returns:
            u with single-valued copies, (n,), and how the Krylov method ended.

        Note:
            Collective.
        """
        f = load(self, r, u_D)
        pair, rest = balanced_start(self, self.matrices.condense(f), self.gluing.gap(u_D))
        solution = solve(
            self.system, rest, self.method, target=target, max_it=max_it, monitor=monitor
        )
        return recover(self, pair + solution.x, f, u_D), solution

    def destroy(self) -> None:
        """Free what depends on the matrix; the parts of the pattern stay."""
        self.dual.destroy()
        self.coarse.destroy()


def create_dual_form(pattern: Pattern, factored: Factored) -> DualForm:
    """Build the coarse problem and the dual system of the present matrix.

    Args:
        pattern: What depends on the pattern, with the factors of the present matrix.
        factored: What these tell.

    Returns:
        The form; the caller destroys it before the pattern.

    Raises:
        SetUpError: The assembled problem is singular, or the options do not fit the matrix.

    Note:
        Collective.
    """
    options, torn, modes = pattern.options, pattern.torn, factored.modes
    pattern.matrices.to_double()  # K⁺ is part of the operator
    with ExitStack() as owned:
        with event("FETICoarse"):
            coarse = Coarse(
                torn,
                pattern.gluing,
                modes,
                pattern.preconditioner,
                q=options.coarse_q,
                symmetric=pattern.symmetric,
                prefix=pattern.prefix + "coarse_",
            )
            owned.callback(coarse.destroy)
            require_regular(
                torn,
                pattern.bodies,
                factored.near_kernel,
                pattern.gluing,
                pattern.matrices,
                coarse,
                symmetric=pattern.symmetric,
                definite=factored.semidefinite(pattern),
                prefix=pattern.prefix + "coarse_",
            )
        inertia = factored.inertia
        if pattern.symmetric:
            assembled = _negative_assembled(pattern, factored, coarse)
            inertia = replace(inertia, assembled=assembled)
        method = choose_method(
            torn.comm,
            definite=pattern.symmetric and inertia.definite,
            prefix=pattern.prefix + "dual_",
            stagnation=options.stagnation,
        )
        _check_method(method, pattern)
        dual = DualSystem(
            pattern.gluing,
            pattern.inverse,
            pattern.preconditioner,
            coarse,
            frozen=coarse.exact and coarse.MG is None and method.is_cg,
        )
        owned.pop_all()
    return DualForm(
        options=options,
        torn=torn,
        symmetric=pattern.symmetric,
        gluing=pattern.gluing,
        matrices=pattern.matrices,
        inverse=pattern.inverse,
        modes=modes,
        preconditioner=pattern.preconditioner,
        coarse=coarse,
        inertia=inertia,
        method=method,
        dual=dual,
        system=dual,
    )


def load(form: DualForm, r: PETSc.Vec, u_D: Array) -> Array:
    """Share an assembled right-hand side among the copies, f = δ T r, (n,).

    Fixed dofs (classical FETI) have no equation; their prescribed values move to the right.

    Args:
        form: The dual form.
        r: Assembled right-hand side, (N,).
        u_D: Prescribed values on the torn Dirichlet dofs, (n,).
    """
    torn, fixed = form.torn, form.inverse.fixed
    f = form.gluing.delta * torn.tear(r)
    f -= torn.multiply(np.where(fixed, u_D, 0.0))
    f[torn.dirichlet] = 0.0
    return f


def balanced_start(form: DualForm, f: Array, c: Array) -> tuple[Array, Array]:
    """Find a balanced pair and the jump that it leaves.

    Args:
        form: The dual form.
        f: Torn load on the dofs of the dual method, (n,).
        c: Gap, (m,).

    Returns:
        The pair :math:`s_0 = N^{-1} e, λ_0 = Q G s_0`, with :math:`G^⊤ λ_0 + D s_0 = e`, (m + K,),
        and the right-hand side (d − F λ₀ + G s₀, 0) of its correction, (m + K,). For D = 0 any s is
        balanced, and s₀ is the best for λ₀.
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


def recover(form: DualForm, pair: Array, f: Array, u_D: Array) -> Array:
    """Recover the displacement from multipliers and coarse unknowns.

    Args:
        form: The dual form.
        pair: (λ, s), (m + K,).
        f: Torn load, (n,).
        u_D: Prescribed values on the torn Dirichlet dofs, (n,).

    Returns:
        u with single-valued copies, (n,).
    """
    dual, coarse, fixed = form.dual, form.coarse, form.inverse.fixed
    lam, s = dual.split(pair)
    u = form.inverse.solve(form.matrices.condense(f) - dual.B.T @ lam)
    u += coarse.prolong(s)  # u = K⁺ (f − Bᵀ λ) + E s
    jump = dual.B @ u - form.gluing.gap(u_D)  # B u − c
    if dual.exact:
        jump, w = dual.project(jump)
        u -= coarse.prolong(w)  # s, at last
    w = form.preconditioner.B_D.T @ jump
    u -= form.preconditioner.extend(w)  # u ← u − E_Γ B_Dᵀ (B u − c)
    u = form.matrices.extend(u, f)
    u[fixed] = u_D[fixed]
    return u


def _negative_assembled(pattern: Pattern, factored: Factored, coarse: Coarse) -> int | None:
    """Count the negative eigenvalues of the assembled matrix that can be proved."""
    inertia, modes = factored.inertia, factored.modes
    inside, proved = inertia.interior or 0, 0
    if not inertia.definite:  # otherwise all K_i are positive semi-definite
        found = negative_eigenvalues(
            pattern.torn,
            pattern.gluing,
            modes,
            pattern.preconditioner,
            coarse,
            prefix=pattern.prefix + "coarse_",
        )
        if found is None:
            return inside or None
        proved = found
    if pattern.options.pc_type == "dirichlet" and pattern.matrices.condensed:
        return inside + proved  # the coarse fields are K-orthogonal to those inside
    return max(inside, proved)


def _check_method(method: Method, pattern: Pattern) -> None:
    """Refuse a Krylov method for symmetric systems if the matrix is not."""
    if not pattern.symmetric and method.is_symmetric:
        raise SetUpError(
            f"The matrix is not symmetric, but -{pattern.prefix}dual_ksp_type is {method.type}, "
            f"which takes it to be: use -{pattern.prefix}dual_ksp_type gmres."
        )
