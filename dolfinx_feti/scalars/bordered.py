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
from dolfinx_feti.feti.solver import FETI
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.collective import on_all, total_of
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.scalars.border import BlockElimination, Border, without_zeros
from dolfinx_feti.scalars.springs import PointSprings
from dolfinx_feti.torn.matrix import read_dirichlet_mask

__all__ = ["BorderedSolver", "solve_ksp"]

Reason = PETSc.KSP.ConvergedReason

#: Largest number of corrections of X. One is often enough; this guards against endless loops.
MAX_CORRECTIONS = 4

#: Relative residual ‖B_k − A X_k‖/‖B_k‖ up to which a column of an earlier matrix's X is first
#: corrected. It is a rough start on purpose: the s that follows from it determines how accurate X
#: has to be. It is also the largest residual that any s allows. A choice, not measured.
FIRST_RTOL = 1e-2

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


class _MatrixSolver:
    """Solves with A alone by the KSP, to its tolerances or to others.

    Attributes:
        A: Torn matrix, with the springs.
        comm: Communicator.
        rtol: Relative tolerance of the KSP.
        atol: Absolute tolerance of the KSP.
        iterations: Krylov iterations of all solves so far.
    """

    def __init__(self, ksp: PETSc.KSP, A: PETSc.Mat) -> None:
        """Store the parts of the solver; no iterations so far.

        Args:
            ksp: A KSP with a FETI context.
            A: Torn matrix.
        """
        self._ksp = ksp
        self.A = A
        self.comm: MPI.Comm = A.comm.tompi4py()
        rtol, atol, *_ = ksp.getTolerances()
        self.rtol: float = rtol
        self.atol: float = atol
        self.iterations = 0

    @property
    def feti(self) -> FETI:
        """The context of the KSP."""
        context: FETI = self._ksp.getPythonContext()
        return context

    def solve(self, b: Array) -> tuple[Array, SolveInfo]:
        """Solve A x = b to the tolerances of the KSP. Collective.

        Args:
            b: Right-hand side, with prescribed values on Dirichlet dofs, (N,).

        Returns:
            x, (N,), and how the solve has ended.
        """
        x = solve_ksp(self._ksp, self.A, b)
        info = self.feti.info
        self.iterations += info.iterations
        return x, info

    def solve_to(self, b: Array, *, rtol: float, atol: float) -> tuple[Array, SolveInfo]:
        """Solve A x = b to other tolerances, and set those of the KSP back. Collective.

        Args:
            b: Right-hand side, (N,).
            rtol: Relative tolerance of this solve.
            atol: Absolute tolerance of this solve.

        Returns:
            x, (N,), and how the solve has ended.
        """
        self._ksp.setTolerances(rtol=rtol, atol=atol)
        try:
            return self.solve(b)
        finally:
            self._ksp.setTolerances(rtol=self.rtol, atol=self.atol)

    def precondition(self, r: Array) -> Array | None:
        """Return z ≈ A⁻¹ r, (N,), by one application of the preconditioner. Collective.

        Args:
            r: Residual, zero on Dirichlet dofs, (N,).

        Returns:
            z, (N,); None if nothing can be set up for the matrix.
        """
        return self.feti.correction(self._ksp, r)


@dataclass(frozen=True, slots=True)
class _System:
    """One bordered system; A has the springs, and the border their forces.

    Attributes:
        A: Torn matrix.
        free: Mask of the dofs without a prescribed value, (N,).
        b: First right-hand side, zero on Dirichlet dofs, (N,).
        B: B of the border with zeros on Dirichlet dofs, (N, m).
        border: B, C and D.
        d: Second right-hand side, (m,).
        b_norm: ‖b‖.
        B_norms: Norms of the columns B_k, (m,).
        comm: Communicator.
    """

    A: PETSc.Mat
    free: Mask
    b: Array
    B: Array
    border: Border
    d: Array
    b_norm: float
    B_norms: Array
    comm: MPI.Comm

    def scale(self, s: Array) -> float:
        """Return ‖b‖ + Σ ‖B_k‖ |s_k|, which relative residuals refer to."""
        return self.b_norm + float(np.abs(s) @ self.B_norms)

    def product(self, X: Array) -> Array:
        """Return A X with zeros on Dirichlet dofs, (N, k). Collective."""
        Y = np.zeros_like(X)
        with Lifetime() as owned:
            x, y = map(owned.own, self.A.createVecs())
            for k in range(X.shape[1]):
                x.array[:] = X[:, k]
                self.A.mult(x, y)
                Y[:, k] = np.where(self.free, y.array_r, 0.0)
        return Y

    def residual(self, x: Array, s: Array) -> tuple[Array, Array]:
        """Return b − A x − B s, (N,), and d − Cᵀ x − D s, (m,). Collective."""
        r = self.b - (self.product(x[:, None])[:, 0] + self.B @ s)
        c = self.d - total_of(self.border.C.T @ x, self.comm) - self.border.D @ s
        return r, c

    def allowed_residuals(self, s: Array, *, rtol: float, atol: float) -> Array:
        """Return the largest ‖B_k − A X_k‖ with which x and s meet the tolerances, (m,).

        Each of the m columns may contribute a share 1/m of the tolerance.

        Args:
            s: The scalars, (m,).
            rtol: Relative tolerance.
            atol: Absolute tolerance.
        """
        allowed = max(rtol * self.scale(s), atol) / without_zeros(len(s) * np.abs(s))
        return np.fmin(allowed, FIRST_RTOL * self.B_norms)


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


class BorderedSolver:
    """Solver of bordered systems with a FETI KSP. X and the springs are reused by the next solve.

    The border and the X of the last solve also serve :meth:`correction` and
    :meth:`error_of_correction`, which need no further solve.

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
        solver = _MatrixSolver(ksp, A)
        with springs.added_to(A):
            y, info = solver.solve(b)  # y = A⁻¹ b
            extended = on_all(lambda: springs.extend(border), solver.comm)
            system = _create_system(A, b, extended, d)
            X, has_earlier_X = self._first_X(system, springs)
            solution = _solve_system(solver, system, y, info, X, has_earlier_X=has_earlier_X)
        self._border = extended
        if solution.X is not None:
            self._X = solution.X
        self.iterations = solver.iterations
        outcome = replace(solution.info, iterations=solver.iterations)
        solver.feti.store_outcome(ksp, outcome, solution.error_tolerance)
        return solution.x, extended.without_springs(solution.s)

    def _first_X(self, system: _System, springs: PointSprings) -> tuple[Array, bool]:
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
        solver = _MatrixSolver(ksp, A)
        with self._springs.added_to(A):
            z = solver.precondition(r)  # z ≈ A⁻¹ r
        if z is None or self._border is None or self._X is None:
            return None
        elimination = BlockElimination(self._border, self._X, solver.comm)
        dx, ds = elimination.solve(z, self._border.with_springs(c))
        return dx, self._border.without_springs(ds)

    def error_of_correction(self, ds: Array, s: Array, x: Array, comm: MPI.Comm) -> float:
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


def _create_system(A: PETSc.Mat, b: Array, border: Border, d: Array) -> _System:
    """Create a bordered system. Collective.

    Args:
        A: Torn matrix, with the springs.
        b: First right-hand side, with any values on Dirichlet dofs, (N,).
        border: B, C and D of m scalars, the forces of the springs among them.
        d: Second right-hand side of the scalars without these forces, (m − springs,).
    """
    comm = A.comm.tompi4py()
    free = ~read_dirichlet_mask(A)
    b = np.where(free, b, 0.0)
    B = np.where(free[:, None], border.B, 0.0)
    return _System(
        A=A,
        free=free,
        b=b,
        B=B,
        border=border,
        d=border.with_springs(d),
        b_norm=float(_norms(b[:, None], comm)[0]),
        B_norms=_norms(B, comm),
        comm=comm,
    )


def _solve_system(
    solver: _MatrixSolver,
    system: _System,
    y: Array,
    info: SolveInfo,
    X: Array,
    *,
    has_earlier_X: bool,
) -> _Solution:
    """Solve a bordered system for y = A⁻¹ b. Collective.

    If a solve with A fails or S is singular, nothing is refined, and the outcome is this failure.
    If a refinement fails, the best solution before it is returned.

    Args:
        solver: Solves with A.
        system: The bordered system.
        y: A⁻¹ b, (N,).
        info: How the solve for y has ended.
        X: First iterate of X, (N, m), overwritten.
        has_earlier_X: Whether it is the X of an earlier matrix.
    """
    no_scalars = np.zeros_like(system.d)
    if info.reason < 0:
        return _Solution(y, no_scalars, None, info, info.accuracy.rtol)
    columns, info = _correct_columns(solver, system, y, info, X, has_earlier_X=has_earlier_X)
    if columns is None:
        return _Solution(y, no_scalars, None, info, info.accuracy.rtol)
    elimination = columns.elimination
    x, s = elimination.solve(y, system.d)
    if elimination.is_singular:
        info = replace(info, reason=Reason.DIVERGED_BREAKDOWN, message=SINGULAR_BORDER)
        return _Solution(x, s, elimination.X, info, info.accuracy.rtol)
    residual = max(info.accuracy.residual, columns.relative_residual)
    info = replace(info, accuracy=replace(info.accuracy, residual=residual))
    tolerance, second_reference = _error_tolerance(solver, system, s)
    refined = _refine(solver, system, elimination, x, s, tolerance, second_reference)
    outcome = composed_outcome(info, refined.error_estimate, tolerance)
    return _Solution(refined.x, refined.s, elimination.X, outcome, tolerance)


def _correct_columns(
    solver: _MatrixSolver,
    system: _System,
    y: Array,
    info: SolveInfo,
    X: Array,
    *,
    has_earlier_X: bool,
) -> tuple[_Columns | None, SolveInfo]:
    """Correct the columns of X until they are as accurate as s requires. Collective.

    The columns of an earlier X are first corrected to :data:`FIRST_RTOL`; without one, all are
    computed to the tolerance of the KSP. Each pass then computes s, and from it the residual that
    each column may have. The next pass corrects the columns above their bounds. After
    :data:`MAX_CORRECTIONS` passes, the columns are returned as they are.

    Args:
        solver: Solves with A.
        system: The bordered system.
        y: A⁻¹ b, (N,).
        info: How the solve for y has ended.
        X: First iterate of X, (N, m), overwritten.
        has_earlier_X: Whether it is the X of an earlier matrix.

    Returns:
        The columns, or None if a solve failed; and how the last solve has ended.
    """
    R = system.B - system.product(X)  # B − A X
    first_rtol = FIRST_RTOL if has_earlier_X else solver.rtol
    allowed = first_rtol * system.B_norms
    for _ in range(MAX_CORRECTIONS):
        for k in np.flatnonzero(_norms(R, system.comm) > allowed):
            correction, info = solver.solve_to(R[:, k], rtol=0.0, atol=TARGET_FACTOR * allowed[k])
            if info.reason < 0:
                return None, info
            X[:, k] += correction
            R[:, k : k + 1] = system.B[:, k : k + 1] - system.product(X[:, k : k + 1])
        elimination = BlockElimination(system.border, X, system.comm)
        s = elimination.solve_for_scalars(y, system.d)
        residuals = _norms(R, system.comm)
        allowed = system.allowed_residuals(s, rtol=solver.rtol, atol=solver.atol)
        if elimination.is_singular or np.all(residuals <= allowed):
            break
    relative_residual = float(np.abs(s) @ residuals) / (system.scale(s) or 1.0)
    return _Columns(elimination, relative_residual), info


def _error_tolerance(solver: _MatrixSolver, system: _System, s: Array) -> tuple[float, Array]:
    """Return the tolerance of η, and a second reference for η, (N,); see ``SolveSettings``."""
    tolerance = max(solver.rtol, solver.atol / (system.scale(s) or np.inf))
    return solver.feti.settings.loosen(tolerance, len(system.b))


def _refine(
    solver: _MatrixSolver,
    system: _System,
    elimination: BlockElimination,
    x: Array,
    s: Array,
    error_tolerance: float,
    second_reference: Array,
) -> _Refined:
    """Correct x and s until their estimated error η is at its tolerance. Collective.

    Args:
        solver: Solves with A.
        system: The bordered system.
        elimination: Block elimination of the system.
        x: Solution of the elimination, (N,).
        s: Its scalars, (m,).
        error_tolerance: Tolerance of η.
        second_reference: Reference of η in addition to x, (N,).

    Returns:
        The solution with the smallest η; η is nan without a preconditioner.
    """
    without_springs = system.border.without_springs
    best = _Refined(x, s, np.inf)
    for _ in range(1 + MAX_REFINEMENTS):
        r, c = system.residual(x, s)
        z = solver.precondition(r)  # z ≈ A⁻¹ r
        if z is None:
            break
        dx, ds = elimination.solve(z, c)
        η_x = solver.feti.error_of_correction(dx, [x, second_reference])
        η_s = elimination.error_of_scalars(without_springs(ds), without_springs(s), x)
        η = max(η_x, η_s)
        has_gained = η <= REFINEMENT_GAIN * best.error_estimate
        if η < best.error_estimate:
            best = _Refined(x, s, η)
        if not η > error_tolerance or not has_gained:
            break
        y, info = solver.solve_to(r, rtol=TARGET_FACTOR * error_tolerance / η, atol=0.0)
        if info.reason < 0:
            break  # the best solution so far is returned
        dx, ds = elimination.solve(y, c)
        x = x + dx
        s = s + ds
    if np.isinf(best.error_estimate):
        return replace(best, error_estimate=np.nan)
    return best


def solve_ksp(ksp: PETSc.KSP, A: PETSc.Mat, b: Array) -> Array:
    """Solve A x = b; return x, (N,), for b, (N,). Collective."""
    with Lifetime() as owned:
        rhs, x = map(owned.own, A.createVecs())
        rhs.array[:] = b
        ksp.setOperators(A)
        ksp.solve(rhs, x)
        return x.array_r.copy()


def _norms(X: Array, comm: MPI.Comm) -> Array:
    """Return the norms of columns over all processes, (k,)."""
    return np.sqrt(total_of((X**2).sum(axis=0), comm))
