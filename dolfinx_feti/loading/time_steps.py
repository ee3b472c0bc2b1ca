# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Time steps: the motion of a problem with inertia, in steps that are fixed or adapted.

A step that fails, or whose estimated error e is above the tolerance, is tried again from the last
state with a shorter one. After a good one the length becomes

.. math:: Δt ← Δt\, \max(½, \min(g,\ 0.9\, (\mathrm{tol}/e)^{1/3})),

g being the most that it may grow by, up to the longest. The wanted times are met exactly.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Protocol

import dolfinx
import ufl

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.energies import Energies, create_energies
from dolfinx_feti.loading.load_steps import Problem, check_loads
from dolfinx_feti.loading.motion import Motion
from dolfinx_feti.loading.progress import Progress
from dolfinx_feti.loading.steps import LoadStep, load_step
from dolfinx_feti.runtime.collective import on_all

__all__ = ["TimeStep", "TimeSteps", "follow_time"]

#: Share of the length that the error estimate asks for, and the least of the last one.
SAFETY, SHORTEST = 0.9, 0.5


@dataclass(frozen=True, slots=True)
class TimeSteps:
    """How to choose the lengths of time steps.

    Attributes:
        first: The first one [s].
        least: The length below which there is no further halving [s].
        longest: The longest [s]; the first one if not given.
        tolerance: Most that the estimated error of the displacement may be in a step [mm]; if not
            given, steps are as long as the first one unless they fail.
        growth: Factor by which a step is longer than the last one, at most.

    Raises:
        ValueError: A number is out of its range.
    """

    first: float
    least: float
    longest: float | None = None
    tolerance: float | None = None
    growth: float = 1.5

    def __post_init__(self) -> None:
        """Check the values."""
        if not 0.0 < self.least <= self.first <= self.most < math.inf:
            raise ValueError(
                f"least={self.least}, first={self.first}, longest={self.longest}: lengths are "
                "positive numbers in this order."
            )
        if self.tolerance is not None and not 0.0 < self.tolerance < math.inf:
            raise ValueError(f"tolerance={self.tolerance}: give a positive length.")
        if not 1.0 <= self.growth < math.inf:
            raise ValueError(f"growth={self.growth} is not a number of 1 or more.")

    @property
    def most(self) -> float:
        """The longest length."""
        return self.first if self.longest is None else self.longest


@dataclass(frozen=True, slots=True)
class TimeStep(LoadStep):
    """An accepted time step; its load is the time.

    Attributes:
        kinetic: Kinetic energy at its end.
        stored: Energy of the material at its end, if it was given; else NaN.
        work: Work of the external forces in it, if they were given; else NaN.
        error: Estimated error of the displacement.
    """

    kinetic: float
    stored: float
    work: float
    error: float


class MovingProblem(Problem, Protocol):
    """What is asked of a problem; :class:`~dolfinx_feti.NonlinearProblem` has it."""

    F: dolfinx.fem.Form
    bcs: Sequence[dolfinx.fem.DirichletBC]


def follow_time(
    problem: MovingProblem,
    motion: Motion,
    set_time: Callable[[float], object],
    targets: Sequence[float],
    steps: TimeSteps,
    *,
    state: Sequence[dolfinx.fem.Function],
    start: float = 0.0,
    energy: ufl.Form | None = None,
    forces: ufl.Form | None = None,
    on_step: Callable[[TimeStep], object] | None = None,
    checkpoint: Checkpoint | None = None,
    unit: str = "s",
) -> list[TimeStep]:
    """Follow the motion from one time through others to the last.

    It begins with the present displacement and ``motion.velocity``; the acceleration follows.

    Args:
        problem: The nonlinear problem, with the inertia of ``motion`` in its forms.
        motion: Its motion.
        set_time: Sets loads and conditions to those of a time, also between the steps.
        targets: Times to be met exactly, ascending.
        steps: How to choose the lengths of the steps.
        state: All functions that a solve changes, u and a condensed pressure. The pressure stays
            that of the last balance of forces, between the last times.
        start: The present time.
        energy: What the material stores, for the balance kinetic + stored − work of each step.
        forces: External forces, tested with v, for the same: their work is integrated by the
            trapezoidal rule.
        on_step: Called at the end of each step on all processes, for output.
        checkpoint: Where each new state is kept, before ``on_step`` is called. If it was opened to
            restart, the state in it takes the place of the present one.
        unit: Name of the unit of time.

    Returns:
        The accepted steps, those before a restart included.

    Raises:
        ValueError: A time is not finite, or they do not ascend, or a checkpoint is one of another
            problem.
        OSError: A checkpoint cannot be written.
        ConvergenceError: No step of the least length leads on; the state is that of its beginning.
        Exception: What ``set_time`` or ``on_step`` raise, on all processes if on one.

    Note:
        Collective.
    """
    comm = problem.u.function_space.mesh.comm
    on_all(lambda: check_loads(start, targets, unloading=False), comm)
    path = _Path(
        problem,
        motion,
        lambda t: on_all(lambda: set_time(t), comm),
        steps,
        state=state,
        t=start,
        energies=create_energies(problem.u, energy, forces),
    )
    accepted: list[TimeStep] = []
    if checkpoint is not None and checkpoint.restart:
        accepted = path.restore(checkpoint)
    else:
        path.begin()
    with Progress(
        problem.solver, comm, loads=[path.t, *targets], unit=unit, number=len(accepted)
    ) as bar:
        for target in targets:
            while path.t < target:
                step = path.advance(target, bar)
                accepted.append(step)
                bar.accept(step)
                if checkpoint is not None:
                    path.keep(checkpoint, accepted)
                if on_step is not None:
                    on_all(partial(on_step, step), comm)
    return accepted


class _Path:
    """The last state and the length of the next step."""

    def __init__(
        self,
        problem: MovingProblem,
        motion: Motion,
        set_time: Callable[[float], object],
        steps: TimeSteps,
        *,
        state: Sequence[dolfinx.fem.Function],
        t: float,
        energies: Energies,
    ) -> None:
        self._problem, self._motion, self._set_time, self._steps = problem, motion, set_time, steps
        self._state, self._energies = list(state), energies
        self._length = steps.first
        self.t = float(t)
        problem.renew()

    @property
    def _kept(self) -> list[dolfinx.fem.Function]:
        """All that a restart needs."""
        moving = (self._motion.velocity, self._motion.acceleration)
        return [*self._state, *moving, *self._problem.internal_variables]

    def begin(self) -> None:
        """Find the initial acceleration."""
        self._set_time(self.t)
        self._motion.start(self._problem.F, list(self._problem.bcs))

    def keep(self, checkpoint: Checkpoint, accepted: Sequence[TimeStep]) -> None:
        """Write the state; the next solve depends on nothing else."""
        steps = [asdict(step) for step in accepted]
        checkpoint.write(self._kept, {"t": self.t, "length": self._length, "steps": steps})
        self._problem.renew()

    def restore(self, checkpoint: Checkpoint) -> list[TimeStep]:
        """Go where a checkpoint was written; return the steps that led there."""
        record: dict[str, Any] = checkpoint.record or {}
        try:
            accepted = [load_step(step, TimeStep) for step in record["steps"]]
            self.t, self._length = record["t"], record["length"]
        except (KeyError, TypeError) as error:
            raise ValueError(
                f"The checkpoint in {checkpoint.folder} was not written by follow_time of this "
                "version: name another folder."
            ) from error
        checkpoint.read(self._kept)
        self._set_time(self.t)
        return accepted

    def advance(self, target: float, bar: Progress) -> TimeStep:
        """Make the next step."""
        started, failures, lost = time.perf_counter(), 0, []
        last, forces = [f.x.array.copy() for f in self._state], self._energies.present_forces()
        while True:
            count = math.ceil((target - self.t) / self._length * (1.0 - 1e-12))
            dt = (target - self.t) / max(count, 1)
            bar.attempt(self.t, self.t + dt)
            try:
                error = self._attempt(dt)
                break
            except ConvergenceError as failure:
                failures += 1
                lost += self._problem.history
                bar.refuse(self.t + dt, failure)
                for f, array in zip(self._state, last, strict=True):
                    f.x.array[:] = array
                self._set_time(self.t)
                self._problem.renew()
                self._shorten(dt, failure)
        self._problem.update_internal_variables()
        moved = self._motion.leave()
        self.t = target if count <= 1 else self.t + dt
        self._set_time(self.t)
        self._lengthen(dt, error)
        return TimeStep(
            load=self.t,
            increment=dt,
            history=tuple(self._problem.history),
            failures=failures,
            lost=tuple(lost),
            seconds=time.perf_counter() - started,
            kinetic=self._motion.kinetic_energy(),
            stored=self._energies.stored(),
            work=self._energies.work(forces, moved),
            error=error,
        )

    def _attempt(self, dt: float) -> float:
        """Balance the forces of a step; return the estimated error.

        Raises:
            ConvergenceError: It failed, or the error is too large.
        """
        between = self._motion.enter(dt)
        self._set_time(self.t + between)
        reference = self._problem.residual_norm()
        self._motion.predict()
        self._problem.solve(reference=reference, renew=False)
        error, most = self._motion.error(), self._steps.tolerance
        if most is not None and error > most:
            raise ConvergenceError(
                f"A step of {dt:g} has an estimated error of {error:.1e} in the displacement, "
                f"and {most:g} is allowed."
            )
        return error

    def _shorten(self, dt: float, failure: ConvergenceError) -> None:
        """Halve the length, down to the least.

        Raises:
            ConvergenceError: It was the least.
        """
        if dt <= self._steps.least * (1.0 + 1e-12):
            raise ConvergenceError(
                f"The motion was not found beyond the time {self.t:g}: a step of {dt:g} failed, "
                f"too, and {self._steps.least:g} is the least allowed. {failure} Allow shorter "
                "steps, or a larger tolerance."
            ) from failure
        self._length = max(dt / 2.0, self._steps.least)

    def _lengthen(self, dt: float, error: float) -> None:
        """Choose the length of the next step."""
        factor, most = self._steps.growth, self._steps.tolerance
        if most is not None and error > 0.0:
            factor = min(factor, max(SHORTEST, SAFETY * (most / error) ** (1.0 / 3.0)))
        grown = min(self._steps.most, factor * dt)
        shorter_at_target = factor > 1.0 and dt < self._length
        self._length = max(self._length if shorter_at_target else grown, self._steps.least)
