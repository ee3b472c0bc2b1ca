# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""What the dual and the primal formulation have in common, for the files that use either.

A formulation is set up for one matrix :math:`A = T^⊤ K T`. ``solve`` takes an assembled right-hand
side r and returns a torn displacement u with equal copies of each dof, so that
:math:`A\, T^⊤ δ u = r`; ``precondition`` does the same approximately, without iterations.
"""

from __future__ import annotations

from typing import Protocol

from petsc4py import PETSc

from dolfinx_feti.feti.accuracy import ErrorTest
from dolfinx_feti.feti.coarse.dual_problem import DualCoarseProblem
from dolfinx_feti.feti.coarse.primal_problem import PrimalCoarseProblem
from dolfinx_feti.feti.monitor import Monitor
from dolfinx_feti.feti.pattern import Pattern
from dolfinx_feti.feti.primal.preconditioner import PrimalPreconditioner
from dolfinx_feti.feti.setup import Inertia, Setup
from dolfinx_feti.feti.solve_info import KrylovInfo
from dolfinx_feti.feti.subdomain.modes import SubdomainModes
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
from dolfinx_feti.runtime.arrays import Array


class Formulation(Protocol):
    """The method, set up for one matrix."""

    @property
    def name(self) -> str:
        """``dual`` or ``primal``."""

    @property
    def method(self) -> str:
        """PETSc's name of the Krylov method."""

    @property
    def pattern(self) -> Pattern:
        """What depends on the pattern of the matrix alone."""

    @property
    def operator(self) -> SchurOperator:
        """S, and K_II⁻¹."""

    @property
    def delta(self) -> Array:
        """Weight δ of every torn dof, (n,), perhaps of the matrix of a reused preconditioner."""

    @property
    def modes(self) -> tuple[SubdomainModes, ...]:
        """R, E and D of each subdomain."""

    @property
    def coarse(self) -> DualCoarseProblem | PrimalCoarseProblem:
        """The coarse problem, with N (dual) or A₀ (primal)."""

    @property
    def inertia(self) -> Inertia:
        """Numbers of negative eigenvalues."""

    @property
    def solves_indefinite(self) -> bool:
        """Whether the Krylov method solves with an indefinite matrix."""

    @property
    def measures_error(self) -> bool:
        """Whether the Krylov method tests η of its iterates; else only the outer loop does."""

    @property
    def has_krylov_tolerance(self) -> bool:
        """Whether ``feti_dual_ksp_rtol`` or ``_atol`` ends the Krylov method, by PETSc's own test.

        The solve ends with it then, even if the residual of the assembled system or η is above the
        tolerance of the KSP.
        """

    @property
    def deflation_count(self) -> int:
        """Number of vectors W that deflate the solves (primal): Ritz vectors, or soft fields.

        A first solve, without Ritz vectors of an earlier one, is deflated by soft fields.
        """

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
        """Solve A x = r for an assembled right-hand side. Collective.

        An error of local work in the iterations is stored in ``pattern.errors``, and NaN takes
        the place of the result. The caller raises it on all processes.

        Args:
            r: Right-hand side, (N,): b, or the residual of an earlier start.
            u_D: Prescribed values on the torn Dirichlet dofs, zero elsewhere, (n,).
            target: Largest ‖r − A x‖ that ends the Krylov method.
            max_it: Largest number of iterations.
            monitor: Called with each iteration and its ‖r − A x‖.
            error_test: Test of η that the solution has to pass as well; None if the residual alone
                decides. The dual formulation ignores it (``measures_error``).
            allow_indefinite: Whether to solve if A is indefinite. A method that does not depend on
                the signs of eigenvalues ignores it.

        Returns:
            u, (n,), and how the Krylov method ended.
        """

    def precondition(self, r: PETSc.Vec) -> Array:
        """Return T z with z ≈ A⁻¹ r, (n,), for an assembled residual r, (N,). Collective.

        z is the approximate solution without iterations: in the dual form the displacement of the
        balanced start, in the primal form the coarse solution and one application of the
        preconditioner. It is written M r, with an M that is (N, N): not that of the dual form,
        which is (m, m).

        Errors of local work are stored as in :meth:`solve`.
        """

    def memory(self) -> float:
        """Return the memory of all factors of this process in MiB."""

    def deflation_memory(self) -> float:
        """Return the memory of the Ritz vectors of this process in MiB."""

    def preconditioner_for_later_matrix(self) -> PrimalPreconditioner | None:
        """Return the preconditioner for a later matrix; None if none can serve it (dual)."""

    def setup_for_dual(self) -> Setup | None:
        """Return S, δ and K_ρ⁻¹ for the dual formulation of this matrix.

        It is None if that cannot replace this one: this is the dual one itself, the options choose
        another one, or the matrix is not symmetric.
        """
