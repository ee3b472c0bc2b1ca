# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Load steps: from equilibrium to equilibrium, up (or down) to the wanted loads.

The first steps begin with the tangent of the last equilibrium and the residual of the new load,

.. math:: K'(U_n; t_n)\, ΔU = -r(U_n; t_{n+1}), \qquad t_{n+1} = t_n + Δt,

(eq. 25, Augustin_eq:loadStepping), a prediction along the path: a tangent with the new load and the
old stress can be indefinite although every equilibrium on the way is stable. Once three equilibria
are known, a parabola through them predicts the next one, and saves half of the Newton steps; where
it turns a cell inside out, the tangent of the last equilibrium takes its place again.

The increment Δt grows after a quick step, and is halved after a failure, with the last equilibrium
restored. The wanted loads are met exactly: what is left to the next one is divided into equal
increments that are not longer than the current one. On the way equilibrium may be met more roughly
than there (``Steps.rtol``). Newton's tolerance refers to the residual that the new load leaves in
the last equilibrium, :math:`\|r(U_n; t_{n+1})\|`: a prediction can begin with one that is larger by
orders of magnitude, of which no share is an equilibrium.

FETI's preconditioner serves on from one load to the next (``-feti_lag``), but for the step that
follows a checkpoint: what a restart does not know, a run that goes on must not use.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Protocol

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.progress import Progress
from dolfinx_feti.loading.steps import LoadStep, Steps, load_step
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.system import Tangent
from dolfinx_feti.runtime.collective import on_all

__all__ = ["follow_load"]

Reason = PETSc.SNES.ConvergedReason

Array = npt.NDArray[np.float64]

#: What a load's last digits are worth, relative to the load.
LOAD_ROUNDING = 1e-14

#: Degree of the polynomial through the last equilibria that predicts the next one.
ORDER = 2


@dataclass(frozen=True, slots=True)
class _Equilibrium:
    """A load and the values of all functions there."""

    load: float
    values: list[Array]


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


def follow_load(
    problem: Problem,
    set_load: Callable[[float], object],
    targets: Sequence[float],
    steps: Steps,
    *,
    state: Sequence[dolfinx.fem.Function],
    start: float = 0.0,
    unloading: bool = False,
    on_step: Callable[[LoadStep], object] | None = None,
    checkpoint: Checkpoint | None = None,
    unit: str = "",
) -> list[LoadStep]:
    """Follow the equilibrium from one load through others to the last.

    Args:
        problem: The nonlinear problem, in equilibrium at the load ``start``.
        set_load: Sets the load in the user's forms.
        targets: Loads to be met exactly, one after the other.
        steps: How to choose the increments.
        state: All functions that a solve changes, u and a condensed pressure: they are restored
            after a failure. Internal variables of the problem are none of them: they are updated
            in each new equilibrium, before it is kept and ``on_step`` is called.
        start: The present load.
        unloading: Whether the load may turn back on its way through the targets.
        on_step: Called in each new equilibrium on all processes, for output.
        checkpoint: Where each new equilibrium is kept, before ``on_step`` is called. If it was
            opened to restart, the state in it takes the place of the present one and of
            ``start``, and the targets it has met before are left out.
        unit: Name of the load's unit, for the bar that shows the progress on a terminal and for the
            line that each step leaves in the log (logger ``dolfinx_feti``, level ``INFO``).

    Returns:
        The accepted steps, those before a restart included.

    Raises:
        ValueError: A load is not a finite number, the load turns back although ``unloading`` is
            False, or a checkpoint is one of another problem.
        OSError: A checkpoint cannot be written; state and load are those of the last equilibrium.
        ConvergenceError: No step of the least increment leads on; state and load are those of the
            last equilibrium.
        Exception: What ``set_load`` or ``on_step`` raise, on all processes if on one.

    Note:
        Collective.
    """
    comm = problem.u.function_space.mesh.comm
    on_all(lambda: check_loads(start, targets, unloading=unloading), comm)
    path = _Path(
        problem,
        lambda load: on_all(lambda: set_load(load), comm),
        steps,
        state=state,
        load=float(start),
    )
    accepted: list[LoadStep] = []
    if checkpoint is not None and checkpoint.restart:
        accepted = path.restore(checkpoint)
        start, targets = path.load, path.unmet(targets)
    loads, number = [start, *targets], len(accepted)
    with Progress(problem.solver, comm, loads=loads, unit=unit, number=number) as bar:
        for step in path.follow(targets, bar):
            accepted.append(step)
            bar.accept(step)
            problem.update_internal_variables()
            if checkpoint is not None:
                path.keep(checkpoint, accepted)
            if on_step is not None:
                on_all(partial(on_step, step), comm)
    return accepted


def check_loads(start: float, targets: Sequence[float], *, unloading: bool) -> None:
    """Require finite loads in order.

    Raises:
        ValueError: One is not finite, or they turn back although ``unloading`` is False.
    """
    if not all(math.isfinite(load) for load in (start, *targets)):
        raise ValueError(f"start={start}, targets={list(targets)}: loads are finite numbers.")
    ways = np.sign(np.diff([start, *targets]))
    if not unloading and {-1.0, 1.0} <= set(ways):
        raise ValueError(
            f"start={start}, targets={list(targets)}: the load turns back on its way. Put the "
            "targets in order, or allow it by unloading=True."
        )


class _Path:
    """The last equilibria and the increment to the next one."""

    def __init__(
        self,
        problem: Problem,
        set_load: Callable[[float], object],
        steps: Steps,
        *,
        state: Sequence[dolfinx.fem.Function],
        load: float,
    ) -> None:
        self._problem = problem
        self._set_load = set_load
        self._steps = steps
        self._state = list(state)
        self._increment = steps.first
        self._past = [_Equilibrium(load, self._values())]
        self._met = [load]
        problem.renew()

    @property
    def load(self) -> float:
        """The present load."""
        return self._past[-1].load

    def unmet(self, targets: Sequence[float]) -> list[float]:
        """Return the targets without those that were met, in their order, before a restart."""
        left = list(targets)
        for load in self._met:
            if left[:1] == [load]:
                del left[0]
        return left

    def follow(self, targets: Sequence[float], bar: Progress) -> Iterator[LoadStep]:
        """Yield the equilibria on the way."""
        rough = self._steps.rtol is not None
        for target in map(float, targets):
            while self.load != target or (rough and self._met[-1] != target):
                yield self._advance(target, bar)

    def keep(self, checkpoint: Checkpoint, accepted: Sequence[LoadStep]) -> None:
        """Write the last equilibria, the present one at the end, and how they were found.

        The next solve depends on nothing else, so that a restart repeats it.
        """
        record = {
            "loads": [known.load for known in self._past],
            "increment": self._increment,
            "met": self._met,
            "steps": [asdict(step) for step in accepted],
        }
        functions = [*self._state, *self._problem.internal_variables]
        checkpoint.write(functions, record, [known.values for known in self._past[:-1]])
        self._problem.renew()

    def restore(self, checkpoint: Checkpoint) -> list[LoadStep]:
        """Go where a checkpoint was written; return the steps that led there."""
        record: dict[str, Any] = checkpoint.record or {}
        try:
            accepted = [load_step(step, LoadStep) for step in record["steps"]]
            loads, increment, met = record["loads"], record["increment"], record["met"]
        except (KeyError, TypeError) as error:
            raise ValueError(
                f"The checkpoint in {checkpoint.folder} was not written by follow_load of this "
                "version: name another folder."
            ) from error
        past = checkpoint.read([*self._state, *self._problem.internal_variables])
        values = [*past, self._values()]
        self._past = [_Equilibrium(*known) for known in zip(loads, values, strict=True)]
        self._increment, self._met = increment, met
        self._set_load(self.load)
        return accepted

    def _advance(self, target: float, bar: Progress) -> LoadStep:
        """Find the next equilibrium."""
        started, before = time.perf_counter(), self._past[-1].load
        failures, lost = 0, []
        while True:
            load = self._next(target)
            bar.attempt(before, load)
            try:
                with self._tolerances(on_the_way=load != target):
                    self._attempt(load)
                break
            except ConvergenceError as error:
                failures += 1
                lost += self._problem.history
                bar.refuse(load, error)
                self._shorten(abs(load - before), error)
        others = [known for known in self._past[-ORDER:] if known.load != load]
        self._past = [*others, _Equilibrium(load, self._values())]
        self._met += [load] if load == target else []
        history = tuple(self._problem.history)
        extra = max(len(self._problem.volume_changes) - 1, 0)  # a step for each multiplier
        if failures == 0 and len(history) - extra <= self._steps.quick:
            grown = self._steps.growth * abs(load - before)
            self._increment = max(self._increment, grown)
        seconds = time.perf_counter() - started
        return LoadStep(load, load - before, history, failures, tuple(lost), seconds)

    def _next(self, target: float) -> float:
        """Return the load of the next attempt, the target itself at the end."""
        load = self._past[-1].load
        count = math.ceil(abs(target - load) / self._increment * (1.0 - 1e-12))
        return target if count <= 1 else load + (target - load) / count

    @contextmanager
    def _tolerances(self, *, on_the_way: bool) -> Iterator[None]:
        """Let rougher tolerances hold where a load is on the way only."""
        snes, steps = self._problem.solver, self._steps
        before = [(solver, solver.getTolerances()) for solver in (snes, snes.getKSP())]
        if on_the_way:
            for (solver, own), rtol in zip(before, (steps.rtol, steps.linear_rtol), strict=True):
                solver.setTolerances(rtol=max(rtol or 0.0, own[0]))
        try:
            yield
        finally:
            for solver, own in before:
                solver.setTolerances(*own)

    def _attempt(self, load: float) -> None:
        """Solve at a new load; on failure restore load and state."""
        try:
            if len(self._past) > ORDER:
                self._set_load(load)
                reference = self._problem.residual_norm()
                self._set_values(extrapolate(self._past, load))
                if self._solved(reference):
                    return
                self._restore()
            tangent = self._problem.linearise()
            self._set_load(load)
            self._solve(first_tangent=tangent)
        except ConvergenceError:
            self._restore()
            self._problem.renew()
            raise

    def _solved(self, reference: float) -> bool:
        """Solve from a predicted state; tell whether it was admissible, raise if it led nowhere."""
        try:
            self._solve(reference=reference)
        except ConvergenceError:
            if self._problem.solver.getConvergedReason() != Reason.DIVERGED_FUNCTION_DOMAIN:
                raise
            return False
        return True

    def _solve(
        self, *, reference: float | None = None, first_tangent: Tangent | None = None
    ) -> None:
        """Solve with the preconditioner of the last solve, if it lasts."""
        self._problem.solve(reference=reference, first_tangent=first_tangent, renew=False)

    def _restore(self) -> None:
        """Go back to the last equilibrium."""
        self._set_values(self._past[-1].values)
        self._set_load(self._past[-1].load)

    def _shorten(self, increment: float, error: ConvergenceError) -> None:
        """Halve the increment, down to the least."""
        load = self._past[-1].load
        if increment <= self._steps.least + LOAD_ROUNDING * abs(load):
            raise ConvergenceError(
                f"No equilibrium was found beyond a load of {load:g}: an increment "
                f"of {increment:g} failed too, and {self._steps.least:g} is the least allowed. "
                f"{error} Allow smaller increments, or refine the mesh."
            ) from error
        self._increment = max(increment / 2, self._steps.least)

    def _values(self) -> list[Array]:
        return [f.x.array.copy() for f in self._state]

    def _set_values(self, values: list[Array]) -> None:
        for f, array in zip(self._state, values, strict=True):
            f.x.array[:] = array


def extrapolate(past: Sequence[_Equilibrium], load: float) -> list[Array]:
    """Extend the polynomial through equilibria to another load."""
    weights = []
    for i, here in enumerate(past):
        others = [other.load for j, other in enumerate(past) if j != i]
        weights.append(math.prod((load - t) / (here.load - t) for t in others))
    columns = zip(*(equilibrium.values for equilibrium in past), strict=True)
    return [sum(w * array for w, array in zip(weights, arrays, strict=True)) for arrays in columns]
