# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Time steps: the motion of a problem with inertia, in steps that are fixed or adapted.

A step that fails, or whose estimated error e is above the tolerance, is tried again from the last
state with a shorter one. After a good one of length Δt, the present length L becomes

.. math:: L ← \min(\max(L, g\, Δt),\ Δt\, \max(½,\ 0.9\, (\mathrm{tol}/e)^{1/3})),

g being the most that it may grow by, up to the longest; Δt < L where a target is to be met. The
balance of energies is

.. math:: T_{n+1} - T_n + Π_{n+1} - Π_n + D = W + O(Δt^3), \qquad
          W = ½\, (f_n + f_{n+1}) · (u_{n+1} - u_n),

with kinetic energy T, stored energy Π, external forces f, and D, the work on dashpots, like W.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.fem.assembly import assemble_owned
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.motion import Motion, fixed_dofs, motions_in
from dolfinx_feti.loading.state import PathState
from dolfinx_feti.loading.stepper import Stepper, check_places
from dolfinx_feti.loading.steps import Lengths, LoadStep
from dolfinx_feti.mechanics.values import require_positive, require_within
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all

__all__ = ["TimeStep", "TimeSteps", "follow_time"]


#: Share of the length that the error estimate asks for, and the least of the last one.
SAFETY, SHORTEST = 0.9, 0.5


@dataclass(frozen=True, slots=True)
class TimeSteps(Lengths):
    """How to choose the lengths of time steps [s].

    Attributes:
        longest: The longest [s]; the first one if not given.
        tolerance: Most that the estimated error of the displacement may be in a step [mm]; if not
            given, steps are as long as the first one unless they fail.
    """

    longest: float | None = None
    tolerance: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        Lengths.__post_init__(self)
        remedy = f"a number not below first={self.first}"
        require_within(self.first, math.inf, {"longest": self.most}, remedy=remedy)
        if self.tolerance is not None:
            require_positive(tolerance=self.tolerance)

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
        dissipated: Work on dashpots, and on all else in the forms that resists the rate.
        error: Estimated error of the displacement.
    """

    kinetic: float
    stored: float
    work: float
    dissipated: float
    error: float


def follow_time(
    problem: NonlinearProblem,
    motion: Motion,
    set_time: Callable[[float], object],
    targets: Sequence[float],
    steps: TimeSteps,
    *,
    state: Sequence[dolfinx.fem.Function] = (),
    start: float = 0.0,
    energy: ufl.Form | None = None,
    forces: ufl.Form | None = None,
    on_step: Callable[[TimeStep], object] | None = None,
    checkpoint: Checkpoint | None = None,
    unit: str = "s",
) -> list[TimeStep]:
    """Follow the motion from one time through others to the last. Collective.

    It begins with the present displacement and ``motion.velocity``; the acceleration follows. What
    is not said here is as in :func:`~dolfinx_feti.loading.load_steps.follow_load`.

    Args:
        problem: The nonlinear problem, with the inertia of ``motion`` in its forms.
        motion: Its motion.
        set_time: Sets loads and conditions to those of a time. At first it is called for times in
            the first step, too: dofs under conditions begin with the velocity of their values.
        targets: Times to be met exactly, ascending.
        steps: How to choose the lengths of the steps.
        state: Functions that a solve changes beside u and what is condensed.
        start: The present time.
        energy: What the material stores, for the balance kinetic + stored + dissipated − work of
            each step.
        forces: External forces, tested with v, for the same: their work is integrated by the
            trapezoidal rule.
        on_step: Called at the end of each step.
        checkpoint: Where each new state is kept.
        unit: Name of the unit of time.

    Returns:
        The accepted steps, those before a restart included.

    Raises:
        ValueError: Times do not ascend, or the forms do not hold the inertia of the motion, or a
            dashpot cannot follow it.
        ConvergenceError: No step of the least length leads on; the state is that of its beginning.
    """

    def check() -> None:
        check_places(start, targets, unloading=False)
        if any(target < start for target in targets):
            raise ValueError(
                f"start={start}, targets={list(targets)}: times ascend from the start."
            )
        if motion.u is not problem.u or motions_in(problem.content.coefficients) != [motion]:
            raise ValueError(
                "The forms of the problem do not hold the inertia of this Motion, or not of it "
                "alone: add motion.inertia to the energy, or its derivative to the residual."
            )
        motion.drive(problem.content.coefficients)

    on_all(check, problem.u.function_space.mesh.comm)
    histories = [*problem.internal_variables, *motion.changes]
    owned = PathState(start, problem.content, state, histories, motion.numbers)
    return _Times(problem, set_time, steps, owned, motion, (energy, forces)).follow(
        targets, on_step=on_step, checkpoint=checkpoint, unit=unit
    )


class _Times(Stepper):
    """States of a motion; its velocity and accelerations lead to the next one."""

    kind = TimeStep
    name, missed = "follow_time", "The motion was not found beyond the time"
    remedy = "Allow shorter steps, or a larger tolerance."

    def __init__(
        self,
        problem: NonlinearProblem,
        set_time: Callable[[float], object],
        steps: TimeSteps,
        state: PathState,
        motion: Motion,
        energy_and_forces: tuple[ufl.Form | None, ufl.Form | None],
    ) -> None:
        super().__init__(problem, set_time, steps, state)
        self._steps = steps
        given = (*energy_and_forces, motion.damping_form(problem.content.forms[0]))
        self._energy, self._external, self._damping = (
            None if f is None or f.empty() else Compiler(self._comm).form(f) for f in given
        )
        self._motion, self._balance = motion, (problem.F, list(problem.bcs))

    def _is_met(self, target: float) -> bool:
        return self.at >= target

    def _begin(self, targets: Sequence[float], *, restarted: bool) -> None:
        """Find the initial acceleration."""
        if restarted or not targets:
            self._motion.hold()
        else:
            self._move_conditions(min(self._length, targets[0] - self.at))
            self._set_place(self.at)
            self._motion.start(*self._balance)
        self._forces = self._present_forces()

    def _present_forces(self) -> Array:
        """Return external forces, NaN if they are not given, and those of dashpots, (2, owned)."""
        damping, given = self._motion.damping(self._damping), self._external
        external = np.full_like(damping, math.nan) if given is None else assemble_owned(given)
        return np.stack([external, damping])

    def _move_conditions(self, dt: float) -> None:
        """Let dofs under conditions begin as their values do, by differences in a step Δt."""
        if dt <= 0.0:
            return
        g0, g1, g2 = (self._problem.u.x.array.copy() for _ in range(3))
        for place, values in ((self.at, g0), (self.at + dt / 2.0, g1), (self.at + dt, g2)):
            self._set_place(place)
            for bc in self._balance[1]:
                bc.set(values)
        fixed = fixed_dofs(self._balance[1])
        v, ü = self._motion.velocity.x.array, self._motion.acceleration.x.array
        v[fixed] = ((4.0 * g1 - 3.0 * g0 - g2) / dt)[fixed]
        ü[fixed] = (4.0 * (g0 - 2.0 * g1 + g2) / dt**2)[fixed]

    def _restored(self) -> None:
        """Let inertia and rates be those of the state."""
        self._motion.hold()

    def _arrive(self, step: dict[str, Any]) -> TimeStep:
        """Go from the balance of forces to the end of the step."""
        error, moved = self._motion.error(), self._motion.leave()
        self._lengthen(step["increment"], error)
        before, self._forces = self._forces, self._present_forces()
        W = (before + self._forces) @ moved[: before.shape[1]] / 2.0  # ½ (f_n + f_{n+1})·Δu
        mine = math.nan if self._energy is None else dolfinx.fem.assemble_scalar(self._energy)
        work, dissipated, stored = map(float, self._comm.allreduce(np.array([*W, mine])))
        kinetic = self._motion.kinetic_energy()
        return TimeStep(
            **step, kinetic=kinetic, stored=stored, work=work, dissipated=dissipated, error=error
        )

    def _attempt(self, to: float, target: float) -> None:
        """Balance the forces of a step, whose estimated error must not be too large."""
        dt = to - self.at
        self._motion.enter(dt)
        self._set_place(to)
        reference = self._problem.residual_norm()
        self._motion.predict()
        self._problem.solve(reference=reference, renew=False)
        error, most = self._motion.error(), self._steps.tolerance
        if most is not None and error > most:
            raise ConvergenceError(
                f"A step of {dt:g} has an estimated error of {error:.1e} in the displacement, "
                f"and {most:g} is allowed."
            )

    def _lengthen(self, dt: float, error: float) -> None:
        """Choose the next length."""
        length, most = max(self._length, self._steps.growth * dt), self._steps.tolerance
        if most is not None and error > 0.0:
            length = min(length, dt * max(SHORTEST, SAFETY * (most / error) ** (1.0 / 3.0)))
        self._length = max(min(self._steps.most, length), self._steps.least)
