# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The primal formulation: set-up for a matrix, and solves with it.

A solve of the assembled system A z = r takes three steps:

1. the torn load :math:`f = δ\, T r - K u_D`, condensed to the interface,
   :math:`\hat f_Γ = f_Γ - K_{ΓI} K_{II}^{-1} f_I`,
2. the interface displacement, :math:`A_Γ\, x_Γ = T^⊤ \hat f_Γ` with :math:`A_Γ = T^⊤ S\, T`, by a
   Krylov method (``krylov``),
3. the torn displacement: :math:`u_Γ = T x_Γ`, and the interior follows.

S, :math:`V^⊤ A_Γ` and A₀ belong to the current matrix. :math:`K_ρ^{-1}`, V and δ may belong to an
earlier one, or to its symmetric part (``preconditioner``). The outer loop calls a solve with r = b
first. If it solves again, for a *fresh start*, r is the residual that its earlier solves have left.
The other files of this room omit the index Γ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.accuracy import ErrorTest
from dolfinx_feti.feti.coarse.primal_problem import (
    PrimalCoarseProblem,
    create_primal_coarse_problem,
)
from dolfinx_feti.feti.monitor import Monitor
from dolfinx_feti.feti.pattern import Pattern
from dolfinx_feti.feti.primal.deflation import DeflationSpace, create_deflation_space
from dolfinx_feti.feti.primal.krylov.registry import KRYLOV_METHODS, select_method
from dolfinx_feti.feti.primal.preconditioner import PrimalPreconditioner
from dolfinx_feti.feti.primal.ritz_vectors import STORED_ITERATIONS_PER_VECTOR, recycled_vectors
from dolfinx_feti.feti.primal.soft_fields import soft_fields
from dolfinx_feti.feti.primal.stopping import InterfaceErrorTest, StoppingTest
from dolfinx_feti.feti.primal.system import PrimalSystem
from dolfinx_feti.feti.regularity.detection import (
    MAX_MOTIONS,
    require_accurate_solver,
    require_no_mechanism,
    require_supported,
)
from dolfinx_feti.feti.setup import Inertia, Setup, require_regular_interior_blocks, sum_if_known
from dolfinx_feti.feti.solve_info import DeflationVectors, ErrorMeasurement, KrylovInfo
from dolfinx_feti.feti.subdomain.generalized_inverse import GeneralizedInverse
from dolfinx_feti.feti.subdomain.modes import SubdomainModes
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.null_space import has_null_space

Reason = PETSc.KSP.ConvergedReason


@dataclass(frozen=True, slots=True)
class PrimalFormulation:
    """The primal formulation of one matrix; it satisfies the protocol ``Formulation``.

    Attributes:
        pattern: All that depends on the pattern of the matrix alone.
        operator: S, and K_II⁻¹, of this matrix.
        preconditioner: K_ρ⁻¹, V and δ, of this matrix or an earlier one.
        coarse: V, Vᵀ A_Γ and A₀.
        deflation: V, and W from earlier solves or of soft fields.
        inertia: Numbers of negative eigenvalues.
        max_ritz_vectors: Largest number of Ritz vectors that a solve returns for later matrices.
        name: Value of the option ``feti_formulation``.
        has_krylov_tolerance: False: the Krylov method has no tolerance of the user's own.
        measures_error: True: the Krylov method tests the estimated error of its iterates.
    """

    pattern: Pattern
    operator: SchurOperator
    preconditioner: PrimalPreconditioner
    coarse: PrimalCoarseProblem
    deflation: DeflationSpace
    inertia: Inertia
    max_ritz_vectors: int

    name = "primal"
    has_krylov_tolerance = False
    measures_error = True

    @property
    def method(self) -> str:
        """PETSc's name of the Krylov method."""
        return select_method(
            is_symmetric=self.pattern.is_symmetric, is_indefinite=self.deflation.is_indefinite
        )

    @property
    def solves_indefinite(self) -> bool:
        """Whether the Krylov method solves with an indefinite matrix."""
        return KRYLOV_METHODS[self.method].solves_indefinite

    @property
    def delta(self) -> Array:
        """Weight δ of every torn dof, (n,)."""
        return self.preconditioner.delta

    @property
    def modes(self) -> tuple[SubdomainModes, ...]:
        """R, E and D of each subdomain."""
        return self.preconditioner.inverse.modes

    @property
    def deflation_count(self) -> int:
        """Number of vectors W by which solves are deflated."""
        return self.deflation.count

    @property
    def system(self) -> PrimalSystem:
        """A_Γ and its preconditioner; a view of parts of this object, created at each access."""
        return PrimalSystem(
            deflation=self.deflation,
            multiply_local=self.operator.multiply_on_interface,
            solve_local=self.preconditioner.inverse.solve_regularised_on_interface,
        )

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
        """Solve for an assembled right-hand side and prescribed values. Collective.

        Args:
            r: Right-hand side: b, or in a fresh start the residual b − A x of the solution x so
                far, (N,).
            u_D: Prescribed values on the torn Dirichlet dofs, zero on others, (n,).
            target: Largest ‖r − A z‖ that is accepted.
            max_it: Largest number of iterations.
            monitor: Called with the number of iterations and ‖r − A z‖.
            error_test: Test that the estimated error has to pass as well; None to skip it.
            allow_indefinite: Whether the solution is wanted if the matrix is indefinite.

        Returns:
            u with equal copies, (n,), and how the Krylov method ended.
        """
        f = self._torn_load(r, u_D)
        method = KRYLOV_METHODS[self.method]
        with event("FETIIterations"):
            x_Γ, info, basis = method.solve(
                self.system,
                self._condense(f),
                StoppingTest(target, max_it, self._error_test_on_interface(error_test)),
                monitor=monitor,
                stored_iterations=STORED_ITERATIONS_PER_VECTOR * self.max_ritz_vectors,
                allow_indefinite=allow_indefinite,
            )
        with event("FETIRecycling"):
            vectors = recycled_vectors(self.deflation, basis, max_count=self.max_ritz_vectors)
        info = replace(
            info, ritz_vectors=vectors, measured_error=self._assembled_error(info.measured_error)
        )
        has_definite_M = self.preconditioner.inertia.local == 0  # no K_ρ is indefinite
        if info.reason == Reason.DIVERGED_INDEFINITE_PC and has_definite_M:
            # rᵀ z ≤ 0 was a rounding error, and a fresh start helps.
            info = replace(info, reason=Reason.ITERATING, needs_fresh_start=True)
        return self._extended(x_Γ, f) + u_D, info

    def precondition(self, r: PETSc.Vec) -> Array:
        """Return an approximate solution z of A z = r without iterations. Collective.

        On the interface z is the initial guess of the coarse space, plus the preconditioned
        residual of this guess.

        Args:
            r: Assembled residual, (N,).

        Returns:
            z on the torn dofs with equal copies, (n,).
        """
        f = self._torn_load(r, np.zeros(self.pattern.torn.n))
        condensed = self._condense(f)
        system = self.system
        x_Γ = system.deflation.initial_guess(system.copies.sum(condensed))
        z_Γ, _ = system.precondition(system.residual(condensed, x_Γ))
        return self._extended(x_Γ + z_Γ, f)

    def _torn_load(self, r: PETSc.Vec, u_D: Array) -> Array:
        """Return f = δ T r − K u_D, zero on Dirichlet dofs, (n,). Collective.

        Args:
            r: Assembled right-hand side, (N,).
            u_D: Prescribed values on the torn Dirichlet dofs, zero on others, (n,).
        """
        torn = self.pattern.torn
        f = self.delta * torn.tear(r.array_r) - torn.multiply(u_D)  # f = δ T r − K u_D
        f[torn.is_dirichlet_copy] = 0.0
        return f

    def _condense(self, f: Array) -> Array:
        """Return f_Γ − K_ΓI K_II⁻¹ f_I, (n_Γ,), of a torn load, (n,)."""
        return self.operator.interface_load(f)[self.preconditioner.copies.dofs]

    def memory(self) -> float:
        """Return the memory of S and of all factors of subdomains of this process in MiB."""
        return self.operator.memory() + self.preconditioner.inverse.memory()

    def deflation_memory(self) -> float:
        """Return the memory of W and its products on this process in MiB."""
        return self.deflation.memory()

    def preconditioner_for_later_matrix(self) -> PrimalPreconditioner:
        """Return the preconditioner for a later matrix, which has the same coarse columns.

        Their independent combinations serve the later matrix, too.
        """
        return self.preconditioner.for_later_matrix(self.coarse.combinations)

    def setup_for_dual(self) -> Setup | None:
        """Return S, δ and K_ρ⁻¹ for the dual formulation of this matrix.

        It is None if the dual formulation cannot replace this one: the options choose the primal
        one, or the matrix is not symmetric.
        """
        if self.pattern.options.formulation != "auto" or not self.pattern.is_symmetric:
            return None
        M = self.preconditioner
        return Setup(self.operator, M.delta, M.inverse, M.inertia)

    def _extended(self, x_Γ: Array, f: Array) -> Array:
        """Return u with u_Γ = T x_Γ and u_I = K_II⁻¹ (f_I − K_IΓ u_Γ), (n,).

        Args:
            x_Γ: Interface displacement by copies, (n_Γ,).
            f: Torn load, (n,).
        """
        u = np.zeros(self.pattern.torn.n)
        u[self.preconditioner.copies.dofs] = x_Γ
        return self.operator.extend(u, f)

    def _assembled(self, r: Array) -> Array:
        """Return an interface vector given by copies, (n_Γ,), as an assembled one, (N,)."""
        copies = self.preconditioner.copies
        torn = self.pattern.torn
        t = np.zeros(torn.n)
        t[copies.dofs] = copies.delta * r
        return torn.assemble(t)

    def _assembled_error(self, error: ErrorMeasurement | None) -> ErrorMeasurement | None:
        """Return η with its residual as an assembled vector, (N,), instead of by copies."""
        return None if error is None else replace(error, residual=self._assembled(error.residual))

    def _error_test_on_interface(self, error_test: ErrorTest | None) -> InterfaceErrorTest | None:
        """Return the test of η on the interface; None if its tolerance is infinite. Collective.

        Args:
            error_test: The test with vectors of the assembled problem.
        """
        if error_test is None or np.isinf(error_test.error_tolerance):
            return None
        copies = self.preconditioner.copies
        torn = self.pattern.torn
        components = error_test.norms.components_of(copies.dofs)
        second_reference = torn.tear(error_test.second_reference)[copies.dofs]
        return InterfaceErrorTest(
            norms=error_test.norms,
            copies=copies,
            components=components,
            solution=torn.tear(error_test.x)[copies.dofs],
            reference_squares=error_test.norms.weighted_squares(
                second_reference, copies.delta, components
            ),
            error_tolerance=error_test.error_tolerance,
        )


def create_primal_formulation(
    pattern: Pattern,
    operator: SchurOperator,
    preconditioner: PrimalPreconditioner,
    matrix_objects: Lifetime,
    vectors: DeflationVectors | None = None,
    *,
    max_ritz_vectors: int = 0,
) -> PrimalFormulation:
    """Set up the primal formulation of the current matrix. Collective.

    Args:
        pattern: Pattern of the matrix.
        operator: Schur complements S of the matrix, and K_II⁻¹.
        preconditioner: Preconditioner of the matrix or of an earlier one.
        matrix_objects: Owner of Vᵀ A_Γ and A₀, which destroys them.
        vectors: Ritz vectors of a solve with an earlier matrix; None if there are none, as in the
            first solve of Newton's method and outside of it.
        max_ritz_vectors: Largest number of Ritz vectors that a solve returns for later matrices.

    Raises:
        SingularError: A body can move rigidly, or the matrix has a mechanism.
        SetUpError: The coarse solver is not accurate.
    """
    options = pattern.subsolvers.coarse
    with event("FETICoarse"):
        require_supported(pattern.torn, pattern.bodies)
        if not operator.is_interior_eliminated:
            require_regular_interior_blocks(pattern, operator)
        coarse = create_primal_coarse_problem(
            preconditioner.V,
            operator,
            options=options,
            is_symmetric=pattern.is_symmetric,
            combinations=preconditioner.combinations,
            allow_single_precision=not preconditioner.is_reused,
        )
        matrix_objects.own(coarse)
        require_accurate_solver(coarse.A_0, coarse.solver, options)
        _require_no_mechanism(pattern, operator, preconditioner, coarse)
    if vectors is None:
        vectors = _soft_fields_if_softened(pattern, operator, preconditioner, coarse)
    deflation = create_deflation_space(coarse, operator, vectors, is_symmetric=pattern.is_symmetric)
    interior = sum_if_known(operator.count_negative_interior_eigenvalues, pattern.torn.comm)
    negative = coarse.negative_eigenvalues
    assembled = None if negative is None or interior is None else negative + interior
    return PrimalFormulation(
        pattern=pattern,
        operator=operator,
        preconditioner=preconditioner,
        coarse=coarse,
        deflation=deflation,
        inertia=replace(preconditioner.inertia, interior=interior, assembled=assembled),
        max_ritz_vectors=max_ritz_vectors,
    )


def _require_no_mechanism(
    pattern: Pattern,
    operator: SchurOperator,
    preconditioner: PrimalPreconditioner,
    coarse: PrimalCoarseProblem,
) -> None:
    """Raise a SingularError if a field of the coarse space has zero energy. Collective.

    A combination of dependent columns has zero energy, too; its field vanishes, and
    ``ZeroEnergyFields.has_mechanism`` excludes it. If a null space is attached to the matrix, its
    fields have zero energy, and nothing is checked.
    """
    torn = pattern.torn
    zero_energy_fields = coarse.zero_energy_fields
    count = zero_energy_fields.count()
    if not count or has_null_space(torn) or not zero_energy_fields.has_mechanism():
        return
    fields = np.zeros((torn.n, min(count, MAX_MOTIONS)))
    for j in range(fields.shape[1]):
        on_interface = np.zeros(torn.n)
        on_interface[preconditioner.copies.dofs] = zero_energy_fields.field(j)
        fields[:, j] = operator.extend(on_interface, np.zeros(torn.n))
    is_semidefinite = pattern.is_symmetric and preconditioner.inertia.is_definite
    require_no_mechanism(torn, pattern.bodies, fields, is_semidefinite=is_semidefinite)


def _soft_fields_if_softened(
    pattern: Pattern,
    operator: SchurOperator,
    preconditioner: PrimalPreconditioner,
    coarse: PrimalCoarseProblem,
) -> DeflationVectors | None:
    """Return soft fields for a solve without Ritz vectors of an earlier one. Collective.

    Without stress that softens a subdomain, the preconditioned operator has no eigenvalues below
    one, and there is nothing to deflate.

    Returns:
        W and M⁻¹ W; None if no subdomain is softened, if A₀ is not symmetric or not definite, if a
        null space is attached, or if the options switch deflation off. The fields of a null space
        have zero energy and would hide the soft ones. Deflating them costs iterations: 112 instead
        of 9 with springs on single subdomains whose sum is zero.
    """
    count = pattern.options.deflation
    inverse = preconditioner.inverse
    if not pattern.is_symmetric or coarse.negative_eigenvalues or not count:
        return None
    if has_null_space(pattern.torn):
        return None
    if not _is_softened(inverse, pattern.torn.comm):
        return None
    with event("FETIRecycling"):
        return soft_fields(coarse, operator, inverse, count=count)


def _is_softened(inverse: GeneralizedInverse, comm: MPI.Comm) -> bool:
    """Return True if stress softens a subdomain of any process. Collective."""
    is_softened = any(modes.is_softened for modes in inverse.modes)
    return bool(comm.allreduce(is_softened, op=MPI.LOR))
