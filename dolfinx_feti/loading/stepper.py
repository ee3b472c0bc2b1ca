# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Steps through wanted loads or times: the order of events in a step.

1. *Solve*: u balances the new load with the memory and the dashpots of the last state. After a
   failure the last state is restored and the length halved, down to the least.
2. *Complete*: velocities and accelerations are set to those of the end of the step, and so are
   internal variables that the balance does not depend on. The next length is chosen.
3. *Call* ``on_step``. Stresses and reactions that it evaluates are those that were balanced: memory
   and dashpots are still those of the last state.
4. *Accept*: memory and dashpots advance. From here on the new state is the last one. A step is also
   accepted if ``on_step`` raises.
5. *Write* the checkpoint. A restart calls ``on_step`` again for a step that was not written.

An exception in between, Ctrl-C and SIGTERM included, restores the last accepted state: load,
unknowns, memory, and conditions. The rule for the lengths is in ``step_length``; ``load_steps`` and
``time_steps`` define what is solved for.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict
from functools import partial
from typing import Any, Generic, Literal, TypeVar

from mpi4py import MPI

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.load_step import LoadStep, read_step
from dolfinx_feti.loading.places import PlaceTolerance
from dolfinx_feti.loading.problem import Problem
from dolfinx_feti.loading.progress import Progress, noted_signals
from dolfinx_feti.loading.state import PathState
from dolfinx_feti.loading.step_length import StepLengthRule
from dolfinx_feti.runtime.collective import error_message, on_all

__all__ = ["Stepper"]

Step = TypeVar("Step", bound=LoadStep)


class Stepper(ABC, Generic[Step]):
    """Steps of one kind from the present state through targets.

    Each kind of steps is a derived class. It defines

    * :meth:`_attempt`: solve for a state (1);
    * :meth:`_complete`: complete a solved state and the record of its step (2);
    * :meth:`_is_met`: whether a target is met;
    * :meth:`_remedy`: what helps after a failure at the least length.

    It may override

    * :meth:`_begin`: prepare the first step;
    * :meth:`_advance`: advance histories that are not internal variables of the problem (4);
    * :meth:`_after_restore`: restore what is not part of ``state``, after a failure or an error;
    * :meth:`_has_loose_tolerance`: whether a state between targets was solved loosely (4).

    Attributes:
        state: The present state and the accepted ones.
        length_rule: The rule for the lengths of steps, with the present one.
    """

    def __init__(
        self,
        problem: Problem,
        set_place: Callable[[float], object],
        length_rule: StepLengthRule[Step],
        state: PathState,
        *,
        step_type: type[Step],
        function_name: str,
        failure: str,
        quantity: Literal["load", "time"],
    ) -> None:
        """Create a stepper in the present state.

        Args:
            problem: The problem.
            set_place: Sets the user's loads and conditions to those of a load or time.
            length_rule: The rule for the lengths, with the first one.
            state: The state, accepted at the beginning of the path.
            step_type: Class of the accepted steps.
            function_name: Name of the public function, which a checkpoint stores.
            failure: Beginning of the message after a failure at the least length; a place follows.
            quantity: What a place is, for the log.
        """
        self.state = state
        self.length_rule = length_rule
        self._comm: MPI.Comm = problem.unknown.function_space.mesh.comm
        self._problem = problem
        self._set_user_place = set_place
        self._step_type = step_type
        self._function_name = function_name
        self._failure = failure
        self._quantity = quantity
        self._check_signals: Callable[[], None] = _no_signal  # replaced by follow
        self._reached = [self.at]  # targets that were met, and the start
        self._is_loose = False  # whether the present state was solved with a loose tolerance
        problem.renew()

    @property
    def at(self) -> float:
        """The load or time of the last accepted state."""
        return self.state.at

    def follow(
        self,
        targets: Sequence[float],
        *,
        on_step: Callable[[Step], object] | None,
        checkpoint: Checkpoint | None,
        unit: str,
    ) -> list[Step]:
        """Step through the targets. Collective.

        Args:
            targets: Loads or times to be met exactly, one after the other.
            on_step: Called after each step, before memory and dashpots advance.
            checkpoint: Where each accepted state is written, and where a restart begins.
            unit: Name of the unit of the load or time, for the progress bar.

        Returns:
            The accepted steps, those before a restart included.
        """
        accepted: list[Step] = []
        tolerance = PlaceTolerance.of([self.at, *targets], self.length_rule.least)
        is_restarted = False
        if checkpoint is not None and checkpoint.restart:
            accepted, targets = self._restart(checkpoint, targets, tolerance)
            is_restarted = True
        targets = tolerance.without_repeats(self.at, targets)
        with noted_signals() as check_signals, self._restored_on_error():
            self._check_signals = check_signals
            progress = Progress(
                self._problem.solver,
                self._comm,
                check_signals,
                loads=[self.at, *targets],
                unit=unit,
                number=len(accepted),
                quantity=self._quantity,
            )
            with closing(progress):
                if checkpoint is not None and is_restarted:
                    progress.log_restart(self.at, checkpoint.folder)
                self._begin(targets, is_restarted=is_restarted)
                self.state.update_accepted()
                for target in targets:
                    while not self._is_met(target):
                        step = self._take_step(target, progress)  # 1 and 2
                        accepted.append(step)
                        progress.log_step(step)
                        self._end_step(step, target, on_step)  # 3 and 4
                        if checkpoint is not None:
                            self._write(checkpoint, accepted)  # 5
                        on_all(check_signals, self._comm)
        return accepted

    # -- defined by each kind of steps

    @abstractmethod
    def _attempt(self, to: float, target: float) -> None:
        """Solve for the state at a place on the way to a target. Collective.

        Raises:
            ConvergenceError: There is no solution; any state may be left behind.
        """

    @abstractmethod
    def _complete(self, step: LoadStep) -> Step:
        """Complete the solved state, and return the step with all that was measured. Collective."""

    @abstractmethod
    def _is_met(self, target: float) -> bool:
        """Return True if the last accepted state meets a target."""

    @abstractmethod
    def _remedy(self, error: ConvergenceError) -> str:
        """Return what helps after a failure at the least length; empty if the error says it."""

    def _has_loose_tolerance(self, to: float, target: float) -> bool:
        """Return True if the state at a place is solved with a loose tolerance."""
        return False

    def _begin(self, targets: Sequence[float], *, is_restarted: bool) -> None:
        """Prepare the first step. Collective."""

    def _advance(self) -> None:
        """Advance histories that are not internal variables of the problem. Collective."""

    def _after_restore(self) -> None:
        """Set what follows from a state that has been restored; not collective."""

    # -- the order of events

    def _take_step(self, target: float, progress: Progress) -> Step:
        """Solve for the next state, with shorter lengths after failures, and complete it.

        Collective.
        """
        start_time = time.perf_counter()
        before = self.at
        failures = 0
        lost = []
        while True:
            to = self.length_rule.next_place(before, target)
            progress.show_attempt(before, to)
            try:
                self._attempt(to, target)
                break
            except ConvergenceError as error:
                failures += 1
                lost += self._problem.history
                # in this order: the user's function may change Constants of the state
                self._set_place(before)
                self._restore()
                self._problem.renew()
                progress.log_failure(to, error)
                self._shorten(abs(to - before), error, failures=failures)
        on_all(self._check_signals, self._comm)
        self._problem.warn_of_cells()
        step = LoadStep(
            load=to,
            increment=to - before,
            history=tuple(self._problem.history),
            failures=failures,
            lost=tuple(lost),
            seconds=time.perf_counter() - start_time,
        )
        completed = self._complete(step)
        self._problem.update_internal_variables("recorded")
        self.length_rule.adapt(completed, n_updates=self._problem.n_updates)
        return completed

    def _end_step(
        self, step: Step, target: float, on_step: Callable[[Step], object] | None
    ) -> None:
        """Call ``on_step``, and accept the state even if that raises an error. Collective."""
        try:
            if on_step is not None:
                on_all(partial(on_step, step), self._comm)  # 3
        finally:
            self._accept(step.load, target)  # 4

    def _accept(self, to: float, target: float) -> None:
        """Advance the histories, and accept the state. Collective."""
        self._problem.update_internal_variables("in_forces")
        self._advance()
        self.state.accept(to)
        self._is_loose = self._has_loose_tolerance(to, target)
        if to == target:  # exactly: the last step to a target leads to the target itself
            self._reached.append(to)

    def _set_place(self, place: float) -> None:
        """Set load and conditions to those of a place, where a step may end.

        Scalars and contacts get the length of that step (``begin_step``), unless the place is that
        of the last accepted state. Collective; raises on all processes.
        """

        def work() -> None:
            self._check_signals()
            if place != self.at:
                self._problem.begin_step(place - self.at)
            self._set_user_place(place)

        on_all(work, self._comm)

    def _restore(self) -> None:
        """Restore the last accepted state, but not load and conditions; not collective."""
        self.state.restore()
        self._after_restore()

    @contextmanager
    def _restored_on_error(self) -> Iterator[None]:
        """Restore the last accepted state, load and conditions if anything is raised.

        Not collective: what was raised need not be raised on all processes.
        """
        try:
            yield
        except BaseException as error:
            try:
                self._set_user_place(self.at)
            except Exception as second_error:  # the first error is the cause
                error.add_note(f"Conditions could not be set back: {error_message(second_error)}")
            self._restore()
            raise

    def _shorten(self, length: float, error: ConvergenceError, *, failures: int) -> None:
        """Halve the length of steps after a failure.

        Args:
            length: The length that failed.
            error: How it failed.
            failures: Number of attempts of this step that have failed.

        Raises:
            ConvergenceError: The step that failed had the least length.
        """
        if self.length_rule.is_least(length, self.at):
            attempts = "" if failures == 1 else f", the last of {failures} attempts,"
            text = (
                f"{self._failure} {self.at:g}: an increment of {length:g}{attempts} failed, and "
                f"{self.length_rule.least:g} is the least allowed. {error} {self._remedy(error)}"
            )
            raise ConvergenceError(text.rstrip()) from error
        self.length_rule.halve(length)

    # -- checkpoints

    def _write(self, checkpoint: Checkpoint, accepted: Sequence[Step]) -> None:
        """Write all that the next solve depends on, so that a restart repeats it. Collective.

        The preconditioner is not written. It is discarded, so that the next solve is the same with
        and without a restart.
        """
        record = {
            "function": self._function_name,
            "length": self.length_rule.record(),
            "reached": self._reached,
            "is_loose": self._is_loose,
            "steps": [asdict(step) for step in accepted],
        }
        self.state.write(checkpoint, record, with_step_before=self._is_loose)
        self._problem.renew()

    def _restart(
        self, checkpoint: Checkpoint, targets: Sequence[float], tolerance: PlaceTolerance
    ) -> tuple[list[Step], list[float]]:
        """Restore the state of a checkpoint, or the state a step before it. Collective.

        A state that was solved with a loose tolerance meets no target. If the next target is at its
        place, the path goes a step back, memory included, to take that step again.

        Returns:
            The steps that led there, and the targets that are still to be met.

        Raises:
            ValueError: The checkpoint was written by another function or with another rule for the
                lengths, or is one of another problem. The state is left as it was.
        """
        record: dict[str, Any] = checkpoint.record or {}
        accepted = self._read_steps(record, checkpoint)
        on_all(lambda: self._restore_length(record, checkpoint), self._comm)
        self.state.read(checkpoint)
        self._reached = record["reached"]
        is_loose = bool(record["is_loose"])
        remaining = self._unmet(targets, tolerance)
        if is_loose and remaining and tolerance.are_equal(self.at, remaining[0]):
            accepted.pop()
            self.state.step_back()
            is_loose = False
        self._is_loose = is_loose
        # in this order: the user's function may change Constants of the state
        self._set_place(self.at)
        self.state.restore()
        return accepted, remaining

    def _read_steps(self, record: Mapping[str, Any], checkpoint: Checkpoint) -> list[Step]:
        """Return the accepted steps of a record.

        Raises:
            ValueError: The record was written by another function, or its steps have other fields.
        """
        foreign = ValueError(
            f"The checkpoint in {checkpoint.folder} was not written by {self._function_name} of "
            "this version: name another folder."
        )
        if record.get("function") != self._function_name:
            raise foreign
        try:
            return [read_step(step, self._step_type) for step in record["steps"]]
        except (KeyError, TypeError) as error:
            raise foreign from error

    def _restore_length(self, record: Mapping[str, Any], checkpoint: Checkpoint) -> None:
        """Set the rule for the lengths to that of a record.

        Raises:
            ValueError: Another rule wrote the record, which lacks what this one remembers.
        """
        try:
            self.length_rule.restore(record["length"])
        except KeyError as error:
            rule = type(self.length_rule).__name__
            raise ValueError(
                f"The checkpoint in {checkpoint.folder} holds no {error}, which {rule} remembers "
                "from step to step: it was written with another rule for the lengths of steps. "
                "Restart with the settings of steps that wrote it, or name another folder."
            ) from error

    def _unmet(self, targets: Sequence[float], tolerance: PlaceTolerance) -> list[float]:
        """Return the targets without those that were met, in their order, before a restart."""
        remaining = list(targets)
        for reached in self._reached:
            if remaining and tolerance.are_equal(remaining[0], reached):
                remaining.pop(0)
        return remaining


def _no_signal() -> None:
    """Check signals outside of a path: there are none to check."""
