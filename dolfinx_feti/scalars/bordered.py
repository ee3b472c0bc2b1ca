# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Bordered systems, with a few scalar unknowns s in addition to x, by block elimination.

.. math:: A\, x + B\, s = b, \quad C^⊤ x + D\, s = d: \qquad
          A\, y = b, \; A\, X = B, \quad (D - C^⊤ X)\, s = d - C^⊤ y, \quad x = y - X s

with columns B, C, (N, m), of any units, for m scalars and N dofs of this process. X starts from
that of the last matrix. The columns of X need only the accuracy at which their contribution
:math:`\|B_k - A X_k\|\, |s_k|` to the residual is small. If A is nearly singular, y and X are
inaccurate, but x and s are not (Keller, The bordering algorithm and path following near singular
points of higher nullity, 1983). If nothing resists rigid motions, point springs are added to A
during the solve (``springs``).

A solve takes four steps:

1. y = A⁻¹ b,
2. X = A⁻¹ B, column by column, as accurate as the s that follows from it requires,
3. s and x by block elimination (``border``),
4. corrections of x and s for their residuals, until their estimated error η is small.

Residuals and η are tested here for the whole system; the KSP gets the outcome as its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.converged_reason import composed_outcome
from dolfinx_feti.feti.solve_info import SolveInfo
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.scalars.border import BlockElimination, Border
from dolfinx_feti.scalars.bordered_system import (
    FIRST_RTOL,
    BorderedSystem,
    create_bordered_system,
    norms_of_columns,
)
from dolfinx_feti.scalars.matrix_solver import MatrixSolver
from dolfinx_feti.scalars.springs import PointSprings

__all__ = ["BorderedSolver"]

Reason = PETSc.KSP.ConvergedReason

#: Largest number of corrections of X. One is often enough; this guards against endless loops.
MAX_CORRECTIONS = 4

#: Target of a correction relative to the allowed residual or error: a margin, because rounding may
#: leave the KSP slightly above its target.
TARGET_FACTOR = 0.7

#: Largest number of refinements of x and s after the elimination. Each one reduces the error as
#: much as a solve does. A third one was never needed: this guards against endless loops.
MAX_REFINEMENTS = 4

#: Factor by which a refinement has to reduce the estimated error for another one to follow. At the
#: limit of rounding the error changes at random, which a factor near one would take for progress.
#: The same value as that of fresh starts (``outer_loop``).
REFINEMENT_GAIN = 0.5

#: Failure if S is singular.
SINGULAR_BORDER = (
    "the bordered matrix is singular: the equations of the scalars contradict each other, depend "
    "on each other, do not depend on the unknowns, or leave a rigid motion free"
)


@dataclass(frozen=True, slots=True)
class _Columns:
    """The columns of X after their corrections.

    Attributes:
        elimination: Block elimination with X.
        relative_residual: Bound of ‖(B − A X) s‖/(‖b‖ + Σ ‖B_k‖ |s_k|).
    """

    elimination: BlockElimination
    relative_residual: float


@dataclass(frozen=True, slots=True)
class _Refined:
    """A solution of a bordered system after refinement.

    Attributes:
        x: First unknown, (N,).
        s: Scalars, (m,).
        error_estimate: η, the largest of x and of the scalars; nan if it was not measured.
    """

    x: Array
    s: Array
    error_estimate: float


@dataclass(frozen=True, slots=True)
class _Solution:
    """A solution of a bordered system, or the best after a failure.

    Attributes:
        x: First unknown, (N,).
        s: Scalars, (m,).
        X: A⁻¹ B, (N, m); None if a solve with A failed.
        info: How the solve of the bordered system has ended.
        error_tolerance: Tolerance of η.
    """

    x: Array
    s: Array
    X: Array | None
    info: SolveInfo
    error_tolerance: float


class _SolveSteps:
    """Steps 2 to 4 of one solve: from y = A⁻¹ b to the refined x and s."""

    def __init__(self, solver: MatrixSolver, system: BorderedSystem) -> None:
        """Store what the steps share.

        Args:
            solver: Solves with A.
            system: The bordered system.
        """
        self._solver = solver
        self._system = system

    def run(self, y: Array, info: SolveInfo, X: Array, *, has_earlier_X: bool) -> _Solution:
        """Solve the bordered system. Collective.

        If a solve with A fails or S is singular, nothing is refined, and the outcome is this
        failure. If a refinement fails, the best solution before is returned.

        Args:
            y: A⁻¹ b, (N,).
            info: How the solve for y has ended.
            X: First iterate of X, (N, m), overwritten.
            has_earlier_X: Whether it is the X of an earlier matrix.
        """
        if info.reason < 0:
            return self._failed(y, info)
        first_rtol = FIRST_RTOL if has_earlier_X else self._solver.rtol
        columns, info = self._correct_columns(y, info, X, first_rtol)
        if columns is None:
            return self._failed(y, info)
        elimination = columns.elimination
        x, s = elimination.solve(y, self._system.d)
        if elimination.is_singular:
            info = replace(info, reason=Reason.DIVERGED_BREAKDOWN, message=SINGULAR_BORDER)
            return _Solution(x, s, elimination.X, info, info.accuracy.rtol)
        residual = max(info.accuracy.residual, columns.relative_residual)
        info = replace(info, accuracy=replace(info.accuracy, residual=residual))
        refined, error_tolerance = self._refine(elimination, x, s)
        outcome = composed_outcome(info, refined.error_estimate, error_tolerance)
        return _Solution(refined.x, refined.s, elimination.X, outcome, error_tolerance)

    def _failed(self, y: Array, info: SolveInfo) -> _Solution:
        """Return the solution without scalars after a failed solve with A.

        Args:
            y: A⁻¹ b or an approximation of it, (N,).
            info: How the solve has failed.
        """
        return _Solution(y, np.zeros_like(self._system.d), None, info, info.accuracy.rtol)

    def _correct_columns(
        self, y: Array, info: SolveInfo, X: Array, first_rtol: float
    ) -> tuple[_Columns | None, SolveInfo]:
        """Correct the columns of X until they are as accurate as s requires. Collective.

        The columns of an earlier X are first corrected to :data:`FIRST_RTOL`; without one, all are
        computed to the tolerance of the KSP. Each pass then computes s, and from it the residual
        that each column may have. Columns above theirs are corrected in the next pass.

        Args:
            y: A⁻¹ b, (N,).
            info: How the solve for y has ended.
            X: First iterate of X, (N, m), overwritten.
            first_rtol: Relative residual up to which the columns are first corrected.

        Returns:
            The columns, or None if a solve failed; and how the last solve has ended.
        """
        solver = self._solver
        system = self._system
        R = system.B - system.product(X)  # B − A X
        allowed = first_rtol * system.B_norms
        for _ in range(MAX_CORRECTIONS):
            for k in np.flatnonzero(norms_of_columns(R, system.comm) > allowed):
                atol = TARGET_FACTOR * allowed[k]
                correction, info = solver.solve_to(R[:, k], rtol=0.0, atol=atol)
                if info.reason < 0:
                    return None, info
                X[:, k] += correction
                R[:, k : k + 1] = system.B[:, k : k + 1] - system.product(X[:, k : k + 1])
            elimination = BlockElimination(system.border, X, system.comm)
            s = elimination.solve_for_scalars(y, system.d)
            residuals = norms_of_columns(R, system.comm)
            allowed = system.allowed_residuals(s, rtol=solver.rtol, atol=solver.atol)
            if elimination.is_singular or np.all(residuals <= allowed):
                break
        relative_residual = float(np.abs(s) @ residuals) / (system.scale(s) or 1.0)
        return _Columns(elimination, relative_residual), info

    def _refine(self, elimination: BlockElimination, x: Array, s: Array) -> tuple[_Refined, float]:
        """Correct x and s until their estimated error η is at its tolerance. Collective.

        Args:
            elimination: Block elimination of the system.
            x: Its solution, (N,).
            s: Its scalars, (m,).

        Returns:
            The solution with the smallest η, which is nan without a preconditioner; and the
            tolerance of η.
        """
        error_tolerance, second_reference = self._error_tolerance(s)
        best = _Refined(x, s, np.inf)
        for _ in range(1 + MAX_REFINEMENTS):
            r, c = self._system.residual(x, s)
            z = self._solver.precondition(r)  # z ≈ A⁻¹ r
            if z is None:
                break
            dx, ds = elimination.solve(z, c)
            η_x = self._solver.feti.error_of_correction(dx, [x, second_reference])
            η_s = self._error_of_scalars(elimination, ds, s, x)
            η = max(η_x, η_s)
            has_gained = η <= REFINEMENT_GAIN * best.error_estimate
            if η < best.error_estimate:
                best = _Refined(x, s, η)
            if not η > error_tolerance or not has_gained:
                break
            rtol = TARGET_FACTOR * error_tolerance / η
            y, info = self._solver.solve_to(r, rtol=rtol, atol=0.0)
            if info.reason < 0:
                break  # the best solution so far is returned
            dx, ds = elimination.solve(y, c)
            x = x + dx
            s = s + ds
        if np.isinf(best.error_estimate):
            best = replace(best, error_estimate=np.nan)
        return best, error_tolerance

    def _error_tolerance(self, s: Array) -> tuple[float, Array]:
        """Return the tolerance of η, and a second reference for η, (N,); see ``SolveSettings``.

        Args:
            s: Scalars that the absolute tolerance is relative to, (m,).
        """
        scale = self._system.scale(s) or np.inf
        tolerance = max(self._solver.rtol, self._solver.atol / scale)
        return self._solver.feti.settings.loosen(tolerance, len(self._system.b))

    def _error_of_scalars(
        self, elimination: BlockElimination, ds: Array, s: Array, x: Array
    ) -> float:
        """Return η of the scalars other than forces of springs. Collective.

        Args:
            elimination: Block elimination of the system.
            ds: Correction of the scalars, (m,).
            s: The scalars, (m,).
            x: The first unknown, (N,).
        """
        without_springs = self._system.border.without_springs
        return elimination.error_of_scalars(without_springs(ds), without_springs(s), x)


class BorderedSolver:
    """Solver of bordered systems with a FETI KSP. X and the springs are reused by the next solve.

    The border and the X of the last solve also serve :meth:`correction` and
    :meth:`error_of_scalars`, which need no further solve.

    Attributes:
        iterations: Krylov iterations of the last solve, of all right-hand sides.
    """

    def __init__(self) -> None:
        """Create a solver; its first solve starts from X = 0."""
        self.iterations = 0
        self._springs: PointSprings | None = None
        self._border: Border | None = None  # of the last solve, with springs
        self._X: Array | None = None  # of the last solve in which no solve with A failed

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
        """Solve with these springs, and store X and the outcome; see :meth:`solve`. Collective."""
        solver = MatrixSolver(ksp, A)
        with springs.added_to(A):
            y, info = solver.solve(b)  # y = A⁻¹ b
            extended = on_all(lambda: springs.extend(border), solver.comm)
            system = create_bordered_system(A, b, extended, d)
            X, has_earlier_X = self._first_X(system, springs)
            steps = _SolveSteps(solver, system)
            solution = steps.run(y, info, X, has_earlier_X=has_earlier_X)
        self._border = extended
        if solution.X is not None:
            self._X = solution.X
        self.iterations = solver.iterations
        outcome = replace(solution.info, iterations=solver.iterations)
        solver.feti.store_outcome(ksp, outcome, solution.error_tolerance)
        return solution.x, extended.without_springs(solution.s)

    def _first_X(self, system: BorderedSystem, springs: PointSprings) -> tuple[Array, bool]:
        """Return the first iterate of X, (N, m), and whether it is the X of an earlier matrix.

        Without one of this shape, it is zero in the columns of the scalars; the columns of the
        springs are known.
        """
        if self._X is not None and self._X.shape == system.B.shape:
            return np.where(system.free[:, None], self._X, 0.0), True
        X = np.zeros_like(system.B)
        if springs.count:
            X[:, -springs.count :] = springs.X
        return np.where(system.free[:, None], X, 0.0), False

    def correction(self, ksp: PETSc.KSP, r: Array, c: Array) -> tuple[Array, Array] | None:
        """Return approximate corrections of x and s, with the last border, without a solve.

        The preconditioner takes the place of A⁻¹ in the elimination. Collective.

        Args:
            ksp: The KSP of the last solve.
            r: Residual b − A x − B s, zero on Dirichlet dofs, (N,).
            c: Residual d − Cᵀ x − D s, (m,).

        Returns:
            Corrections of x, (N,), and s, (m,); None without a preconditioner, or before a
            solve.
        """
        if self._springs is None:
            return None
        A, _ = ksp.getOperators()
        solver = MatrixSolver(ksp, A)
        with self._springs.added_to(A):
            z = solver.precondition(r)  # z ≈ A⁻¹ r
        if z is None or self._border is None or self._X is None:
            return None
        elimination = BlockElimination(self._border, self._X, solver.comm)
        dx, ds = elimination.solve(z, self._border.with_springs(c))
        return dx, self._border.without_springs(ds)

    def error_of_scalars(self, ds: Array, s: Array, x: Array, comm: MPI.Comm) -> float:
        """Return η of the scalars for a correction of them, with the last border. Collective.

        See :meth:`BlockElimination.error_of_scalars
        <dolfinx_feti.scalars.border.BlockElimination.error_of_scalars>`.

        Args:
            ds: Change of s, (m,).
            s: Largest size of s_k among the iterates, (m,).
            x: Largest size of x_j among the iterates, (N,).
            comm: Communicator.

        Returns:
            η; zero without scalars, and before a solve.
        """
        if not len(ds) or self._border is None or self._X is None:
            return 0.0
        return BlockElimination(self._border, self._X, comm).error_of_scalars(ds, s, x)
