# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Steps through wanted loads or times: the order of events in a step.

1. *Solve*: u balances the new load with the memory and the dashpots of the last state. After a
   failure the last state is restored and the length halved, down to the least.
2. *Arrive*: velocities and accelerations are those of the end of the step, and so are internal
   variables that the balance does not depend on.
3. *Show*: ``on_step`` is called. Stresses and reactions that it evaluates are those that were
   balanced: memory and dashpots are still those of the last state.
4. *Remember*: memory and dashpots advance. From here on the new state is the last one. A step that
   ``on_step`` has been called for is remembered even if that raises.
5. *Keep*: the checkpoint is written. A restart shows a step again that was not kept.

Whatever is raised in between, Ctrl-C and SIGTERM included, leaves the last state: load, unknowns,
memory, and conditions. What is left to the next wanted place is divided into equal steps that are
not longer than the present length, so that it is met exactly. ``load_steps`` and ``time_steps``
say what a step is, and how long the next one may be.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict
from functools import partial
from typing import Any, TypeAlias

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.fixed_point import FixedPoint
from dolfinx_feti.loading.progress import Progress, noted_signals
from dolfinx_feti.loading.state import PathState
from dolfinx_feti.loading.steps import Lengths, LoadStep, load_step
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.runtime.collective import on_all, reason

__all__ = ["Problem", "Stepper", "check_places", "loosened"]

#: What the last digits of a length are worth, relative to it and to where it begins.
ROUNDING = 1e-12

#: What a path can follow.
Problem: TypeAlias = NonlinearProblem | FixedPoint


class Stepper:
    """The state, the last ones before it, and the length of the next step.

    Attributes:
        state: All that a step changes.
        order: So many states before the present one are kept.
        kind: Class of the steps.
        name: The function that takes the steps.
        missed, remedy: What a failure at the least length says first and last.
    """

    order = 0
    kind: type[LoadStep]
    name: str
    missed: str
    remedy: str

    def __init__(
        self,
        problem: Problem,
        set_place: Callable[[float], object],
        steps: Lengths,
        state: PathState,
    ) -> None:
        """Begin with the present state."""
        self._comm: MPI.Comm = problem.u.function_space.mesh.comm
        self._problem, self.state, self._user = problem, state, set_place
        self._lengths, self._length = steps, steps.first
        self._check: Callable[[], None] = lambda: None  # raises what a signal means
        self._past, self._met = [state.copy()], [self.at]
        problem.renew()

    @property
    def at(self) -> float:
        """The present load or time."""
        return self.state.at

    def follow(
        self,
        targets: Sequence[float],
        *,
        on_step: Callable[[Any], object] | None,
        checkpoint: Checkpoint | None,
        unit: str,
    ) -> list[Any]:
        """Go through the targets; return the steps. Collective."""
        accepted: list[LoadStep] = []
        if checkpoint is not None and checkpoint.restart:
            accepted = self._recall(checkpoint)
            targets = self._unmet(targets)
        snes, places, number = self._problem.solver, [self.at, *targets], len(accepted)
        with noted_signals() as self._check, self._whole_steps(), closing(
            Progress(snes, self._comm, self._check, loads=places, unit=unit, number=number)
        ) as bar:  # fmt: skip
            self._begin(targets, restarted=bool(accepted))
            self._past[-1] = self.state.copy()
            for target in map(float, targets):
                while not self._is_met(target):
                    step = self._reach(target, bar)
                    accepted.append(step)
                    bar.accept(step)
                    try:
                        if on_step is not None:
                            on_all(partial(on_step, step), self._comm)
                    finally:
                        self._remember(step.load, target)
                    if checkpoint is not None:
                        self._keep(checkpoint, accepted)
                    on_all(self._check, self._comm)
        return accepted

    # -- what a kind of steps says

    def _attempt(self, to: float, target: float) -> None:
        """Solve for the state at a place on the way to a target, or raise ConvergenceError."""
        raise NotImplementedError

    def _arrive(self, step: dict[str, Any]) -> LoadStep:
        """Go to the end of the step, and choose the next length; return the step."""
        raise NotImplementedError

    def _is_met(self, target: float) -> bool:
        """Tell whether nothing is left to do up to a target."""
        raise NotImplementedError

    def _begin(self, targets: Sequence[float], *, restarted: bool) -> None:
        """Prepare the first step."""

    def _advance(self) -> None:
        """Advance histories of this kind's own; on this process alone."""

    def _restored(self) -> None:
        """Set what follows from a state that has been restored; on this process alone."""

    # -- what they share

    def _reach(self, target: float, bar: Progress) -> LoadStep:
        """Find the next state, and arrive there."""
        started, before = time.perf_counter(), self.at
        failures, lost = 0, []
        while True:
            to = self._next(target)
            bar.attempt(before, to)
            try:
                self._attempt(to, target)
                break
            except ConvergenceError as error:
                failures += 1
                lost += self._problem.history
                self._set_place(before)
                self._back()
                self._problem.renew()
                bar.refuse(to, error)
                self._shorten(abs(to - before), error)
        on_all(self._check, self._comm)
        step = {"load": to, "increment": to - before, "history": tuple(self._problem.history)}
        step |= {"failures": failures, "lost": tuple(lost)}
        found = self._arrive(step | {"seconds": time.perf_counter() - started})
        self._problem.update_internal_variables(balanced=False)
        return found

    def _remember(self, to: float, target: float) -> None:
        """Advance the histories; from here on the new state is the one to go back to."""
        self._problem.update_internal_variables(balanced=True)
        self._advance()
        self.state.at = to
        past = [s for s in self._past[-self.order :] if s.at != to]
        self._past = [*past[: self.order], self.state.copy()]
        self._met += [to] if to == target else []

    def _set_place(self, place: float) -> None:
        """Set load and conditions, or raise on all processes."""

        def work() -> None:
            self._check()
            if place != self.at:
                self._problem.begin_step(place - self.at)
            self._user(place)

        on_all(work, self._comm)

    def _back(self) -> None:
        """Go back to the last state, but for load and conditions; on this process alone."""
        self.state.restore(self._past[-1])
        self._restored()

    @contextmanager
    def _whole_steps(self) -> Iterator[None]:
        """Leave the last state behind, whatever is raised; each process for itself."""
        try:
            yield
        except BaseException as error:
            try:
                self._user(self._past[-1].at)
            except Exception as second:  # the first one is what went wrong
                error.add_note(f"Conditions could not be set back: {reason(second)}")
            self._back()
            raise

    def _next(self, target: float) -> float:
        """Return where the next attempt leads, to the target itself at the end."""
        count = math.ceil(abs(target - self.at) / self._length * (1.0 - ROUNDING))
        return target if count <= 1 else self.at + (target - self.at) / count

    def _shorten(self, length: float, error: ConvergenceError) -> None:
        """Halve the length, down to the least; raise if it was the least."""
        least = self._lengths.least
        if length <= least + ROUNDING * (length + abs(self.at)):
            text = (
                f"{self.missed} {self.at:g}: an increment of {length:g} failed, too, and "
                f"{least:g} is the least allowed. {error} {self._remedy(error)}"
            )
            raise ConvergenceError(text.rstrip()) from error
        self._length = max(length / 2.0, least)

    def _remedy(self, error: ConvergenceError) -> str:
        """Say what helps after a failure at the least length."""
        return self.remedy

    def _unmet(self, targets: Sequence[float]) -> list[float]:
        """Return the targets without those that were met, in their order, before a restart."""
        left = list(targets)
        for place in self._met:
            left = left[left[:1] == [place] :]
        return left

    def _keep(self, checkpoint: Checkpoint, accepted: Sequence[LoadStep]) -> None:
        """Write all that the next solve depends on, so that a restart repeats it."""
        steps = [asdict(step) for step in accepted]
        record = {"kind": self.name, "increment": self._length, "met": self._met, "steps": steps}
        self.state.write(checkpoint, self._past[:-1], record)
        self._problem.renew()

    def _recall(self, checkpoint: Checkpoint) -> list[LoadStep]:
        """Go where a checkpoint was written; return the steps that led there."""
        record: dict[str, Any] = checkpoint.record or {}
        try:
            if record["kind"] != self.name:
                raise KeyError(record["kind"])
            accepted = [load_step(step, self.kind) for step in record["steps"]]
            past = self.state.read(checkpoint)
        except (KeyError, TypeError) as error:
            raise ValueError(
                f"The checkpoint in {checkpoint.folder} was not written by {self.name} of "
                "this version: name another folder."
            ) from error
        self._length, self._met = record["increment"], record["met"]
        self._past = [*past, self.state.copy()]
        self._set_place(self.at)
        self.state.restore(self._past[-1])
        return accepted


@contextmanager
def loosened(
    snes: PETSc.SNES, *, rtol: float = 0.0, atol: float = 0.0, linear_rtol: float = 0.0
) -> Iterator[None]:
    """Let the tolerances of a SNES and its KSP be no smaller than these for a while."""
    before = [(solver, solver.getTolerances()) for solver in (snes, snes.getKSP())]
    for (solver, own), least in zip(before, ((rtol, atol), (linear_rtol, 0.0)), strict=True):
        solver.setTolerances(rtol=max(own[0], least[0]), atol=max(own[1], least[1]))
    try:
        yield
    finally:
        for solver, own in before:
            solver.setTolerances(*own)


def check_places(start: float, targets: Sequence[float], *, unloading: bool) -> None:
    """Require finite loads or times that only turn back if ``unloading`` is True."""
    if not all(math.isfinite(place) for place in (start, *targets)):
        raise ValueError(f"start={start}, targets={list(targets)}: loads are finite numbers.")
    ways = np.sign(np.diff([start, *targets]))
    if not unloading and {-1.0, 1.0} <= set(ways):
        raise ValueError(
            f"start={start}, targets={list(targets)}: the load turns back on its way. Put the "
            "targets in order, or allow it by unloading=True."
        )
