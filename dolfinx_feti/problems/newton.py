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
from dataclasses import replace

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.converged_reason import MAX_ROUNDING_SHARE
from dolfinx_feti.problems.equations.system import System
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
from dolfinx_feti.problems.iteration.state_error import StateError
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
        first = evaluate(system, system.residual())
        self.last_residual: Array = first.residual.of_u
        self._system = system
        self._snes = snes
        self._ksp: PETSc.KSP = snes.getKSP()
        self._start = start
        self._first = first
        self._hooks = hooks
        self._tangent_check = tangent_check
        self._last_change: Array | None = None  # of u, (owned,)
        self._convergence = ConvergenceTest(snes, start, first)
        self._state_error = StateError(system, snes, start)
        self._early_end = EarlyEnd.of(start, first)
        self._shifts = ShiftedDirections(
            system, self._ksp, start, first, early_end=self._early_end, support=support
        )
        self._potential = np.nan  # Π of the present iterate, if it was evaluated
        self._overshoots = Overshoots(first.norm)

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
            verdict = self._judge(iterate)
            needs_step = self._needs_step(iterate, verdict)
            if verdict.reason != Reason.ITERATING and not needs_step:
                return self._end(verdict)
            updated = self._call_update(iterate)
            if updated is not None:
                iterate = updated
                needs_step = False  # η was estimated for the equations before the update
            target = self._target(iterate, needs_step=needs_step)
            reuses_tangent = leads_to_end(iterate, self.history, target)
            if not reuses_tangent:
                self._linearise(iterate)  # K'(U^k)
            floor = residual_rounding(self._system)
            if self._is_rounding(iterate, floor, needs_step=needs_step):
                return self._end_at_rounding(iterate)
            if not reuses_tangent:
                self._tangent_check.compare_if_needed(iterate, self.history)
            self._tangent_check.require_right_sign(self.history)
            try:
                with self._linear_tolerances(target, floor):
                    iterate = self._step(iterate, floor, reuses_tangent=reuses_tangent)
            except NewtonFailure:
                if not (needs_step and self._state_error.is_acceptable_as_rounding):
                    raise
                return self._end_with_error()
            self._early_end.check(self.history)

    # -- the parts of an iteration; all collective -------------------------------------------------

    def _require_admissible_start(self) -> None:
        """Raise an error if a cell is inside out.

        Raises:
            NewtonFailure: det F ≤ 0 at a quadrature point.
        """
        if self._system.smallest_volume_ratio() <= 0.0:
            raise NewtonFailure(INVERTED_START)

    def _judge(self, iterate: Iterate) -> Verdict:
        """Report ‖r‖ to the SNES and its monitors, and test whether the solve ends.

        The test is the script's own, if it has set one, or else the package's.

        Raises:
            NewtonFailure: ‖r‖ is NaN or infinite, or there were too many steps.
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
        if verdict.reason == Reason.ITERATING:
            self._require_steps_left()
        return verdict

    def _needs_step(self, iterate: Iterate, verdict: Verdict) -> bool:
        """Return True if the estimated error requires a step although ‖r‖ is small.

        The error is that of the state after the last step, whose record is completed.

        Raises:
            NewtonFailure: A step is required, and there were too many.
        """
        if self._hooks.has_test(self._snes):
            return False
        error = self._state_error
        error.measure(iterate, verdict, self.history)
        if self.history:
            self.history[-1] = replace(self.history[-1], error=error.estimate)
        if error.needs_step:
            self._require_steps_left()
            return True
        if error.is_too_large:
            error.log()
        return False

    def _require_steps_left(self) -> None:
        """Raise an error if the SNES allows no further step.

        Raises:
            NewtonFailure: There were too many.
        """
        max_it = max_steps(self._snes)
        if len(self.history) >= max_it:
            raise NewtonFailure(TOO_MANY_STEPS, max_it)

    def _call_update(self, iterate: Iterate) -> Iterate | None:
        """Call a script's update; return the iterate after it, None if there is no update."""
        if not self._hooks.has_update(self._snes):
            return None
        self._hooks.call_update(self._snes)
        self._potential = np.nan  # the update may have changed u or a coefficient
        return self._evaluate_present()

    def _target(self, iterate: Iterate, *, needs_step: bool) -> float:
        """Return the ‖r‖ that the next steps aim at."""
        target = self._convergence.target(iterate)
        if needs_step:
            # NaN if the error is not known
            target = float(np.fmin(target, self._state_error.target(iterate)))
        return target

    def _linearise(self, iterate: Iterate) -> None:
        """Assemble the tangent, unless that of the first step is in the matrix already."""
        if self.history or self._start.tangent is None:
            with event("FETITangent"):
                self._system.linearise(iterate.residual)

    def _is_rounding(self, iterate: Iterate, floor: float, *, needs_step: bool) -> bool:
        """Return True if r is rounding alone, so that the solve ends.

        It is False with a script's own test, while a constraint is violated, and while a step may
        lower the estimated error. At the start ‖r‖ is compared with the lower bound of the rounding
        errors, so that a small load is not taken for rounding.
        """
        if iterate.violates_constraints or self._hooks.has_test(self._snes):
            return False
        if needs_step and self._state_error.is_too_large:
            return False
        return iterate.norm <= (floor if self.history else diagonal_rounding(self._system))

    def _linear_tolerances(self, target: float, floor: float) -> AbstractContextManager[None]:
        """Return a context in which linear solves are as accurate as the step needs."""
        return newton_tolerances(
            self._ksp,
            norm=RESIDUAL_SHARE * target,
            error=self._state_error.of_linear_solve(),
            load_rounding=floor,
        )

    def _step(self, iterate: Iterate, floor: float, *, reuses_tangent: bool) -> Iterate:
        """Compute the next iterate, with a larger shift if no step length is admissible.

        There are two exceptions, in which the same iterate is returned. If r is rounding, the next
        iteration ends there. If the tangent was reused, the next iteration assembles a new one:
        ``tangent_reuse`` requires that after a recorded step of length zero.

        Args:
            iterate: Where the step begins.
            floor: ‖r‖ that is rounding.
            reuses_tangent: Whether the matrix holds the tangent of the step before.

        Raises:
            NewtonFailure: No direction has a step length.
        """
        origin = iterate
        if reuses_tangent:
            residual = self._system.residual_of_last_tangent(iterate.residual)
            origin = replace(iterate, residual=residual)
        directions = self._shifts.directions(origin, is_first=not self.history)
        while True:
            seconds_assembly = self._stopwatch.lap()  # since the last linear solve
            direction = next(directions)
            seconds_linear = self._stopwatch.lap()
            trial = self._search(origin, direction)
            self._record(
                direction,
                trial,
                residual=iterate.norm,
                floor=floor,
                seconds_assembly=seconds_assembly,
                seconds_linear=seconds_linear,
                tangent_lag=self.history[-1].tangent_lag + 1 if reuses_tangent else 0,
            )
            if trial.alpha > 0.0:
                return self._accept(trial)
            if iterate.norm <= floor or reuses_tangent:
                return iterate

    def _search(self, origin: Iterate, direction: Direction) -> Trial:
        """Move the state along a direction; α = 0 if no step length is admissible."""
        allows_overshoot = self._overshoots.are_allowed(self._system, direction)
        line = Line(self._system, origin, direction, allows_overshoot=allows_overshoot)
        test = StepTest(self._system, line, self._potential)
        trial = find_step_length(line, test)
        self._overshoots.count(trial)
        self._potential = trial.potential if trial.alpha > 0.0 else test.potential
        return trial

    def _accept(self, trial: Trial) -> Iterate:
        """Return the iterate at a trial, where the state is."""
        self.last_residual = trial.residual.of_u
        reached = evaluate(self._system, trial.residual)
        self._overshoots.update(reached.norm)
        return reached

    def _evaluate_present(self) -> Iterate:
        """Assemble the residual at the present state, and return the iterate there."""
        residual = self._system.residual()
        self.last_residual = residual.of_u
        return evaluate(self._system, residual)

    def _record(
        self,
        direction: Direction,
        trial: Trial,
        *,
        residual: float,
        floor: float,
        seconds_assembly: float,
        seconds_linear: float,
        tangent_lag: int,
    ) -> None:
        """Append the record of a step, or of an attempt without a step length (α = 0).

        Args:
            direction: Its direction.
            trial: Its last trial.
            residual: ‖r‖ before it.
            floor: ‖r‖ that is rounding.
            seconds_assembly: Time since the last linear solve: assembly and line search.
            seconds_linear: Time for the linear solves.
            tangent_lag: Number of steps that the tangent had served before.
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
            floor=floor,
            tangent_lag=tangent_lag,
        )
        self.history.append(step)
        self._last_change = trial.alpha * direction.du
        self._tangent_check.add_step(direction, trial)

    # -- how a solve ends --------------------------------------------------------------------------

    def _end(self, verdict: Verdict) -> Outcome:
        """Return the outcome of a verdict that ends the solve.

        ‖r‖ is small. If the estimated error is still too large, rounding limits it. The reason is
        then that of the absolute tolerance, because the relative one is not met.
        """
        reason = verdict.reason
        if reason < 0:
            return Outcome(reason, TEST_FAILED.format(reason))
        if self._state_error.is_too_large:
            reason = Reason.CONVERGED_FNORM_ABS
        return Outcome(reason, is_within_tolerances=verdict.is_within_tolerances)

    def _end_at_rounding(self, iterate: Iterate) -> Outcome:
        """Converge, and log if rounding leaves the free dofs visibly out of balance."""
        system = self._system
        force = norm(system.comm, system.conditions.free(iterate.residual.force))
        load = self._convergence.applied_load(iterate)
        if self.history and force > MAX_ROUNDING_SHARE * load:
            warn(_ROUNDING_WARNING.format(force, load), system.comm)
        return Outcome(Reason.CONVERGED_FNORM_ABS, is_within_tolerances=True)

    def _end_with_error(self) -> Outcome:
        """Converge: ‖r‖ is small, and no step lowers the estimated error."""
        self._state_error.log()
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
        self._last = time.perf_counter()

    def lap(self) -> float:
        """Return the seconds since the last lap."""
        now = time.perf_counter()
        seconds = now - self._last
        self._last = now
        return seconds
