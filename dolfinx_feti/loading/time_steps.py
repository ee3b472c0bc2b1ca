# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Time steps: the motion of a problem with inertia, in steps that are fixed or adapted.

A step that fails, or whose estimated error is above the tolerance, is repeated from the last state
with half its length. The rule for the lengths is ``ErrorControl`` (``step_length``). The balance of
energies is

.. math:: T_{n+1} - T_n + Π_{n+1} - Π_n + D = W + O(Δt^3), \qquad
          W = ½\, (f_n + f_{n+1}) · (u_{n+1} - u_n),

with kinetic energy T, stored energy Π, external forces f, and the work D on dashpots, which is
integrated like W.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from numbers import Real
from typing import NamedTuple

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.fem.assembly import assemble_owned
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.load_step import LoadStep
from dolfinx_feti.loading.motion import Motion, dirichlet_dofs
from dolfinx_feti.loading.places import check_places
from dolfinx_feti.loading.state import PathState
from dolfinx_feti.loading.stepper import Stepper
from dolfinx_feti.loading.steps import TimeSteps
from dolfinx_feti.loading.time_step import TimeStep
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.values import require_sequence, require_type

__all__ = ["follow_time"]


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

    It begins with the present displacement and ``motion.velocity``; the acceleration follows from
    the balance of forces. Arguments have the same meaning as those of this name in
    :func:`~dolfinx_feti.loading.load_steps.follow_load`.

    Args:
        problem: The nonlinear problem, with the inertia of ``motion`` in its forms.
        motion: Its motion.
        set_time: Sets loads and the values of the conditions to those of a time. The conditions
            themselves, ``problem.bcs``, stay those of the beginning. At the beginning it is also
            called for times in the first step, for the initial velocity of Dirichlet dofs.
        targets: Times to be met exactly, ascending.
        steps: How to choose the lengths of the steps.
        state: Further Functions that a solve changes; u, condensed fields, internal variables and
            the Functions of the motion need not be listed.
        start: The present time.
        energy: Energy of the material, for the balance of each step, kinetic + stored +
            dissipated − work.
        forces: External forces, tested with v, for the same balance; their work is integrated by
            the trapezoidal rule.
        on_step: Called at the end of each step on all processes; the order of events is that of
            :mod:`~dolfinx_feti.loading.stepper`.
        checkpoint: Where each new state is written.
        unit: Name of the unit of time.

    Returns:
        The accepted steps, those before a restart included.

    Raises:
        TypeError: An argument has a wrong type.
        ValueError: Times do not ascend, or the forms do not hold the inertia of the motion, or a
            dashpot cannot follow it.
        ConvergenceError: A step of the least length failed; the state is that of its beginning.
    """
    require_type(NonlinearProblem, problem=problem)
    require_type(Motion, motion=motion)
    require_type(TimeSteps, steps=steps)
    require_sequence(Real, targets=targets)
    require_sequence(dolfinx.fem.Function, state=state)
    require_type((Checkpoint, type(None)), checkpoint=checkpoint)

    constants = problem.content.constants

    def check() -> None:
        check_places(start, targets, steps.least, unloading=False, quantity="time")
        if motion.u is not problem.unknown or not motion.is_only_inertia_in(constants):
            raise ValueError(
                "The forms of the problem do not hold the inertia of this Motion, or not of it "
                "alone: add motion.inertia to the energy, or its derivative to the residual."
            )

    comm = problem.unknown.function_space.mesh.comm
    on_all(check, comm)
    on_all(lambda: motion.attach_dashpots(constants), comm)  # motion.constants has their time steps
    histories = [*problem.internal_variables, *motion.histories]
    path_state = PathState(start, problem.content, state, histories, motion.constants)
    stepper = _TimeStepper(
        problem, set_time, steps, path_state, motion, energy=energy, forces=forces
    )
    return stepper.follow(targets, on_step=on_step, checkpoint=checkpoint, unit=unit)


class PathForces(NamedTuple):
    """Forces that do work along a motion."""

    external: Array  # (owned,); NaN if the user gives none
    damping: Array  # of dashpots, and all else that depends on the velocity, (owned,)


class _TimeStepper(Stepper[TimeStep]):
    """Steps between states of a motion, which its velocity and accelerations predict."""

    def __init__(
        self,
        problem: NonlinearProblem,
        set_time: Callable[[float], object],
        steps: TimeSteps,
        state: PathState,
        motion: Motion,
        *,
        energy: ufl.Form | None,
        forces: ufl.Form | None,
    ) -> None:
        """Create the stepper in the present state; see :func:`follow_time`. Collective."""
        super().__init__(
            problem,
            set_time,
            steps.length_rule(),
            state,
            step_type=TimeStep,
            function_name="follow_time",
            failure="The motion was not found beyond the time",
            quantity="time",
        )
        self._steps = steps
        self._motion = motion
        self._residual = problem.F
        self._bcs = list(problem.bcs)  # whose values set_time may change
        self._energy = self._compile(energy)
        self._external = self._compile(forces)
        self._damping = self._compile(motion.damping_form(problem.content.forms[0]))
        self._forces = PathForces(np.zeros(0), np.zeros(0))  # of the last state; set by _begin

    def _compile(self, form: ufl.Form | None) -> dolfinx.fem.Form | None:
        """Return a compiled form; None for a form that is missing or empty. Collective.

        It is compiled with dolfinx's options, not with the problem's: it is assembled once a step.
        """
        if form is None or form.empty():
            return None
        return Compiler(self._comm).form(form)

    def _is_met(self, target: float) -> bool:
        """Return True if the last state is at a target or after it."""
        return self.at >= target

    def _remedy(self, error: ConvergenceError) -> str:
        """Return the remedy after a failure at the least length."""
        return "Allow shorter steps by TimeSteps(least=…), or a larger tolerance."

    def _begin(self, targets: Sequence[float], *, is_restarted: bool) -> None:
        """Compute the initial acceleration, unless a restart has read it. Collective."""
        if is_restarted or not targets:
            self._motion.set_to_last_state()
        else:
            self._start_conditions(min(self.length_rule.present, targets[0] - self.at))
            self._set_place(self.at)
            self._motion.balance(self._residual, self._bcs)
        self._forces = self._present_forces()

    def _present_forces(self) -> PathForces:
        """Assemble the forces of the present state. Collective."""
        damping = self._motion.damping(self._damping)
        if self._external is None:
            external = np.full_like(damping, math.nan)
        else:
            external = assemble_owned(self._external)
        return PathForces(external, damping)

    def _start_conditions(self, dt: float) -> None:
        """Set velocity and acceleration of Dirichlet dofs to those of their prescribed values.

        These are one-sided differences of the values g at the times t, t + Δt/2 and t + Δt:
        ġ = (4 g₁ − 3 g₀ − g₂)/Δt and g̈ = 4 (g₀ − 2 g₁ + g₂)/Δt².

        Args:
            dt: Length Δt of the first step [s].
        """
        if dt <= 0.0:
            return
        g0 = self._values_at(self.at)
        g1 = self._values_at(self.at + dt / 2.0)
        g2 = self._values_at(self.at + dt)  # last: it sets the length of the first step
        dofs = dirichlet_dofs(self._bcs)
        v = self._motion.velocity.x.array
        ü = self._motion.acceleration.x.array
        v[dofs] = ((4.0 * g1 - 3.0 * g0 - g2) / dt)[dofs]  # ġ
        ü[dofs] = (4.0 * (g0 - 2.0 * g1 + g2) / dt**2)[dofs]  # g̈

    def _values_at(self, t: float) -> Array:
        """Return u with the prescribed values at a time, with ghosts; that time is set. Collective.

        ``begin_step`` gives the scalars the time from now as the length of a step. Their forces at
        the beginning are balanced with the length that was set last.
        """
        self._set_place(t)
        values = self._problem.unknown.x.array.copy()
        for bc in self._bcs:
            bc.set(values)
        return values

    def _after_restore(self) -> None:
        """Set velocity and acceleration in the forms to those of the restored state."""
        self._motion.set_to_last_state()

    def _attempt(self, to: float, target: float) -> None:
        """Balance the forces at the end of a step, and check its estimated error. Collective."""
        dt = to - self.at
        self._motion.begin_step(dt)
        self._set_place(to)
        reference = self._problem.residual_norm()
        self._motion.predict()
        self._problem.solve(reference=reference, renew=False, check_cells=False)
        error = self._motion.error_of_step()
        tolerance = self._steps.tolerance
        if tolerance is not None and error > tolerance:
            raise ConvergenceError(
                f"A step of {dt:g} has an estimated error of {error:.1e} in the displacement, "
                f"and {tolerance:g} is allowed."
            )

    def _complete(self, step: LoadStep) -> TimeStep:
        """Compute velocity, acceleration and energies at the end of the step. Collective."""
        error = self._motion.error_of_step()
        du = self._motion.end_step()
        before = self._forces
        after = self._present_forces()
        self._forces = after
        du = du[: len(after.external)]
        work = (before.external + after.external) @ du / 2.0  # ½ (f_n + f_{n+1})·Δu
        dissipated = (before.damping + after.damping) @ du / 2.0
        stored = math.nan
        if self._energy is not None:
            stored = dolfinx.fem.assemble_scalar(self._energy)
        work, dissipated, stored = self._comm.allreduce(np.array([work, dissipated, stored]))
        attributes = {field.name: getattr(step, field.name) for field in fields(step)}
        return TimeStep(
            **attributes,
            kinetic=self._motion.kinetic_energy(),
            stored=float(stored),
            work=float(work),
            dissipated=float(dissipated),
            error=error,
        )
