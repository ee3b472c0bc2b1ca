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
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.converged_reason import composed_outcome
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.collective import on_all, total_of
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.scalars.border import Border, BorderComplement, without_zeros
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


@dataclass(frozen=True, slots=True)
class _System:
    """One bordered system; A has the springs, and the border their forces.

    Attributes:
        ksp: A KSP with a FETI context.
        A: Torn matrix.
        free: Mask of the dofs without a prescribed value, (N,).
        b: First right-hand side, zero on Dirichlet dofs, (N,).
        B: B of the border with zeros on Dirichlet dofs, (N, m).
        border: B, C and D.
        d: Second right-hand side, (m,).
        count: Number of scalars without the forces of springs, which are the last scalars.
        b_norm: ‖b‖.
        B_norms: Norms of the columns B_k, (m,).
        comm: Communicator.
    """

    ksp: PETSc.KSP
    A: PETSc.Mat
    free: Mask
    b: Array
    B: Array
    border: Border
    d: Array
    count: int
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


@dataclass(frozen=True, slots=True)
class _Elimination:
    """The scalars by block elimination.

    Attributes:
        s: The scalars, (m,); zeros if a solve with A fails.
        relative_residual: Bound of ‖(B − A X) s‖/(‖b‖ + Σ ‖B_k‖ |s_k|); nan if a solve with A
            fails.
        is_singular: Whether S = D − Cᵀ X is singular.
    """

    s: Array
    relative_residual: float
    is_singular: bool = False


@dataclass(frozen=True, slots=True)
class _Solution:
    """A solution of a bordered system, with the forces of springs.

    Attributes:
        x: First unknown, (N,).
        s: Scalars, (m,).
        error_estimate: η, the largest of x and of the scalars; nan if it was not measured.
    """

    x: Array
    s: Array
    error_estimate: float


def _create_system(ksp: PETSc.KSP, A: PETSc.Mat, b: Array, border: Border, d: Array) -> _System:
    """Create a bordered system. Collective.

    Args:
        ksp: A KSP with a FETI context.
        A: Torn matrix, with the springs.
        b: First right-hand side, with any values on Dirichlet dofs, (N,).
        border: B, C and D of m scalars, the forces of the springs among them.
        d: Second right-hand side of the scalars without these forces, (up to m,).
    """
    comm = A.comm.tompi4py()
    free = ~read_dirichlet_mask(A)
    b = np.where(free, b, 0.0)
    B = np.where(free[:, None], border.B, 0.0)
    return _System(
        ksp=ksp,
        A=A,
        free=free,
        b=b,
        B=B,
        border=border,
        d=border.pad(d),
        count=len(d),
        b_norm=float(_norms(b[:, None], comm)[0]),
        B_norms=_norms(B, comm),
        comm=comm,
    )


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
        self._X: Array | None = None
        self._springs: PointSprings | None = None
        self._border: Border | None = None  # of the last solve, with springs

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
        """Solve with these springs; see :meth:`solve`. Collective.

        The steps are A y = b, the elimination of the scalars with A X = B, x = y − X s, and the
        refinement of x and s. If the elimination fails or S is singular, nothing is refined, and
        the outcome is this failure. If a refinement fails, the best solution before is returned.
        """
        context = ksp.getPythonContext()
        self.iterations = 0
        with springs.added_to(A):
            y = self._solve(ksp, A, b)  # A y = b
            extended = on_all(lambda: springs.extend(border), A.comm.tompi4py())
            system = _create_system(ksp, A, b, extended, d)
            elimination = self._eliminate(system, y, springs)
            self._border = extended
            info = context.info  # of the last solve with A
            tolerance = info.accuracy.rtol
            x = y
            s = elimination.s
            if info.reason > 0:
                x = y - self._last_X() @ s  # x = y − X s
            if elimination.is_singular:
                info = replace(info, reason=Reason.DIVERGED_BREAKDOWN, message=SINGULAR_BORDER)
            elif info.reason > 0:
                residual = max(info.accuracy.residual, elimination.relative_residual)
                info = replace(info, accuracy=replace(info.accuracy, residual=residual))
                tolerance, second_reference = self._error_tolerance(system, s)
                solution = self._refine(system, x, s, tolerance, second_reference)
                x = solution.x
                s = solution.s
                info = composed_outcome(info, solution.error_estimate, tolerance)
        context.store_outcome(ksp, replace(info, iterations=self.iterations), tolerance)
        return x, s[: len(d)]

    def _eliminate(self, system: _System, y: Array, springs: PointSprings) -> _Elimination:
        """Compute X and s for y = A⁻¹ b, and store X. Collective.

        The columns of an earlier X are first corrected to :data:`FIRST_RTOL`; without one, all are
        computed to the tolerance of the KSP. Each pass then computes s, and from it the residual
        that each column may have. Columns above theirs are corrected in the next pass.

        Args:
            system: The bordered system.
            y: A⁻¹ b, (N,).
            springs: The springs, whose columns of X are known.
        """
        comm = system.comm
        m = len(system.d)
        failure = _Elimination(np.zeros(m), np.nan)
        if system.ksp.getConvergedReason() < 0:
            return failure
        has_earlier_X = self._X is not None and self._X.shape == system.B.shape
        X = self._initial_X(system, springs)
        rtol, atol, *_ = system.ksp.getTolerances()
        e = system.d - total_of(system.border.C.T @ y, comm)  # d − Cᵀ y
        allowed = (FIRST_RTOL if has_earlier_X else rtol) * system.B_norms
        R = system.B - system.product(X)  # B − A X
        for _ in range(MAX_CORRECTIONS):
            for k in np.flatnonzero(_norms(R, comm) > allowed):
                X[:, k] += self._solve(
                    system.ksp, system.A, R[:, k], rtol=0.0, atol=TARGET_FACTOR * allowed[k]
                )
                if system.ksp.getConvergedReason() < 0:
                    return failure
                R[:, k : k + 1] = system.B[:, k : k + 1] - system.product(X[:, k : k + 1])
            complement = BorderComplement(system.border, X, comm)
            s = complement.solve(e)  # (D − Cᵀ X) s = d − Cᵀ y
            residuals = _norms(R, comm)
            # Each of the m columns may contribute a share 1/m of the tolerance.
            allowed = max(rtol * system.scale(s), atol) / without_zeros(m * np.abs(s))
            allowed = np.fmin(allowed, FIRST_RTOL * system.B_norms)
            if complement.is_singular or np.all(residuals <= allowed):
                break
        self._X = X
        relative_residual = float(np.abs(s) @ residuals) / (system.scale(s) or 1.0)
        return _Elimination(s, relative_residual, is_singular=complement.is_singular)

    def _initial_X(self, system: _System, springs: PointSprings) -> Array:
        """Return the first iterate of X, (N, m), zero on Dirichlet dofs.

        It is the X of the last matrix. Without one of this shape, it is zero in the columns of the
        scalars; the columns of the springs are known.
        """
        X = self._X
        if X is None or X.shape != system.B.shape:
            X = np.zeros_like(system.B)
            if springs.count:
                X[:, -springs.count :] = springs.X
        return np.where(system.free[:, None], X, 0.0)

    def _error_tolerance(self, system: _System, s: Array) -> tuple[float, Array]:
        """Return the tolerance of η, and a second reference for η, (N,); see ``SolveSettings``."""
        ksp = system.ksp
        rtol, atol, *_ = ksp.getTolerances()
        tolerance = max(rtol, atol / (system.scale(s) or np.inf))
        settings = ksp.getPythonContext().settings
        return settings.loosen(tolerance, len(system.b))

    def _refine(
        self, system: _System, x: Array, s: Array, error_tolerance: float, second_reference: Array
    ) -> _Solution:
        """Correct x and s until their estimated error η is at its tolerance. Collective.

        Args:
            system: The bordered system.
            x: Solution of the elimination, (N,).
            s: Its scalars, (m,).
            error_tolerance: Tolerance of η.
            second_reference: Reference of η in addition to x, (N,).

        Returns:
            The solution with the smallest η; η is nan without a preconditioner.
        """
        ksp = system.ksp
        context = ksp.getPythonContext()
        complement = BorderComplement(system.border, self._last_X(), system.comm)
        best = _Solution(x, s, np.inf)
        for _ in range(1 + MAX_REFINEMENTS):
            r, c = system.residual(x, s)
            correction = self._correction(ksp, r, c)
            if correction is None:
                break
            z, ds = correction
            m = system.count
            η_s = _scalar_error_estimate(system.border, complement, ds[:m], s[:m], x, system.comm)
            η = max(context.error_of_correction(z, [x, second_reference]), η_s)
            has_gained = η <= REFINEMENT_GAIN * best.error_estimate
            if η < best.error_estimate:
                best = _Solution(x, s, η)
            if not η > error_tolerance or not has_gained:
                break
            dy = self._solve(ksp, system.A, r, rtol=TARGET_FACTOR * error_tolerance / η, atol=0.0)
            if ksp.getConvergedReason() < 0:
                break  # the best solution so far is returned
            ds = complement.solve(c - total_of(system.border.C.T @ dy, system.comm))
            x = x + dy - self._last_X() @ ds
            s = s + ds
        if np.isinf(best.error_estimate):
            return replace(best, error_estimate=np.nan)
        return best

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
        with self._springs.added_to(ksp.getOperators()[0]):
            correction = self._correction(ksp, r, c)
        if correction is None:
            return None
        z, ds = correction
        return z, ds[: len(c)]

    def _correction(self, ksp: PETSc.KSP, r: Array, c: Array) -> tuple[Array, Array] | None:
        """Return approximate corrections, see :meth:`correction`. Collective.

        A has the springs; the last entries of the correction of s are their forces.
        """
        comm = ksp.comm.tompi4py()
        border = self._border
        z = ksp.getPythonContext().correction(ksp, r)
        if z is None or border is None or self._X is None:
            return None
        complement = BorderComplement(border, self._X, comm)
        ds = complement.solve(border.pad(c) - total_of(border.C.T @ z, comm))
        return z - self._X @ ds, ds

    def error_of_correction(self, ds: Array, s: Array, x: Array, comm: MPI.Comm) -> float:
        r"""Return η of the scalars: the largest :math:`|δs_k|` relative to s_k. Collective.

        s_k is compared with

        .. math:: |s_k| + \sum_l |S^{-1}|_{kl} \Bigl(\sum_j C_{jl}^2 x_j^2\Bigr)^{1/2},
                  \qquad S = D - C^⊤ X,

        for the last border. The second term matters if s_k is about zero because contributions of x
        cancel: s_k is accurate to their rounding only.

        Args:
            ds: Change of s, (m,).
            s: Largest size of s_k among the iterates, (m,).
            x: Largest size of x_j among the iterates, (N,).
            comm: Communicator.
        """
        if not len(ds) or self._border is None or self._X is None:
            return 0.0
        complement = BorderComplement(self._border, self._X, comm)
        return _scalar_error_estimate(self._border, complement, ds, s, x, comm)

    def _last_X(self) -> Array:
        """Return X of the last elimination, (N, m)."""
        assert self._X is not None
        return self._X

    def _solve(
        self,
        ksp: PETSc.KSP,
        A: PETSc.Mat,
        b: Array,
        *,
        rtol: float | None = None,
        atol: float | None = None,
    ) -> Array:
        """Return A⁻¹ b, (N,), and count the iterations. Collective.

        Args:
            ksp: The KSP.
            A: Torn matrix.
            b: Right-hand side, with prescribed values on Dirichlet dofs, (N,).
            rtol: Relative tolerance of this solve; if not given, both are those of the KSP.
            atol: Absolute tolerance of this solve.
        """
        tolerances = ksp.getTolerances()
        if rtol is not None:
            ksp.setTolerances(rtol=rtol, atol=atol)
        x = solve_ksp(ksp, A, b)
        ksp.setTolerances(*tolerances)
        self.iterations += ksp.getPythonContext().iterations
        return x


def _scalar_error_estimate(
    border: Border, complement: BorderComplement, ds: Array, s: Array, x: Array, comm: MPI.Comm
) -> float:
    """Return the largest change of a scalar relative to its size. Collective.

    See :meth:`BorderedSolver.error_of_correction`. ds and s are those of the first scalars, so that
    changes of the forces of springs do not count.
    """
    m = len(ds)
    row_sizes = np.sqrt(total_of((border.C**2).T @ x**2, comm))  # (Σ_j C_jl² x_j²)^½
    size = np.abs(s) + (complement.absolute_inverse() @ row_sizes)[:m]
    ratio = np.full(m, np.inf)
    np.divide(np.abs(ds), size, out=ratio, where=size > 0.0)
    ratio[ds == 0.0] = 0.0
    return float(ratio.max())


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
