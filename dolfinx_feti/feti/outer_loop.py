# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""One solve with either formulation, repeated until the assembled system is solved.

.. math:: \|b - A x\| ≤ τ\, \|b - A x_D\| \quad\text{and}\quad η(x) ≤ τ, \qquad
          τ = \max(\text{rtol}, \text{atol} / \|b - A x_D\|)

with the prescribed values :math:`x_D` and the estimated error η of ``accuracy``. The loop is that
of iterative refinement,

.. math:: r = b - A x, \qquad A z ≈ r, \qquad x ← x + z.

Each pass of the loop is a *start* of the Krylov method. A *fresh start* on the true residual r
follows if the last start missed one of the two tolerances but reduced ‖r‖ or η to
:data:`FRESH_START_FACTOR` of what it was. If it reduced neither, rounding limits them.
``torn.rounding`` estimates the limit of ‖r‖. The loop also ends if the Krylov method fails, if an
option gives that method a tolerance, and after :data:`MAX_FRESH_STARTS` fresh starts.

What a solution has to meet is in ``_Goal``, and what was measured of it in ``_Iterate``. After a
start, these questions are answered in this order:

- ``_is_better``: is the new iterate the best so far? If not, the loop ends with the one before.
- ``_is_last_start``: is it good enough (``_is_finished``), or has the start gained too little
  (``_has_gained``), or has the Krylov method failed, or does an option give it a tolerance? Then
  the loop ends.
- ``_meets_tolerances``, after the loop: are both tolerances met? This decides about the converged
  reason. ``_is_finished`` also accepts a residual that rounding keeps above its tolerance.

The Krylov method gets the bounds of ‖r‖ and η as arguments ``target`` and ``error_test`` of
``Formulation.solve``. All norms are Euclidean.

Options of the solver are in ``formulation.pattern.options``. To turn a number below into an option,
add a field to ``FETIOptions``.

If a null space Z is attached to A, x and all residuals are orthogonal to Z (``torn.null_space``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.accuracy import ComponentNorms, ErrorTest
from dolfinx_feti.feti.converged_reason import converged_reason, failure_message
from dolfinx_feti.feti.formulation import Formulation
from dolfinx_feti.feti.monitor import UserMonitors
from dolfinx_feti.feti.solve_info import Accuracy, KrylovInfo, SolveInfo
from dolfinx_feti.feti.solve_settings import SolveSettings, Tolerances
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.null_space import max_null_part, remove_null_space
from dolfinx_feti.torn.rounding import residual_rounding

Reason = PETSc.KSP.ConvergedReason

#: Largest number of fresh starts. A well-scaled system takes none, a tolerance near rounding two or
#: three: this guards against endless loops.
MAX_FRESH_STARTS = 10

#: Largest quotient of ‖r‖, or of η, after and before a start at which another one follows. At the
#: limit of rounding, both change at random from start to start: 0.9 sometimes takes that for
#: progress.
FRESH_START_FACTOR = 0.5

#: Target of the Krylov method relative to the tolerances. Its residual lacks rounding errors and
#: its η the interior dofs, so that both are somewhat too small. A choice: with 1, a solve that ends
#: just below its target takes a fresh start; half of it takes an iteration more.
TARGET_FACTOR = 0.7

#: Margin for a fresh start whose Krylov method does not measure η. If η fell in proportion to ‖r‖,
#: it would meet its tolerance at a certain ‖r‖: the tolerance of ‖r‖ in this start is this share of
#: that norm. The target of the method is TARGET_FACTOR times the tolerance, as in each start. With
#: a share of 1, η may miss its tolerance by 10 %, and a further start follows; with 0.1 the Krylov
#: method takes an iteration more.
PROPORTIONAL_TARGET = 0.4

#: Multiple of its estimated rounding errors up to which a residual counts as rounding. The estimate
#: is the root of a sum of squares; the factor is a margin for its spread, not measured.
RESIDUAL_ROUNDING_MARGIN = 4.0

#: Largest difference between the residual that the Krylov method updates and the true one, relative
#: to the true one, at which its η is used. With a larger difference, η is computed from the true
#: residual, by one more application of the preconditioner. For the η in use to be wrong by a factor
#: of two, M would have to amplify the difference a thousand times as much as the residual.
MAX_RESIDUAL_DIFFERENCE = 1e-3


def solve_assembled(
    ksp: PETSc.KSP,
    formulation: Formulation,
    b: PETSc.Vec,
    x: PETSc.Vec,
    *,
    tolerances: Tolerances,
    iterations_before: int,
    settings: SolveSettings,
) -> SolveInfo:
    """Solve A x = b. Collective.

    Args:
        ksp: The user's solver: its monitors are called, and it stores norm and iteration number.
        formulation: The formulation that is set up for A.
        b: Right-hand side with the prescribed values on Dirichlet dofs, (N,).
        x: The solution, (N,), overwritten; zero if b is not finite, or not orthogonal to the null
            space that is attached to A.
        tolerances: Tolerances and limits of this solve.
        iterations_before: Number of iterations of earlier attempts, for the monitors.
        settings: What the caller allows beyond the tolerances.

    Returns:
        How the solve has ended; after a failure with a message.

    Raises:
        SetUpError: Local work in an iteration failed, such as a solve with a factor.
        ValueError: The KSP has a convergence test of the user's. On all processes.
    """
    prefix = ksp.getOptionsPrefix() or ""
    x.set(0.0)
    # Where no start follows, a KrylovInfo passes the reason on.
    if not np.isfinite(b.norm()):
        return _outcome(KrylovInfo(Reason.DIVERGED_NANORINF), Accuracy(), formulation, prefix)
    torn = formulation.pattern.torn
    with Lifetime() as owned:
        r = owned.own(b.duplicate())
        x_D = owned.own(b.duplicate())
        u_D = np.where(torn.is_dirichlet_copy, torn.tear(b.array_r), 0.0)
        x_D.array[:] = torn.assemble(formulation.delta * u_D)
        torn.residual(b, x_D, r)  # r = b − A x_D
        scale = float(r.norm())
        max_part = max_null_part(torn, b, x_D, r, settings.load_rounding)
        null_part = remove_null_space(torn.A, r)  # r ← r − Z Zᵀ r
        if null_part > max_part:
            accuracy = Accuracy(residual=null_part / scale)
            return _outcome(KrylovInfo(Reason.DIVERGED_NULL), accuracy, formulation, prefix)
        norms = ComponentNorms(torn).for_load(r.array_r)
        goal = _create_goal(scale, tolerances, settings, torn.N)
        loop = _OuterLoop(ksp, formulation, b, u_D, goal, norms, settings)
        return loop.run(x, r, iterations_before)  # overwrites r


def _outcome(
    last: KrylovInfo,
    accuracy: Accuracy,
    formulation: Formulation,
    prefix: str,
    *,
    meets_tolerances: bool = False,
) -> SolveInfo:
    """Return the outcome with the converged reason and, after a failure, a message.

    Args:
        last: How the last start ended, or the reason alone if there was none.
        accuracy: What has been measured of the solution.
        formulation: The formulation that solved.
        prefix: Options prefix of the KSP.
        meets_tolerances: Whether residual and estimated error meet their tolerances.
    """
    reason = converged_reason(
        last,
        accuracy,
        meets_tolerances=meets_tolerances,
        has_krylov_tolerance=formulation.has_krylov_tolerance,
    )
    message = ""
    if reason < 0:
        message = failure_message(reason, accuracy, formulation, prefix)
    return SolveInfo(reason, accuracy=accuracy, message=message)


@dataclass(frozen=True, slots=True)
class _Goal:
    """What a solution has to meet, and after how many iterations the solve ends.

    Attributes:
        scale: ‖b − A x_D‖, which relative residuals refer to.
        residual_tolerance: Largest ‖b − A x‖.
        rtol: The same relative to ``scale``; nan if the load is zero.
        error_tolerance: Largest η; infinite if the load is zero.
        second_reference: Reference of η in addition to x (``SolveSettings.loosen``), (N,).
        max_it: Largest number of iterations over all starts.
    """

    scale: float
    residual_tolerance: float
    rtol: float
    error_tolerance: float
    second_reference: Array
    max_it: int


def _create_goal(scale: float, tolerances: Tolerances, settings: SolveSettings, N: int) -> _Goal:
    """Return what a solution has to meet.

    Args:
        scale: ‖b − A x_D‖.
        tolerances: Tolerances and limits of this solve.
        settings: What the caller allows beyond the tolerances.
        N: Number of dofs of the assembled problem on this process.
    """
    residual_tolerance = max(tolerances.rtol * scale, tolerances.atol)
    rtol = np.nan
    error_tolerance = np.inf
    if scale > 0.0:
        rtol = residual_tolerance / scale  # τ
        error_tolerance = rtol
    error_tolerance, second_reference = settings.loosen(error_tolerance, N)
    return _Goal(
        scale=scale,
        residual_tolerance=residual_tolerance,
        rtol=rtol,
        error_tolerance=error_tolerance,
        second_reference=second_reference,
        max_it=tolerances.iteration_limit(rtol),
    )


@dataclass(frozen=True, slots=True)
class _Iterate:
    """The solution after a start, with its residual and error.

    Attributes:
        x: The solution, (N,).
        norm: ‖b − A x‖ on the free dofs; infinite before the first start.
        has_small_residual: Whether ‖b − A x‖ is at its tolerance, or at a level of rounding above
            that, so that no fresh start can reduce it to the tolerance.
        norm_floor: Largest ‖b − A x‖ that counts as rounding, if ‖b − A x‖ misses its
            tolerance and is at most this floor; else nan.
        error_estimate: η; nan if it was not measured, as the residual is too large.
        total_error_estimate: η of all components together; nan also if the Krylov method measured
            η.
    """

    x: Array
    norm: float = np.inf
    has_small_residual: bool = False
    norm_floor: float = np.nan
    error_estimate: float = np.nan
    total_error_estimate: float = np.nan


class _OuterLoop:
    """Iterative refinement of the solution of A x = b with one formulation."""

    def __init__(
        self,
        ksp: PETSc.KSP,
        formulation: Formulation,
        b: PETSc.Vec,
        u_D: Array,
        goal: _Goal,
        norms: ComponentNorms,
        settings: SolveSettings,
    ) -> None:
        """Store references to the arguments.

        Args:
            ksp: The user's solver, for its monitors, residual norm and iteration number.
            formulation: The formulation that is set up for A.
            b: Right-hand side, (N,).
            u_D: Prescribed values on the torn Dirichlet dofs, zero elsewhere, (n,).
            goal: What a solution has to meet.
            norms: Norms of components for η.
            settings: What the caller allows.
        """
        self._ksp = ksp
        self._formulation = formulation
        self._torn = formulation.pattern.torn
        self._b = b
        self._u_D = u_D
        self._goal = goal
        self._norms = norms
        self._allow_indefinite = settings.allow_indefinite

    def run(self, x: PETSc.Vec, r: PETSc.Vec, iterations_before: int) -> SolveInfo:
        """Start the Krylov method until x meets the goal, or a start gains too little. Collective.

        Args:
            x: The best solution, (N,), overwritten; the values that it has are not used.
            r: Work vector for the residual, (N,), overwritten.
            iterations_before: Number of iterations before this solve, for the monitors.

        Returns:
            The outcome. Its Ritz values and vectors are those of the first start.

        Raises:
            SetUpError: Local work in an iteration failed.
            ValueError: The KSP has a convergence test of the user's. On all processes.
        """
        formulation = self._formulation
        torn = self._torn
        monitors = UserMonitors(self._ksp)
        # Dofs without a copy are Dirichlet dofs: x takes their values from b, all others from u.
        x.array[:] = np.where(torn.is_unused, self._b.array_r, 0.0)
        # The first start has b as right-hand side, and the formulation itself moves K u_D to the
        # load; a fresh start has the residual, and no prescribed values.
        self._b.copy(r)
        u_D = self._u_D
        residual_tolerance_of_start = self._goal.residual_tolerance
        best = _Iterate(x.array_r.copy())
        iterations = 0
        starts: list[KrylovInfo] = []
        while len(starts) <= MAX_FRESH_STARTS:
            iterations_so_far = iterations_before + iterations
            is_first_of_solve = iterations_before == 0 and not starts
            u, info = formulation.solve(
                r,
                u_D,
                target=TARGET_FACTOR * residual_tolerance_of_start,
                error_test=self._error_test(best),
                max_it=self._goal.max_it - iterations,
                monitor=monitors.for_start(iterations_so_far, is_first=is_first_of_solve),
                allow_indefinite=self._allow_indefinite,
            )
            starts.append(info)
            iterations += info.iterations
            self._ksp.setIterationNumber(iterations_before + iterations)
            x.array[:] += torn.assemble(formulation.delta * u)  # x ← x + Tᵀ δ u
            on_subdomains(formulation.pattern.errors.raise_first, torn.comm)
            self._compute_residual(x, r)
            previous = best
            iterate = self._measure(x, r, info)
            if not self._is_better(iterate, previous):
                break
            best = iterate
            if self._is_last_start(info, best, previous):
                break
            residual_tolerance_of_start = self._next_residual_tolerance(best)
            u_D = np.zeros_like(u_D)  # x has the prescribed values now
        x.array[:] = best.x
        remove_null_space(torn.A, x)
        best = self._with_error_if_missing(best, x, r)
        self._ksp.setResidualNorm(best.norm)  # infinite if no iterate is finite
        outcome = _outcome(
            starts[-1],
            self._accuracy(best, starts[-1]),
            formulation,
            self._ksp.getOptionsPrefix() or "",
            meets_tolerances=self._meets_tolerances(best),
        )
        return replace(
            outcome,
            iterations=iterations,
            ritz_values=starts[0].ritz_values,
            ritz_vectors=starts[0].ritz_vectors,
        )

    def _compute_residual(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Compute the true residual r = b − A x, orthogonal to the null space. Collective.

        Args:
            x: A solution, (N,).
            r: Its residual, (N,), overwritten; zero on Dirichlet dofs.
        """
        self._torn.residual(self._b, x, r)
        remove_null_space(self._torn.A, r)

    def _error_test(self, iterate: _Iterate) -> ErrorTest:
        """Return the test of η for a correction of an iterate."""
        goal = self._goal
        error_tolerance = TARGET_FACTOR * goal.error_tolerance
        return ErrorTest(self._norms, error_tolerance, iterate.x, goal.second_reference)

    def _measure(self, x: PETSc.Vec, r: PETSc.Vec, info: KrylovInfo) -> _Iterate:
        """Return the iterate after a start, with η if its residual is small. Collective.

        Args:
            x: The solution after the start, (N,).
            r: Its true residual, (N,).
            info: How the start ended.
        """
        residual_tolerance = self._goal.residual_tolerance
        norm = float(r.norm())
        has_small_residual = norm <= residual_tolerance
        norm_floor = np.nan
        if norm > residual_tolerance:
            rounding = residual_rounding(self._torn, self._b, x)
            if norm <= RESIDUAL_ROUNDING_MARGIN * rounding:
                norm_floor = RESIDUAL_ROUNDING_MARGIN * rounding
                # With rounding below the tolerance, a fresh start may still reach it.
                has_small_residual = rounding > residual_tolerance
        iterate = _Iterate(x.array_r.copy(), norm, has_small_residual, norm_floor)
        if not has_small_residual:
            return iterate
        measured = info.measured_error
        if measured is not None and self._agrees_with_true_residual(measured.residual, r):
            return replace(iterate, error_estimate=measured.error_estimate)
        return self._with_measured_error(iterate, r)

    def _agrees_with_true_residual(self, updated: Array, r: PETSc.Vec) -> bool:
        """Return True if an updated residual agrees with the true one. Collective.

        With a null space, False: the part of the residual in it may grow unnoticed.

        Args:
            updated: The residual that the Krylov method has updated, (N,).
            r: The true residual, (N,).
        """
        if self._torn.A.getNullSpace().handle:
            return False
        true = r.array_r
        difference = true - updated
        local = np.array([true @ true, difference @ difference])
        squares = self._torn.comm.allreduce(local)
        return bool(squares[1] <= MAX_RESIDUAL_DIFFERENCE**2 * squares[0])

    def _with_measured_error(self, iterate: _Iterate, r: PETSc.Vec) -> _Iterate:
        """Return an iterate with η, by one application of the preconditioner. Collective.

        Args:
            iterate: The iterate.
            r: Its true residual, (N,).
        """
        z = precondition(self._formulation, r)
        references = [iterate.x, self._goal.second_reference]
        error_estimate, total = self._norms.ratios_of_correction(z, references)
        return replace(iterate, error_estimate=error_estimate, total_error_estimate=total)

    def _with_error_if_missing(self, best: _Iterate, x: PETSc.Vec, r: PETSc.Vec) -> _Iterate:
        """Return the best iterate with its η, which is measured if it is still missing. Collective.

        Args:
            best: The best iterate.
            x: Its solution, orthogonal to the null space, (N,).
            r: Work vector for its residual, (N,), overwritten.
        """
        if not np.isnan(best.error_estimate) or not np.isfinite(best.norm):
            return best
        self._compute_residual(x, r)
        return self._with_measured_error(replace(best, x=x.array_r.copy()), r)

    def _is_last_start(self, info: KrylovInfo, iterate: _Iterate, previous: _Iterate) -> bool:
        """Return True if no fresh start follows a start that has not made the solution worse.

        Args:
            info: How the start ended.
            iterate: The iterate after it.
            previous: The iterate before it.
        """
        if info.reason < 0 or self._formulation.has_krylov_tolerance:
            return True
        return self._is_finished(iterate) or not self._has_gained(iterate, previous)

    def _is_finished(self, iterate: _Iterate) -> bool:
        """Return True if η is at its tolerance, and the residual too, or limited by rounding."""
        return iterate.has_small_residual and iterate.error_estimate <= self._goal.error_tolerance

    def _meets_tolerances(self, iterate: _Iterate) -> bool:
        """Return True if residual and η meet their tolerances.

        A residual that rounding limits does not meet its tolerance: ``converged_reason`` has a case
        of its own for it.
        """
        return iterate.norm <= self._goal.residual_tolerance and self._meets_error(iterate)

    def _meets_error(self, iterate: _Iterate) -> bool:
        """Return True if η is at its tolerance.

        η has none if options set a tolerance of the Krylov method (``has_krylov_tolerance``).
        """
        if self._formulation.has_krylov_tolerance:
            return True
        return bool(iterate.error_estimate <= self._goal.error_tolerance)

    def _is_better(self, iterate: _Iterate, previous: _Iterate) -> bool:
        """Return True if a start has not made the solution worse; False if its norm is nan.

        Small residuals may be rounding: η decides between them, unless the residual has fallen to
        :data:`FRESH_START_FACTOR` of the one before.
        """
        if iterate.has_small_residual and previous.has_small_residual:
            has_less_residual = iterate.norm <= FRESH_START_FACTOR * previous.norm
            return has_less_residual or iterate.error_estimate <= previous.error_estimate
        return iterate.norm <= previous.norm

    def _has_gained(self, iterate: _Iterate, previous: _Iterate) -> bool:
        """Return True if the last start reduced ‖r‖ or η enough for another one to follow.

        Enough is a factor of :data:`FRESH_START_FACTOR` or less. If a stiff component dominates
        ‖r‖, the residual of a soft one shows in η alone.
        """
        if iterate.norm <= FRESH_START_FACTOR * previous.norm:
            return True
        if not iterate.has_small_residual:
            return False
        if np.isnan(previous.error_estimate):  # its residual was not small
            return True
        return iterate.error_estimate <= FRESH_START_FACTOR * previous.error_estimate

    def _next_residual_tolerance(self, iterate: _Iterate) -> float:
        """Return the largest ‖b − A x‖ for the next start, after an iterate that misses the goal.

        If the Krylov method does not measure η, η is assumed to fall in proportion to ‖b − A x‖.
        """
        goal = self._goal
        if self._formulation.measures_error or not iterate.has_small_residual:
            return goal.residual_tolerance
        reduction = goal.error_tolerance / iterate.error_estimate
        return min(goal.residual_tolerance, PROPORTIONAL_TARGET * iterate.norm * reduction)

    def _accuracy(self, best: _Iterate, last: KrylovInfo) -> Accuracy:
        """Return residual and error of the best iterate, and what rounding leaves of them.

        Args:
            best: The best iterate.
            last: How the last start ended; if it failed, η is not at its floor.
        """
        goal = self._goal
        scale = goal.scale or 1.0  # without a load, the numbers are absolute
        error_floor = np.nan
        if best.has_small_residual and last.reason >= 0 and not self._meets_error(best):
            error_floor = best.error_estimate
        return Accuracy(
            residual=best.norm / scale,
            rtol=goal.rtol,
            residual_floor=best.norm_floor / scale,
            error_estimate=best.error_estimate,
            error_floor=error_floor,
            total_error_estimate=best.total_error_estimate,
        )


def precondition(formulation: Formulation, r: PETSc.Vec) -> Array:
    """Return z = M r ≈ A⁻¹ r, (N,), for an assembled residual r, (N,). Collective.

    Raises:
        SetUpError: Local work failed, such as a solve with a factor.
    """
    torn = formulation.pattern.torn
    with Lifetime() as owned:
        z = owned.own(r.duplicate())
        z.array[:] = torn.assemble(formulation.delta * formulation.precondition(r))  # Tᵀ δ u
        on_subdomains(formulation.pattern.errors.raise_first, torn.comm)
        remove_null_space(torn.A, z)
        return z.array_r.copy()
