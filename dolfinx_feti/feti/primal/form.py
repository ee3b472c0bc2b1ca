# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The primal form: the assembled interface problem set up for a matrix, and solved for a load.

.. math:: A\, x = T^⊤ \hat f_Γ, \qquad A = T^⊤ S\, T, \qquad
          \hat f_Γ = f_Γ - K_{ΓI} K_{II}^{-1} f_I, \qquad f = δ\, T r - K u_D

by CG, or GMRES if K is not symmetric (``krylov``). S, Vᵀ A and A₀ are those of the present matrix;
:math:`K_ρ^{-1}`, V and δ may be of an earlier one, or of the symmetric part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.errors import SetUpError, SingularError
from dolfinx_feti.feti.coarse.space import AveragedColumns, AveragedSpace
from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.pattern import Pattern, symmetric_part
from dolfinx_feti.feti.primal.adaptive import adaptive_columns
from dolfinx_feti.feti.primal.assembled import assembled_products
from dolfinx_feti.feti.primal.deflation import DeflatedSpace, soft_fields
from dolfinx_feti.feti.primal.krylov import PrimalSystem, conjugate_gradients, gmres
from dolfinx_feti.feti.regularity.singularity import require_held
from dolfinx_feti.feti.setup import Inertia, Setup, set_up, sum_if_known
from dolfinx_feti.feti.solution import Monitor, RitzVectors, Solution
from dolfinx_feti.feti.subdomain.modes import SubdomainModes
from dolfinx_feti.feti.subdomain.operator import Operator
from dolfinx_feti.feti.subdomain.pseudoinverse import PseudoInverse
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime

Reason = PETSc.KSP.ConvergedReason

#: Iterations that are kept for each of the Ritz vectors that may come of them.
TRACED = 4

#: Cost χ₀ of an average above which a column joins the coarse space (``adaptive``).
COST = 3.5


@dataclass(frozen=True, slots=True)
class PrimalPreconditioner:
    """What preconditions A, of the matrix for which it was made.

    Attributes:
        delta: Weight δ of every torn dof, (n,).
        inverse: K_ρ⁻¹, and R, E, D of each subdomain.
        inertia: Negative eigenvalues of K_ρ, D and K_II.
        copies: Copies of the interface dofs.
        V: The averaged columns.
        combinations: Those of the columns of this process that are independent; None before the
            first matrix.
    """

    delta: Array
    inverse: PseudoInverse
    inertia: Inertia
    copies: Copies
    V: AveragedColumns
    combinations: scipy.sparse.csr_array | None = None

    def solve(self, t: Array) -> Array:
        """Return K_ρ⁻¹ t restricted to the interface, by copies, (n,) → (n,), up to soft modes.

        They are among the columns of V: the projection makes up for any share of them.
        """
        y = np.zeros(len(self.delta))
        y[self.copies.dofs] = t
        return self.inverse.solve(y, up_to_soft_modes=True)[self.copies.dofs]


@dataclass(frozen=True, slots=True)
class PrimalForm:
    """The primal form of one matrix.

    Attributes:
        pattern: What depends on the pattern.
        operator: S, and K_II⁻¹, of this matrix.
        preconditioner: K_ρ⁻¹, V and δ, of this matrix or an earlier one.
        coarse: V, A V and A₀.
        deflation: The same, and Ritz vectors of earlier solves.
        inertia: Negative eigenvalues.
        most: Ritz vectors that a solve leaves to those of later matrices, at most.
    """

    pattern: Pattern
    operator: Operator
    preconditioner: PrimalPreconditioner
    coarse: AveragedSpace
    deflation: DeflatedSpace
    inertia: Inertia
    most: int

    formulation = "primal"
    users_test = False

    @property
    def method(self) -> str:
        """PETSc's name of the Krylov method."""
        return "cg" if self.pattern.symmetric else "gmres"

    @property
    def solves_indefinite(self) -> bool:
        """Whether it solves with an indefinite matrix."""
        return not self.pattern.symmetric

    @property
    def delta(self) -> Array:
        """Weight δ of every torn dof, (n,)."""
        return self.preconditioner.delta

    @property
    def modes(self) -> tuple[SubdomainModes, ...]:
        """R, E and D of each subdomain."""
        return self.preconditioner.inverse.modes

    @property
    def system(self) -> PrimalSystem:
        """A and its preconditioner on copies of the interface dofs."""
        operator, copies = self.operator, self.preconditioner.copies

        def multiply(t: Array) -> Array:
            u = np.zeros(operator.torn.n)
            u[copies.dofs] = t
            return operator.multiply(u)[copies.dofs]

        return PrimalSystem(copies, self.deflation, multiply, self.preconditioner.solve)

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
        """Solve for an assembled right-hand side, (N,), and prescribed values, (n,). Collective.

        See :meth:`DualForm.solve <dolfinx_feti.feti.dual.form.DualForm.solve>`. With ``saddles``,
        negative curvature in the coarse space is no obstacle.
        """
        torn, Γ = self.pattern.torn, self.preconditioner.copies.dofs
        f = self.delta * torn.tear(r.array_r) - torn.multiply(u_D)
        f[torn.dirichlet] = 0.0  # f = δ T r − K u_D
        with event("FETIIterations"):
            iterate = partial(conjugate_gradients, saddles=saddles)
            if not self.pattern.symmetric:
                iterate = partial(gmres)
            x, solution, trace = iterate(
                self.system,
                self.operator.condense(f)[Γ],
                target=target,
                max_it=max_it,
                monitor=monitor,
                traced=TRACED * self.most,
            )
        with event("FETIRecycling"):
            left = self.deflation.ritz_vectors(trace, most=self.most)
        u = np.zeros(torn.n)
        u[Γ], reason = x, solution.reason
        if reason == Reason.DIVERGED_INDEFINITE_PC and self.preconditioner.inertia.local == 0:
            reason = Reason.CONVERGED_ITS  # rounding: a fresh start on what is left
        solution = replace(solution, reason=reason, ritz_vectors=left)
        return self.operator.extend(u, f) + u_D, solution

    def memory(self) -> float:
        """Return the memory of all factors of this process in MiB."""
        return self.operator.memory() + self.preconditioner.inverse.memory()


def create_preconditioner(pattern: Pattern, setup: Setup, within: Lifetime) -> PrimalPreconditioner:
    """Build the coarse columns of a symmetric matrix, for their owner. Collective."""
    torn, options, S = pattern.torn, pattern.options, setup.operator
    copies = within.own(Copies(torn, S.interface, setup.delta))
    with event("FETICoarse"):
        E = [m.E[on] for m, on in zip(setup.inverse.modes, S.on_interface, strict=True)]
        adaptive = adaptive_columns(
            copies,
            assembled_products(S, copies),
            partial(solver_on_interface, S, setup.inverse),
            E,
            most=options.coarse_adaptive,
            threshold=COST,
        )
        U = [np.hstack(pair) for pair in zip(E, adaptive, strict=True)]
        V = within.own(AveragedColumns(copies, U))
    return PrimalPreconditioner(setup.delta, setup.inverse, setup.inertia, copies, V)


def create_preconditioner_of_part(pattern: Pattern, within: Lifetime) -> PrimalPreconditioner:
    """Build the preconditioner of the present matrix from ½ (K + Kᵀ), for its owner. Collective."""
    try:
        with symmetric_part(pattern.torn) as torn, Lifetime() as matrix:
            assert pattern.of_part is not None
            part = replace(pattern, torn=torn, symmetric=True, analysis=pattern.of_part)
            return create_preconditioner(part, set_up(part, matrix, within, rough=True), within)
    except SingularError:  # which does not make K singular
        raise SetUpError(
            "The symmetric part of the matrix, which is not symmetric, is singular inside of a "
            "subdomain and preconditions nothing: take other subdomains, or a direct solver."
        ) from None


def create_primal_form(
    pattern: Pattern,
    operator: Operator,
    preconditioner: PrimalPreconditioner,
    within: Lifetime,
    vectors: RitzVectors | None = None,
    *,
    most: int = 0,
) -> PrimalForm:
    """Build the form of the present matrix with a preconditioner of it or another. Collective.

    ``within`` owns A V and A₀; ``vectors`` are what solves with earlier matrices have left, and
    ``most`` of them are left to later ones. A SetUpError tells of a body
    that is not held.
    """
    S, prefix, known = operator, pattern.prefix + "coarse_", preconditioner.combinations
    with event("FETICoarse"):
        require_held(pattern.torn, pattern.bodies)
        space = AveragedSpace(
            preconditioner.V, S, prefix=prefix, symmetric=pattern.symmetric, combinations=known
        )
        within.own(space)
    negative, copies = space.negative(), preconditioner.copies
    count = pattern.options.deflation if pattern.symmetric and not negative else 0
    if vectors is None and count and _softened(preconditioner.inverse, pattern):
        solver = partial(solver_on_interface, S, preconditioner.inverse)
        with event("FETIRecycling"):
            vectors = soft_fields(
                space, copies, S.multiply_many, lambda i, F: solver(i)(F), count=count
            )
    inside = sum_if_known(S.negative_interior, pattern.torn.comm)
    proved = None if negative is None or inside is None else negative + inside
    return PrimalForm(
        pattern=pattern,
        operator=S,
        preconditioner=preconditioner,
        coarse=space,
        deflation=DeflatedSpace(
            space, copies, S.multiply_many, vectors, symmetric=pattern.symmetric
        ),
        inertia=replace(preconditioner.inertia, interior=inside, assembled=proved),
        most=most,
    )


def _softened(inverse: PseudoInverse, pattern: Pattern) -> bool:
    """Tell whether the stress softens some subdomain. Collective."""
    own = any(modes.softened for modes in inverse.modes)
    return bool(pattern.torn.comm.allreduce(own, op=MPI.LOR))


def solver_on_interface(S: Operator, inverse: PseudoInverse, i: int) -> Callable[[Array], Array]:
    """Return what applies S_ρ⁻¹ of subdomain i to forces, (n_Γ, k): K_ρ⁻¹ on the interface.

    It serves until the inverse of another subdomain is applied.
    """
    on, solve = S.on_interface[i], inverse.solver(i)

    def solve_on_interface(F: Array) -> Array:
        Y = np.zeros((len(on), F.shape[1]))
        Y[on] = F
        return solve(Y)[on]

    return solve if on.all() else solve_on_interface
