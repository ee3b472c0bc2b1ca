# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A path through wanted loads or times: attempts, each shorter than the one that failed before.

What is left to the next wanted place is divided into equal steps that are not longer than the
present length, so that it is met exactly. After a failure the last state is restored and the length
halved, down to the least. ``load_steps`` and ``time_steps`` say what a step is, and how long the
next one may be.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.progress import Progress
from dolfinx_feti.loading.steps import Lengths, Step, load_step
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.system import Tangent
from dolfinx_feti.runtime.collective import on_all

__all__ = ["Path", "Place", "Problem", "check_places"]

Array = npt.NDArray[np.float64]

#: What the last digits of a length are worth, relative to it and to where it begins.
ROUNDING = 1e-12

AnyLengths = TypeVar("AnyLengths", bound=Lengths)


class Problem(Protocol):
    """What is asked of a problem; :class:`~dolfinx_feti.NonlinearProblem` has it."""

    u: dolfinx.fem.Function
    solver: PETSc.SNES
    volume_changes: list[float]

    @property
    def internal_variables(self) -> Sequence[dolfinx.fem.Function]:
        """What the material remembers."""

    def update_internal_variables(self) -> None:
        """Let the material remember the present state."""

    @property
    def history(self) -> list[NewtonStep]:
        """What each Newton step of the last solve cost."""

    def residual_norm(self) -> float:
        """Return ‖r‖ of the present state under the present load."""

    def linearise(self) -> Tangent:
        """Assemble the tangent at the present state and load."""

    def solve(
        self,
        *,
        reference: float | None = None,
        first_tangent: Tangent | None = None,
        renew: bool = True,
    ) -> object:
        """Solve, or raise ConvergenceError."""

    def renew(self) -> None:
        """Let the next solve depend on none before."""


class Place(NamedTuple):
    """A load or time, and the values of all functions there."""

    at: float
    values: list[Array]


class Path(ABC, Generic[Step, AnyLengths]):
    """The last places and the length of the next step.

    Attributes:
        order: So many places before the present one are kept.
        kind: Class of the steps.
        words: The function that follows such a path, and what a failure at the least length says
            first and last.
    """

    order = 0
    kind: type[Step]
    words: tuple[str, str, str]

    def __init__(
        self,
        problem: Problem,
        set_place: Callable[[float], object],
        steps: AnyLengths,
        *,
        state: Sequence[dolfinx.fem.Function],
        start: float,
    ) -> None:
        """Begin with the present state, see the function that follows."""
        self._comm: MPI.Comm = problem.u.function_space.mesh.comm
        self._problem, self._state = problem, list(state)
        self._set_place = lambda place: on_all(lambda: set_place(place), self._comm)
        self._steps, self._length = steps, steps.first
        self._past = [Place(float(start), self._values())]
        self._met = [self.at]
        problem.renew()

    @property
    def at(self) -> float:
        """The present load or time."""
        return self._past[-1].at

    def follow(
        self,
        targets: Sequence[float],
        *,
        on_step: Callable[[Step], object] | None,
        checkpoint: Checkpoint | None,
        unit: str,
    ) -> list[Step]:
        """Go through the targets.

        Note:
            Collective.
        """
        accepted: list[Step] = []
        if checkpoint is not None and checkpoint.restart:
            accepted = self._recall(checkpoint)
            targets = self._unmet(targets)
        self._begin(restarted=bool(accepted))
        snes, places, number = self._problem.solver, [self.at, *targets], len(accepted)
        with Progress(snes, self._comm, loads=places, unit=unit, number=number) as bar:
            for target in map(float, targets):
                while not self._is_met(target):
                    step = self._advance(target, bar)
                    accepted.append(step)
                    bar.accept(step)
                    if checkpoint is not None:
                        self._keep(checkpoint, accepted)
                    if on_step is not None:
                        on_all(partial(on_step, step), self._comm)
        return accepted

    # -- what a kind of path says

    @abstractmethod
    def _attempt(self, to: float, target: float) -> None:
        """Solve for the state at a place on the way to a target, or raise ConvergenceError."""

    @abstractmethod
    def _arrive(self, step: dict[str, Any]) -> Step:
        """Choose the next length; return the step, which the present state is the end of."""

    @abstractmethod
    def _is_met(self, target: float) -> bool:
        """Tell whether nothing is left to do up to a target."""

    def _begin(self, *, restarted: bool) -> None:
        """Prepare the first step."""

    @property
    def _kept(self) -> list[dolfinx.fem.Function]:
        """What a restart needs, the state first."""
        return [*self._state, *self._problem.internal_variables]

    # -- what they share

    def _advance(self, target: float, bar: Progress) -> Step:
        """Find the next state."""
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
                self._restore()
                self._problem.renew()
                bar.refuse(to, error)
                self._shorten(abs(to - before), error)
        self._problem.update_internal_variables()
        step = {
            "load": to,
            "increment": to - before,
            "history": tuple(self._problem.history),
            "failures": failures,
            "lost": tuple(lost),
            "seconds": time.perf_counter() - started,
        }
        found = self._arrive(step)
        past = [place for place in self._past[-self.order :] if place.at != to]
        self._past = [*past[: self.order], Place(to, self._values())]
        self._met += [to] if to == target else []
        return found

    def _next(self, target: float) -> float:
        """Return where the next attempt leads, to the target itself at the end."""
        count = math.ceil(abs(target - self.at) / self._length * (1.0 - ROUNDING))
        return target if count <= 1 else self.at + (target - self.at) / count

    def _shorten(self, length: float, error: ConvergenceError) -> None:
        """Halve the length, down to the least.

        Raises:
            ConvergenceError: It was the least.
        """
        if length <= self._steps.least + ROUNDING * (length + abs(self.at)):
            _, lost, remedy = self.words
            raise ConvergenceError(
                f"{lost} {self.at:g}: an increment of {length:g} failed, too, and "
                f"{self._steps.least:g} is the least allowed. {error} {remedy}"
            ) from error
        self._length = max(length / 2.0, self._steps.least)

    def _unmet(self, targets: Sequence[float]) -> list[float]:
        """Return the targets without those that were met, in their order, before a restart."""
        left = list(targets)
        for place in self._met:
            if left[:1] == [place]:
                del left[0]
        return left

    def _restore(self) -> None:
        """Go back to the last place."""
        self._set_values(self._past[-1].values)
        self._set_place(self.at)

    def _values(self) -> list[Array]:
        return [f.x.array.copy() for f in self._state]

    def _set_values(self, values: list[Array]) -> None:
        for f, array in zip(self._state, values, strict=True):
            f.x.array[:] = array

    def _keep(self, checkpoint: Checkpoint, accepted: Sequence[Step]) -> None:
        """Write the last places, the present one at the end, and how they were found.

        The next solve depends on nothing else, so that a restart repeats it.
        """
        record = {
            "loads": [place.at for place in self._past],
            "increment": self._length,
            "met": self._met,
            "steps": [asdict(step) for step in accepted],
        }
        checkpoint.write(self._kept, record, [place.values for place in self._past[:-1]])
        self._problem.renew()

    def _recall(self, checkpoint: Checkpoint) -> list[Step]:
        """Go where a checkpoint was written; return the steps that led there."""
        record: dict[str, Any] = checkpoint.record or {}
        try:
            accepted = [load_step(step, self.kind) for step in record["steps"]]
            loads, length, met = record["loads"], record["increment"], record["met"]
        except (KeyError, TypeError) as error:
            raise ValueError(
                f"The checkpoint in {checkpoint.folder} was not written by {self.words[0]} of "
                "this version: name another folder."
            ) from error
        values = [*checkpoint.read(self._kept), self._values()]
        self._past = [Place(*known) for known in zip(loads, values, strict=True)]
        self._length, self._met = length, met
        self._set_place(self.at)
        return accepted


def check_places(start: float, targets: Sequence[float], *, unloading: bool) -> None:
    """Require finite loads or times in order.

    Raises:
        ValueError: One is not finite, or they turn back although ``unloading`` is False.
    """
    if not all(math.isfinite(place) for place in (start, *targets)):
        raise ValueError(f"start={start}, targets={list(targets)}: loads are finite numbers.")
    ways = np.sign(np.diff([start, *targets]))
    if not unloading and {-1.0, 1.0} <= set(ways):
        raise ValueError(
            f"start={start}, targets={list(targets)}: the load turns back on its way. Put the "
            "targets in order, or allow it by unloading=True."
        )
