# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The dual formulation of one matrix: its set-up, and the solution for a load.

A solve of A z = r takes four steps:

1. the torn load :math:`f = δ\, T r - K u_D` and the gap c (here),
2. the balanced start :math:`(λ_0, s_0)` and its jump (``system``),
3. the correction that leads from :math:`(λ_0, s_0)` to :math:`(λ, s)`, by the Krylov method
   (``krylov``),
4. the displacement :math:`u = K^+(f - B^⊤ λ) + E s`, with its copies averaged (``recovery``).

If the interior is eliminated, steps 2 to 4 are done on the interface, with S and the condensed load
:math:`\hat f_Γ` in place of K and f. The outer loop calls a solve with r = b first. If it solves
again, for a *fresh start*, r is the residual that its earlier solves have left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.accuracy import ErrorTest
from dolfinx_feti.feti.coarse.averaged import AveragedBasis
from dolfinx_feti.feti.coarse.dual_problem import DualCoarseProblem
from dolfinx_feti.feti.coarse.primal_problem import create_primal_coarse_problem
from dolfinx_feti.feti.dual import krylov
from dolfinx_feti.feti.dual.recovery import recover
from dolfinx_feti.feti.dual.system import DualSystem
from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.monitor import Monitor
from dolfinx_feti.feti.pattern import Pattern
from dolfinx_feti.feti.preconditioners.base import Preconditioner
from dolfinx_feti.feti.preconditioners.registry import PRECONDITIONERS
from dolfinx_feti.feti.regularity.detection import CoarseMatrix, require_regular
from dolfinx_feti.feti.setup import Inertia, Setup
from dolfinx_feti.feti.solve_info import NEGATIVE_CURVATURE, KrylovInfo
from dolfinx_feti.feti.subdomain.generalized_inverse import GeneralizedInverse
from dolfinx_feti.feti.subdomain.modes import SubdomainModes
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import Torn


@dataclass(frozen=True, slots=True)
class DualFormulation:
    """The dual formulation of one matrix; it satisfies the protocol ``Formulation``.

    It has no ``destroy``: the lifetimes that were passed to :func:`create_dual_formulation` and to
    ``set_up`` destroy its parts when it is no longer used.

    Attributes:
        pattern: Data that depend on the pattern of the matrix alone, such as B.
        operator: Schur complements S, and solves with K_II.
        delta: Weight δ of every torn dof, (n,).
        inverse: K⁺, with R, E and D of each subdomain.
        preconditioner: M, with B_D.
        coarse: Coarse problem: E, G, D, Q and the factored N.
        inertia: Numbers of negative eigenvalues.
        method: PETSc's name of the Krylov method.
        system: The dual system with its constraint preconditioner.
        name: Value of the option ``feti_formulation``.
        solves_indefinite: True: GMRES solves with an indefinite matrix.
        measures_error: False: the caller tests the estimated error of the solution.
        deflation_count: 0: no vectors deflate the solves.
    """

    pattern: Pattern
    operator: SchurOperator
    delta: Array
    inverse: GeneralizedInverse
    preconditioner: Preconditioner
    coarse: DualCoarseProblem
    inertia: Inertia
    method: str
    system: DualSystem

    name = "dual"
    solves_indefinite = True
    measures_error = False
    deflation_count = 0

    @property
    def torn(self) -> Torn:
        """The torn matrix."""
        return self.pattern.torn

    @property
    def modes(self) -> tuple[SubdomainModes, ...]:
        """R, E and D of each subdomain."""
        return self.inverse.modes

    @property
    def has_krylov_tolerance(self) -> bool:
        """Whether the user's own tolerance ends the Krylov method."""
        return self.pattern.subsolvers.dual.has_tolerance

    def solve(
        self,
        r: PETSc.Vec,
        u_D: Array,
        *,
        target: float,
        max_it: int,
        monitor: Monitor,
        error_test: ErrorTest | None = None,
        allow_indefinite: bool = True,
    ) -> tuple[Array, KrylovInfo]:
        """Solve for an assembled right-hand side. Collective.

        Args:
            r: Right-hand side: b, or in a fresh start the residual b − A x of the solution x so
                far, (N,).
            u_D: Prescribed values on the torn Dirichlet dofs, zero elsewhere, (n,).
            target: Norm of the residual of the assembled system that ends the Krylov method.
            max_it: Largest number of iterations.
            monitor: Called with each iteration and the norm of that residual.
            error_test: Not used: η needs a displacement, which the recovery computes after the
                iterations.
            allow_indefinite: Not used: GMRES solves with indefinite matrices.

        Returns:
            u with equal copies, (n,), and how the Krylov method ended.
        """
        f = self.torn_load(r, u_D)
        condensed = self._condense_if_eliminated(f)
        c = self.pattern.gluing.gap(u_D)
        start, jump = self.system.start(condensed, c)  # (λ₀, s₀), and its jump
        correction, info = krylov.solve(
            self.system,
            jump,
            self.method,
            self.pattern.subsolvers.dual,
            target=target,
            max_it=max_it,
            monitor=monitor,
        )
        if info.reason in NEGATIVE_CURVATURE and self.inertia.is_definite:
            # The dual system is positive definite, so the negative curvature is a rounding error.
            info = replace(info, reason=PETSc.KSP.ConvergedReason.ITERATING, needs_fresh_start=True)
        unknowns = start + correction  # (λ, s)
        u = recover(self.system, unknowns, condensed, c)  # u = K⁺ (f − Bᵀ λ) + E s, averaged
        u = self._extend_if_eliminated(u, f)
        return np.where(self.pattern.is_fixed, u_D, u), info

    def precondition(self, r: PETSc.Vec) -> Array:
        """Return z ≈ A⁻¹ r, the displacement of the balanced start (λ₀, s₀). Collective.

        Args:
            r: Assembled residual, (N,).

        Returns:
            z with equal copies, (n,), zero on Dirichlet dofs.
        """
        u_D = np.zeros(self.torn.n)
        f = self.torn_load(r, u_D)
        condensed = self._condense_if_eliminated(f)
        c = self.pattern.gluing.gap(u_D)
        start = self.system.balance(condensed)  # (λ₀, s₀)
        u = recover(self.system, start, condensed, c)
        u = self._extend_if_eliminated(u, f)
        return np.where(self.pattern.is_fixed, 0.0, u)

    def torn_load(self, r: PETSc.Vec, u_D: Array) -> Array:
        """Return the load on the torn dofs. Collective.

        Args:
            r: Assembled right-hand side, (N,). The weights δ share it among the copies.
            u_D: Prescribed values on the torn Dirichlet dofs, (n,). In classical FETI they enter
                the load through K; in all-floating FETI, the gap c.

        Returns:
            f = δ T r − K u_D, zero on Dirichlet dofs, (n,).
        """
        torn = self.torn
        f = self.delta * torn.tear(r.array_r)
        f -= torn.multiply(np.where(self.pattern.is_fixed, u_D, 0.0))  # f = δ T r − K u_D
        f[torn.is_dirichlet_copy] = 0.0
        return f

    def _condense_if_eliminated(self, f: Array) -> Array:
        """Return the load on the dofs of K⁺, (n,): f̂_Γ if the interior is eliminated, else f.

        Args:
            f: Torn load, (n,).
        """
        return self.operator.interface_load(f) if self.operator.is_interior_eliminated else f

    def _extend_if_eliminated(self, u: Array, f: Array) -> Array:
        """Return u with its interior dofs, which are missing if the interior is eliminated.

        Args:
            u: Displacement on the dofs of K⁺, (n,).
            f: Torn load, (n,).

        Returns:
            u on all dofs, (n,).
        """
        return self.operator.extend(u, f) if self.operator.is_interior_eliminated else u

    def memory(self) -> float:
        """Return the memory of all factors of this process in MiB."""
        return self.operator.memory() + self.inverse.memory()

    def deflation_memory(self) -> float:
        """Return zero: the dual formulation has no Ritz vectors."""
        return 0.0

    def preconditioner_for_later_matrix(self) -> None:
        """Return None: M is set up for each matrix."""

    def setup_for_dual(self) -> None:
        """Return None: this is the dual formulation."""


def create_dual_formulation(
    pattern: Pattern, setup: Setup, matrix_objects: Lifetime
) -> DualFormulation:
    """Create M, the coarse problem and the dual system of the present matrix. Collective.

    Args:
        pattern: Data that depend on the pattern of the matrix alone.
        setup: S, δ and K⁺ of the matrix; their owner outlives the formulation.
        matrix_objects: Owner of the objects that are created here, which belong to the matrix; it
            destroys them.

    Raises:
        SetUpError: The set-up failed; a SingularError if the assembled problem is singular.
    """
    torn = pattern.torn
    coarse_options = pattern.subsolvers.coarse
    preconditioner = _create_preconditioner(pattern, setup, matrix_objects)
    with event("FETICoarse"):
        coarse = DualCoarseProblem(
            torn,
            pattern.gluing,
            setup.delta,
            setup.inverse,
            preconditioner,
            weight=pattern.options.coarse_q,
            options=coarse_options,
        )
        matrix_objects.own(coarse)
        require_regular(
            torn,
            pattern.bodies,
            CoarseMatrix(
                coarse.N, coarse.solver, coarse_options, _AveragedMotions(torn, setup, coarse)
            ),
            is_semidefinite=_is_semidefinite(setup),
        )
    inertia = replace(setup.inertia, assembled=_min_negative_eigenvalues(pattern, setup))
    method = krylov.select_method(pattern.subsolvers.dual, is_definite=inertia.is_definite)
    system = DualSystem(
        pattern.gluing, setup.inverse, preconditioner, coarse, is_cg=method in krylov.UNPIPELINED_CG
    )
    return DualFormulation(
        pattern=pattern,
        operator=setup.operator,
        delta=setup.delta,
        inverse=setup.inverse,
        preconditioner=preconditioner,
        coarse=coarse,
        inertia=inertia,
        method=method,
        system=matrix_objects.own(system),
    )


def _create_preconditioner(
    pattern: Pattern, setup: Setup, matrix_objects: Lifetime
) -> Preconditioner:
    """Create the preconditioner M that the options name. Collective.

    Args:
        pattern: Data that depend on the pattern of the matrix alone.
        setup: S, δ and K⁺ of the matrix.
        matrix_objects: Owner of M and B_D, which destroys them.
    """
    B_D = matrix_objects.own(pattern.gluing.scaled_jumps(pattern.torn, setup.delta))
    stabilisation = [modes.stabilisation for modes in setup.inverse.modes]
    preconditioner_class = PRECONDITIONERS[pattern.options.pc_type]
    preconditioner = preconditioner_class(setup.operator, B_D, stabilisation)
    return matrix_objects.own(preconditioner)


def _is_semidefinite(setup: Setup) -> bool:
    """Return True if the inertia proves that all K_i are positive semi-definite.

    If the interior is eliminated, the inertia of the generalised inverse is that of S_i. K_i is
    positive semi-definite if S_i and K_II are.
    """
    if not setup.operator.is_interior_eliminated:
        return setup.inertia.is_definite
    return setup.inertia.is_definite and setup.inertia.interior == 0


@dataclass(frozen=True, slots=True)
class _AveragedMotions:
    """The motions E s with their copies averaged.

    Attributes:
        torn: The torn matrix.
        setup: δ, and S for the interior.
        coarse: E.
    """

    torn: Torn
    setup: Setup
    coarse: DualCoarseProblem

    def field(self, s: Array) -> Array:
        """Return T Tᵀ δ E s with the interior that belongs to it, (n,). Collective.

        Args:
            s: Coarse unknowns, (n_c,).
        """
        torn = self.torn
        w = torn.tear(torn.assemble(self.setup.delta * self.coarse.prolong(s)))  # T Tᵀ δ E s
        w = np.where(torn.is_dirichlet_copy, 0.0, w)
        if self.setup.operator.is_interior_eliminated:
            w = self.setup.operator.extend(w, np.zeros(torn.n))
        return np.where(torn.is_dirichlet_copy, 0.0, w)


def _min_negative_eigenvalues(pattern: Pattern, setup: Setup) -> int | None:
    """Return a lower bound of the number of negative eigenvalues of A. Collective.

    A has the inertia of all K_II and of the assembled interface matrix Tᵀ S T. The Galerkin matrix
    A₀ = Vᵀ S V of any V has at most as many negative eigenvalues as the latter. V is that of the
    primal formulation, the motions E of the subdomains with their copies averaged. Assembling and
    factoring A₀ takes about as long as for N. If no subdomain has a negative eigenvalue, Tᵀ S T has
    none, and A₀ is not needed.

    Args:
        pattern: Data that depend on the pattern of the matrix alone.
        setup: S, δ and K⁺ of the matrix.

    Returns:
        The bound, or None if a factor does not count its negative eigenvalues.
    """
    operator = setup.operator
    interior = setup.inertia.interior
    if setup.inertia.is_definite:
        return 0 if interior is None else interior
    if interior is None:
        return None
    E = setup.inverse.E_on_interface(pattern.torn.comm)
    with Lifetime() as owned:
        copies = owned.own(Copies(pattern.torn, operator.interfaces, setup.delta, pattern.errors))
        V = owned.own(AveragedBasis(copies, E))
        coarse_space = owned.own(
            create_primal_coarse_problem(
                V, operator, options=pattern.subsolvers.coarse, is_symmetric=True
            )
        )
        negative = coarse_space.negative_eigenvalues
    return None if negative is None else interior + negative
