# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Newton's method as a PETSc SNES, every step solved by FETI (docs/theory.md).

.. math:: (K'(U^k) + σ \operatorname{diag}|k|)\, ΔU = -r(U^k), \qquad
          U^{k+1} = U^k + α\, ΔU

(eq. 22, and eq. 23 for the discretised body, with the residual r, internal minus external forces).
Each of its parts has a file in ``iteration``: ``shifts`` chooses σ and ``line_search`` α; a solve
ends by ``convergence``, ``state_error``, ``rounding`` or ``early_end``; ``tangent_reuse`` saves
tangents, and ``tangent_check`` finds mistakes in them.
"""

from __future__ import annotations

import time
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.converged_reason import MAX_ROUNDING_SHARE
from dolfinx_feti.feti.solve_settings import ErrorAllowance
from dolfinx_feti.problems.equations.system import Residual, System
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.hooks import Hooks
from dolfinx_feti.problems.iteration.convergence import ConvergenceTest, Verdict
from dolfinx_feti.problems.iteration.early_end import EarlyEnd
from dolfinx_feti.problems.iteration.failures import (
    INVERTED_START,
    NOT_A_NUMBER,
    TEST_FAILED,
    TOO_MANY_STEPS,
    UNSUPPORTED,
    NewtonFailure,
    Outcome,
)
from dolfinx_feti.problems.iteration.iterate import Direction, Iterate, Start, evaluate
from dolfinx_feti.problems.iteration.line import Line, Trial
from dolfinx_feti.problems.iteration.line_search import find_step_length
from dolfinx_feti.problems.iteration.overshoots import Overshoots
from dolfinx_feti.problems.iteration.rounding import diagonal_rounding, residual_rounding
from dolfinx_feti.problems.iteration.shifts import ShiftedDirections
from dolfinx_feti.problems.iteration.state_error import ErrorEstimate, StateError
from dolfinx_feti.problems.iteration.step_test import StepTest
from dolfinx_feti.problems.iteration.support import KnownSupport
from dolfinx_feti.problems.iteration.tangent_check import Finding, TangentCheck
from dolfinx_feti.problems.iteration.tangent_reuse import leads_to_end
from dolfinx_feti.problems.solvers import max_steps, newton_tolerances
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all, warn
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.norms import norm
from dolfinx_feti.runtime.petsc_errors import garbage_collection_resumed, python_errors

Reason = PETSc.SNES.ConvergedReason

#: Residual that a linear solve may leave, as a share of the ‖r‖ that Newton's method aims at: a
#: tenth hardly adds to the residual of the next iterate. It is a choice, not measured.
RESIDUAL_SHARE = 0.1

_ROUNDING_WARNING = (
    "Newton's method ends where all of the residual is rounding: the free dofs are out of balance "
    "by {0:.0e}, under a load of {1:.0e}. If the load has changed, the equilibrium is doubtful. "
    "Load in larger steps, or lower a penalty such as κ and correct its effect by "
    "volume_tolerance=."
)


class Newton:
    """Context of a SNES whose iterates are states of a ``System``, with a FETI KSP.

    PETSc calls ``solve`` with vectors alone. :meth:`prepare` sets the further inputs of the next
    solve; further results are attributes.

    Attributes:
        hooks: Functions that a script has set on the SNES.
        history: A record for each step of the last solve.
        outcome: How the last solve has ended.
        last_residual: ``Residual.of_u`` of its last iterate, (owned,).
    """

    def __init__(self, system: System) -> None:
        """Create a context for all solves of a system."""
        self.hooks = Hooks(system)
        self.history: list[NewtonStep] = []
        self.outcome = Outcome(Reason.ITERATING)
        self.last_residual: Array = np.zeros(system.owned)
        self._system = system
        self._tangent_check = TangentCheck(system)
        self._support = KnownSupport()
        self._next_start = Start()

    @property
    def findings(self) -> list[Finding]:
        """How the tangent differs from the derivative, as found in all solves."""
        return self._tangent_check.findings

    def prepare(self, start: Start) -> None:
        """Set how the next solve begins; those after it begin with the defaults of ``Start``."""
        self._next_start = start

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, x: PETSc.Vec) -> None:
        """Iterate from the state of the user's Functions until the residual is small.

        Args:
            snes: The SNES, whose converged reason is set.
            b: None; PETSc's interface has it.
            x: Receives u, (owned,).
        """
        self.hooks.check(snes)
        start = self._next_start
        self._next_start = Start()
        self._tangent_check.begin()
        self.history = []
        self.outcome = Outcome(Reason.ITERATING)
        # The user's functions are called in both contexts. The history is set between them, so that
        # it has all steps if the solve raises.
        with garbage_collection_resumed(snes):
            solve = NewtonSolve(
                self._system,
                snes,
                start,
                hooks=self.hooks,
                tangent_check=self._tangent_check,
                support=self._support,
            )
        self.history = solve.history
        try:
            with garbage_collection_resumed(snes):
                self.outcome = solve.run()
        finally:
            self.last_residual = solve.last_residual
        snes.setConvergedReason(self.outcome.reason)
        x.array[:] = self._system.state.values().u


@dataclass(frozen=True, slots=True)
class StepPlan:
    """How the next step is taken.

    Attributes:
        target: ‖r‖ that the steps aim at.
        floor: ‖r‖ that is rounding.
        reuses_tangent: Whether the matrix holds the tangent of the step before.
        linear_allowance: Bounds of the estimated error of ΔU that are small enough for the linear
            solves.
    """

    target: float
    floor: float
    reuses_tangent: bool
    linear_allowance: ErrorAllowance


class NewtonSolve:
    """One solve.

    Attributes:
        history: A record for each step, and for each attempt of a step that found no step length.
        last_residual: ``Residual.of_u`` of the last iterate, (owned,).
    """

    def __init__(
        self,
        system: System,
        snes: PETSc.SNES,
        start: Start,
        *,
        hooks: Hooks,
        tangent_check: TangentCheck,
        support: KnownSupport,
    ) -> None:
        """Assemble the residual at the start, and create the parts of the method. Collective.

        Args:
            system: The equations.
            snes: The SNES, with tolerances and a FETI KSP.
            start: How the solve begins.
            hooks: Functions that a script has set on the SNES.
            tangent_check: Comparison of J with the derivative.
            support: The conditions that are known to support the body.
        """
        self.history: list[NewtonStep] = []
        self._stopwatch = Stopwatch()
        self._system = system
        self._snes = snes
        self._ksp: PETSc.KSP = snes.getKSP()
        self._start = start
        self._hooks = hooks
        self._tangent_check = tangent_check
        self._last_change: Array | None = None  # of u, (owned,)
        self.last_residual: Array = np.zeros(system.owned)
        self._first = self._iterate_at(system.residual())
        self._convergence = ConvergenceTest(snes, start, self._first)
        self._state_error = StateError(system, snes, start)
        self._early_end = EarlyEnd.of(start, self._first)
        self._shifts = ShiftedDirections(
            system, self._ksp, start, self._first, early_end=self._early_end, support=support
        )
        self._overshoots = Overshoots(self._first.norm)

    def run(self) -> Outcome:
        """Iterate until the residual and the estimated error are small. Collective.

        Returns:
            How the solve has ended; the state is the last iterate.
        """
        try:
            return self._iterate()
        except NewtonFailure as failure:
            return self._explain(failure)

    def _iterate(self) -> Outcome:
        """Iterate; the loop of docs/theory.md.

        Raises:
            NewtonFailure: There is no direction, no step length, or no convergence.
        """
        iterate = self._first
        self._require_admissible_start()
        while True:
            verdict = self._publish_and_test(iterate)  # of ‖r‖
            error = self._measure_error(iterate, verdict)  # of U
            if verdict.ends and not error.needs_step:
                return self._end(verdict, error)
            self._require_steps_left()
            if self._hooks.has_update(self._snes):
                iterate = self._call_update()
                error = self._state_error.unknown()  # η was that of the equations before the update
            target = self._target(iterate, error)
            reuses_tangent = leads_to_end(iterate, self.history, target)
            if not reuses_tangent:
                self._linearise(iterate)  # K'(U^k)
            floor = residual_rounding(self._system)
            if self._is_rounding(iterate, error, floor):
                return self._end_at_rounding(iterate, error)
            self._check_tangent(iterate, is_new=not reuses_tangent)
            allowance = self._state_error.linear_allowance(error)
            try:
                iterate = self._step(iterate, StepPlan(target, floor, reuses_tangent, allowance))
            except NewtonFailure:
                if error.needs_step and error.is_acceptable_as_rounding:
                    return self._end_with_error(error)
                raise
            self._early_end.check(self.history)

    # -- the parts of an iteration; all collective -------------------------------------------------

    def _require_admissible_start(self) -> None:
        """Raise an error if a cell is inside out.

        Raises:
            NewtonFailure: det F ≤ 0 at a quadrature point.
        """
        if self._system.smallest_volume_ratio() <= 0.0:
            raise NewtonFailure(INVERTED_START)

    def _iterate_at(self, residual: Residual, potential: float = np.nan) -> Iterate:
        """Return the iterate at the present state, whose residual is the last one from now on."""
        self.last_residual = residual.of_u
        return evaluate(self._system, residual, potential)

    def _publish_and_test(self, iterate: Iterate) -> Verdict:
        """Show an iterate to the SNES and its monitors; return whether its ‖r‖ ends the solve.

        The test is the script's own, if it has set one, or else the package's. Monitors are called
        after it.

        Raises:
            NewtonFailure: ‖r‖ is NaN or infinite.
        """
        snes = self._snes
        its = len(self.history)
        snes.setIterationNumber(its)
        snes.setFunctionNorm(iterate.norm)
        snes.logConvergenceHistory(iterate.norm, self._ksp.getIterationNumber())
        self._hooks.publish(snes, iterate.residual)
        if self._hooks.has_test(snes):
            reason = self._hooks.call_test(snes, iterate.residual, self._last_change)
            verdict = Verdict(reason, is_within_tolerances=reason > 0)
        else:
            verdict = self._convergence.judge(iterate)

        def monitor() -> None:
            with python_errors():  # the monitor may be the user's own
                snes.monitor(its, iterate.norm)

        on_all(monitor, self._system.comm)
        if not np.isfinite(iterate.norm):
            raise NewtonFailure(NOT_A_NUMBER)
        return verdict

    def _measure_error(self, iterate: Iterate, verdict: Verdict) -> ErrorEstimate:
        """Return the estimated error of an iterate, and complete the record of the step to it.

        It is unknown if a script has a test of its own.
        """
        if self._hooks.has_test(self._snes):
            return self._state_error.unknown()
        error = self._state_error.measure(iterate, verdict, self.history)
        if self.history:
            self.history[-1] = replace(self.history[-1], error=error.eta)
        return error

    def _require_steps_left(self) -> None:
        """Raise an error if the SNES allows no further step.

        Raises:
            NewtonFailure: There were too many.
        """
        max_it = max_steps(self._snes)
        if len(self.history) >= max_it:
            raise NewtonFailure(TOO_MANY_STEPS, max_it)

    def _call_update(self) -> Iterate:
        """Call a script's update, which may change u or a coefficient; return the iterate then."""
        self._hooks.call_update(self._snes)
        return self._iterate_at(self._system.residual())

    def _target(self, iterate: Iterate, error: ErrorEstimate) -> float:
        """Return the ‖r‖ that the next steps aim at."""
        target = self._convergence.target(iterate)
        if error.needs_step:
            target = float(np.fmin(target, error.target(iterate)))  # ignores NaN
        return target

    def _linearise(self, iterate: Iterate) -> None:
        """Assemble the tangent, unless that of the first step is in the matrix already."""
        if self.history or self._start.tangent is None:
            with event("FETITangent"):
                self._system.linearise(iterate.residual)

    def _is_rounding(self, iterate: Iterate, error: ErrorEstimate, floor: float) -> bool:
        """Return True if r is rounding alone, so that the solve ends.

        It is False with a script's own test, while a constraint is violated, and while a step may
        lower the estimated error. At the start ‖r‖ is compared with the lower bound of the rounding
        errors, so that a small load is not taken for rounding.
        """
        if iterate.violates_constraints or self._hooks.has_test(self._snes):
            return False
        if error.needs_step and error.is_too_large:
            return False
        return iterate.norm <= (floor if self.history else diagonal_rounding(self._system))

    def _check_tangent(self, iterate: Iterate, *, is_new: bool) -> None:
        """Compare a new tangent with the derivative after slow or suspect steps.

        Raises:
            NewtonFailure: J was found to have the wrong sign.
        """
        if is_new:
            self._tangent_check.compare_if_needed(iterate, self.history)
        self._tangent_check.require_right_sign(self.history)

    def _step(self, iterate: Iterate, plan: StepPlan) -> Iterate:
        """Compute the next iterate. If no step length is admissible, try a larger shift.

        In two cases no larger shift is tried, and the iterate stays the same. If r is rounding, the
        next iteration ends there. If the tangent was reused, the next iteration assembles a new
        one: only a whole step is followed by one with its tangent (``tangent_reuse``).

        Args:
            iterate: Where the step begins.
            plan: How it is taken.

        Returns:
            The iterate at the end of the step, or the given one, with Π if it is known, in these
            two cases.

        Raises:
            NewtonFailure: No direction has a step length.
        """
        # the given iterate, with the residual that the linear system has, and Π once it is known
        origin = iterate
        if plan.reuses_tangent:
            residual = self._system.residual_of_last_tangent(iterate.residual)
            origin = replace(iterate, residual=residual)
        directions = self._shifts.directions(origin, is_first=not self.history)
        while True:
            seconds_assembly = self._stopwatch.lap()  # since the last linear solve
            with self._linear_tolerances(plan):
                direction = next(directions)
            seconds_linear = self._stopwatch.lap()
            trial = self._search(origin, direction)
            self._record(
                direction,
                trial,
                plan,
                residual=iterate.norm,
                seconds_assembly=seconds_assembly,
                seconds_linear=seconds_linear,
            )
            if trial.alpha > 0.0:
                return self._accept(trial)
            if iterate.norm <= plan.floor or plan.reuses_tangent:
                return replace(iterate, potential=trial.potential)
            origin = replace(origin, potential=trial.potential)

    def _linear_tolerances(self, plan: StepPlan) -> AbstractContextManager[None]:
        """Return a context in which linear solves are as accurate as the step needs."""
        return newton_tolerances(
            self._ksp,
            norm=RESIDUAL_SHARE * plan.target,
            error=plan.linear_allowance,
            load_rounding=plan.floor,
        )

    def _search(self, origin: Iterate, direction: Direction) -> Trial:
        """Move the state along a direction.

        Returns:
            The trial where the state is; at α = 0, with Π(U), if no step length is admissible.
        """
        allows_overshoot = self._overshoots.are_allowed(self._system, direction)
        line = Line(self._system, origin, direction, allows_overshoot=allows_overshoot)
        test = StepTest(self._system, line)
        trial = find_step_length(line, test)
        self._overshoots.count(trial)
        if trial.alpha > 0.0:
            return trial
        return replace(trial, potential=test.potential)

    def _accept(self, trial: Trial) -> Iterate:
        """Return the iterate at a trial, where the state is."""
        reached = self._iterate_at(trial.residual, trial.potential)
        self._overshoots.update(reached.norm)
        return reached

    def _record(
        self,
        direction: Direction,
        trial: Trial,
        plan: StepPlan,
        *,
        residual: float,
        seconds_assembly: float,
        seconds_linear: float,
    ) -> None:
        """Append the record of a step, or of an attempt without a step length (α = 0).

        Args:
            direction: Its direction.
            trial: Its last trial.
            plan: How it was taken.
            residual: ‖r‖ before it.
            seconds_assembly: Time since the last linear solve: assembly and line search.
            seconds_linear: Time for the linear solves.
        """
        step = NewtonStep.after(
            self._ksp.getPythonContext(),
            direction.iterations,
            residual=residual,
            step_length=trial.alpha,
            indefinite=direction.indefinite,
            shift=direction.shift,
            seconds_assembly=seconds_assembly,
            seconds_linear=seconds_linear,
            floor=plan.floor,
            tangent_lag=self.history[-1].tangent_lag + 1 if plan.reuses_tangent else 0,
        )
        self.history.append(step)
        self._last_change = trial.alpha * direction.du
        self._tangent_check.add_step(direction, trial)

    # -- how a solve ends --------------------------------------------------------------------------

    def _end(self, verdict: Verdict, error: ErrorEstimate) -> Outcome:
        """Return the outcome of a verdict that ends the solve.

        ‖r‖ is small. If the estimated error is still too large, rounding limits it. The reason is
        then that of the absolute tolerance, because the relative one is not met.
        """
        reason = verdict.reason
        if reason < 0:
            return Outcome(reason, TEST_FAILED.format(reason))
        if error.is_too_large:
            error.warn_if_visible(self._system.comm)
            reason = Reason.CONVERGED_FNORM_ABS
        return Outcome(reason, is_within_tolerances=verdict.is_within_tolerances)

    def _end_at_rounding(self, iterate: Iterate, error: ErrorEstimate) -> Outcome:
        """Converge, and log if rounding leaves the free dofs visibly out of balance."""
        system = self._system
        error.warn_if_visible(system.comm)
        force = norm(system.comm, system.conditions.free(iterate.residual.force))
        load = self._convergence.applied_load(iterate)
        if self.history and force > MAX_ROUNDING_SHARE * load:
            warn(_ROUNDING_WARNING.format(force, load), system.comm)
        return Outcome(Reason.CONVERGED_FNORM_ABS, is_within_tolerances=True, is_rounding=True)

    def _end_with_error(self, error: ErrorEstimate) -> Outcome:
        """Converge: ‖r‖ is small, and no step lowers the estimated error."""
        error.warn_if_visible(self._system.comm)
        return Outcome(Reason.CONVERGED_FNORM_ABS, is_within_tolerances=True)

    def _explain(self, failure: NewtonFailure) -> Outcome:
        """Return the outcome of a failure, with its cause if that is J, F, or a contact."""
        is_displacement = self._system.deformation is not None
        outcome = self._tangent_check.explain(
            failure, self.history, is_displacement=is_displacement
        )
        if self._shifts.lacks_support:
            return replace(outcome, message=f"{outcome.message}. {UNSUPPORTED}")
        return outcome


class Stopwatch:
    """Measures the time between laps."""

    def __init__(self) -> None:
        """Start the first lap."""
        self._last = time.perf_counter()

    def lap(self) -> float:
        """Return the seconds since the last lap."""
        now = time.perf_counter()
        seconds = now - self._last
        self._last = now
        return seconds
