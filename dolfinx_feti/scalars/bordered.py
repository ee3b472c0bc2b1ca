# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Bordered systems, with a few scalar unknowns s in addition to x, by block elimination.

.. math:: A\, x + B\, s = b, \quad C^⊤ x + D\, s = d: \qquad
          A\, y = b, \; A\, X = B, \quad (D - C^⊤ X)\, s = d - C^⊤ y, \quad x = y - X s

with columns B, C, (N, m), of any units, for m scalars and N dofs of this process. A solve takes
four steps:

1. y = A⁻¹ b,
2. X = A⁻¹ B (``columns``), which starts from the X of the last matrix,
3. s and x by block elimination (``border``),
4. corrections of x and s for their residuals (``refinement``).

If A is nearly singular, y and X are inaccurate, but x and s are not (Keller, The bordering
algorithm and path following near singular points of higher nullity, 1983). If nothing resists rigid
motions, point springs are added to A during the solve (``springs``).

Residuals and the estimated error η are tested here for the whole system; the KSP gets the outcome
as its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.converged_reason import composed_outcome
from dolfinx_feti.feti.solve_info import SolveInfo
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.scalars.border import BlockElimination, Border
from dolfinx_feti.scalars.bordered_system import FIRST_RTOL, BorderedSystem, create_bordered_system
from dolfinx_feti.scalars.columns import Columns, solve_for_columns
from dolfinx_feti.scalars.matrix_solver import MatrixSolveError, MatrixSolver
from dolfinx_feti.scalars.refinement import refine
from dolfinx_feti.scalars.springs import PointSprings

__all__ = ["BorderedSolver"]

Reason = PETSc.KSP.ConvergedReason

#: Failure if S is singular.
SINGULAR_BORDER = (
    "the bordered matrix is singular: the equations of the scalars contradict each other, depend "
    "on each other, do not depend on the unknowns, or leave a rigid motion free"
)


@dataclass(frozen=True, slots=True)
class _Solution:
    """A solution of a bordered system, or the best after a failure.

    Attributes:
        x: First unknown, (N,).
        s: Scalars, (m,); zeros if a solve with A failed or S is singular.
        info: How the solve of the bordered system has ended.
        error_tolerance: Tolerance of η.
    """

    x: Array
    s: Array
    info: SolveInfo
    error_tolerance: float


class BorderedSolver:
    """Solver of bordered systems with a FETI KSP.

    The springs, and the elimination of the last solve, are reused: X by the next solve, and both by
    :meth:`correction` and :meth:`error_of_scalars`, which need no further solve.

    Attributes:
        iterations: Krylov iterations of the last solve, of all right-hand sides.
    """

    def __init__(self) -> None:
        """Create a solver without springs and elimination."""
        self.iterations = 0
        self._springs: PointSprings | None = None
        #: Of the last solve with these springs in which no solve with A failed.
        self._elimination: BlockElimination | None = None

    def solve(
        self, ksp: PETSc.KSP, A: PETSc.Mat, b: Array, border: Border, d: Array
    ) -> tuple[Array, Array]:
        """Solve, to the tolerances of the KSP. Collective.

        Args:
            ksp: A KSP with a FETI context; its converged reason is that of the bordered system.
            A: Torn matrix. If rigid motions are free, its diagonal has springs during the solve.
            b: First right-hand side, with prescribed values on Dirichlet dofs, (N,).
            border: B, C and D.
            d: Second right-hand side, (m,).

        Returns:
            x, (N,), and s, (m,).
        """
        if self._springs is None:
            self._springs = PointSprings(A)
        x, s = self._solve_with_springs(ksp, A, b, border, d, self._springs)
        if ksp.getPythonContext().singular and not self._springs.count:
            # Supports have been removed since the springs were chosen.
            self._springs = PointSprings(A)
            if self._springs.count:
                self._elimination = None  # that of another matrix, without springs
                x, s = self._solve_with_springs(ksp, A, b, border, d, self._springs)
        return x, s

    def _solve_with_springs(
        self,
        ksp: PETSc.KSP,
        A: PETSc.Mat,
        b: Array,
        border: Border,
        d: Array,
        springs: PointSprings,
    ) -> tuple[Array, Array]:
        """Solve with these springs, and store the outcome; see :meth:`solve`. Collective."""
        solver = MatrixSolver(ksp, A)
        with springs.added_to(A):
            extended = on_all(lambda: springs.extend(border), solver.comm)
            system = create_bordered_system(A, b, extended, d)
            solution = self._solve_in_steps(solver, system, b, springs)
        self.iterations = solver.iterations
        outcome = replace(solution.info, iterations=solver.iterations)
        solver.feti.store_outcome(ksp, outcome, solution.error_tolerance)
        return solution.x, extended.without_springs(solution.s)

    def _solve_in_steps(
        self, solver: MatrixSolver, system: BorderedSystem, b: Array, springs: PointSprings
    ) -> _Solution:
        """Solve the bordered system in the four steps of this file. Collective.

        Args:
            solver: Solves with A.
            system: The bordered system.
            b: First right-hand side, with prescribed values on Dirichlet dofs, (N,).
            springs: The springs in A.
        """
        y, info = solver.solve(b)  # 1. A y = b
        failed = _Solution(y, np.zeros_like(system.d), info, info.accuracy.rtol)
        if info.reason < 0:
            return failed
        try:
            columns = self._solve_for_columns(solver, system, y, springs)  # 2. A X = B
        except MatrixSolveError as failure:
            info = failure.info
            return replace(failed, info=info, error_tolerance=info.accuracy.rtol)
        elimination = columns.elimination
        self._elimination = elimination
        if elimination.is_singular:
            singular = replace(info, reason=Reason.DIVERGED_BREAKDOWN, message=SINGULAR_BORDER)
            return replace(failed, info=singular)
        x, s = elimination.solve(y, system.d)  # 3. x = y − X s
        refined = refine(solver, system, elimination, x, s)  # 4.
        residual = max(info.accuracy.residual, columns.relative_residual)
        info = replace(info, accuracy=replace(info.accuracy, residual=residual))
        outcome = composed_outcome(
            info,
            refined.error_estimate,
            total_error_estimate=refined.total_error_estimate,
            error_tolerance=refined.error_tolerance,
        )
        return _Solution(refined.x, refined.s, outcome, refined.error_tolerance)

    def _solve_for_columns(
        self, solver: MatrixSolver, system: BorderedSystem, y: Array, springs: PointSprings
    ) -> Columns:
        """Solve A X = B, from the X of the last elimination or from zero. Collective.

        Without an elimination, only the columns of the springs are known.

        Args:
            solver: Solves with A.
            system: The bordered system.
            y: A⁻¹ b, (N,).
            springs: The springs in A.

        Raises:
            MatrixSolveError: A solve with A has failed.
        """
        if self._elimination is None:
            first_X = np.zeros_like(system.border.B)
            first_X[:, system.border.count :] = springs.X
            first_rtol = solver.rtol
        else:
            first_X = self._elimination.X
            first_rtol = FIRST_RTOL
        first_X = np.where(system.is_free[:, None], first_X, 0.0)
        return solve_for_columns(solver, system, y, first_X, first_rtol=first_rtol)

    def correction(self, ksp: PETSc.KSP, r: Array, c: Array) -> tuple[Array, Array] | None:
        """Return approximate corrections of x and s, by the last elimination, without a solve.

        The preconditioner takes the place of A⁻¹ in the elimination. Collective.

        Args:
            ksp: The KSP of the last solve.
            r: Residual b − A x − B s, zero on Dirichlet dofs, (N,).
            c: Residual d − Cᵀ x − D s, (m,).

        Returns:
            Corrections of x, (N,), and s, (m,); None without a preconditioner, if no solve has
            succeeded yet, or if S of the last one is singular.
        """
        elimination = self._elimination
        if self._springs is None or elimination is None or elimination.is_singular:
            return None
        A, _ = ksp.getOperators()
        solver = MatrixSolver(ksp, A)
        with self._springs.added_to(A):
            z = solver.precondition(r)  # z ≈ A⁻¹ r
        if z is None:
            return None
        border = elimination.border
        dx, ds = elimination.solve(z, border.with_springs(c))
        return dx, border.without_springs(ds)

    def error_of_scalars(self, ds: Array, s: Array, x: Array) -> float:
        """Return η of the scalars for a correction of them, by the last elimination. Collective.

        See :meth:`BlockElimination.error_of_scalars
        <dolfinx_feti.scalars.border.BlockElimination.error_of_scalars>`.

        Args:
            ds: Change of s, (m,).
            s: Largest size of s_k among the iterates, (m,).
            x: Largest size of x_j among the iterates, (N,).

        Returns:
            η; zero if no solve has succeeded yet.
        """
        return 0.0 if self._elimination is None else self._elimination.error_of_scalars(ds, s, x)
