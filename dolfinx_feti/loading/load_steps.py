# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Load steps: from equilibrium to equilibrium, to the wanted loads (docs/load_steps.md).

The first steps begin with the tangent of the last equilibrium and the residual of the new load,
:math:`K'(U_n; t_n)\, ΔU = -r(U_n; t_{n+1})` (eq. 25, Augustin_eq:loadStepping). Once three
equilibria are known, a parabola through them predicts the next one; where it turns a cell inside
out, or has an indefinite tangent and a larger residual than the last equilibrium, the tangent of
that takes its place again.

Newton's tolerance refers to :math:`\|r(U_n; t_{n+1})\|`, as the residual of a prediction can be
larger by orders of magnitude. FETI's preconditioner serves on from one load to the next, but for
the step after a checkpoint: what a restart does not know, a run that goes on must not use.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from petsc4py import PETSc

import numpy as np

import dolfinx

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.motion import motions_in
from dolfinx_feti.loading.state import PathState
from dolfinx_feti.loading.stepper import ROUNDING, Problem, Stepper, check_places, loosened
from dolfinx_feti.loading.steps import LoadStep, Steps
from dolfinx_feti.mechanics.supports import DASHPOTS
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all

__all__ = ["follow_load"]

#: Why a solve ends that begins with a state that is not admissible.
INADMISSIBLE = PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN

#: What helps where the tangent turns indefinite, however short the step.
LIMIT_POINT = (
    "The tangent turns indefinite there, as at a limit point of the load: no equilibrium with a "
    "larger load is near. Prescribe a displacement or a volume in place of the load."
)


def follow_load(
    problem: Problem,
    set_load: Callable[[float], object],
    targets: Sequence[float],
    steps: Steps,
    *,
    state: Sequence[dolfinx.fem.Function] = (),
    start: float = 0.0,
    unloading: bool = False,
    on_step: Callable[[LoadStep], object] | None = None,
    checkpoint: Checkpoint | None = None,
    unit: str = "",
) -> list[LoadStep]:
    """Follow the equilibrium from one load through others to the last. Collective.

    Args:
        problem: The nonlinear problem, in equilibrium at the load ``start``.
        set_load: Sets the load in the user's forms.
        targets: Loads to be met exactly, one after the other.
        steps: How to choose the increments.
        state: Functions that a solve changes beside u and what is condensed: these are known, as
            are internal variables and dashpots, which advance by themselves after ``on_step``.
        start: The present load.
        unloading: Whether the load may turn back on its way through the targets.
        on_step: Called in each new equilibrium on all processes, for output; the order of events is
            that of :mod:`~dolfinx_feti.loading.stepper`.
        checkpoint: Where each new equilibrium is kept, after ``on_step`` is called. If it was
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
        BaseException: What ``set_load`` or ``on_step`` raise, on all processes if on one;
            KeyboardInterrupt or SystemExit after Ctrl-C or SIGTERM. The state is the last one.
    """
    comm = problem.u.function_space.mesh.comm
    on_all(lambda: check_places(start, targets, unloading=unloading), comm)
    return _Loads(problem, set_load, steps, state, start).follow(
        targets, on_step=on_step, checkpoint=checkpoint, unit=unit
    )


class _Loads(Stepper):
    """Equilibria; a parabola through the last three of them predicts the next one."""

    order = 2
    kind = LoadStep
    name, missed = "follow_load", "No equilibrium was found beyond a load of"
    remedy = "Allow smaller increments, or refine the mesh."

    def __init__(
        self,
        problem: Problem,
        set_load: Callable[[float], object],
        steps: Steps,
        unknowns: Sequence[dolfinx.fem.Function],
        start: float,
    ) -> None:
        self._dashpots = {
            last: dashpot.u
            for last in problem.content.coefficients
            for dashpot in DASHPOTS.get(last, ())
            if isinstance(dashpot.u, dolfinx.fem.Function)
        }
        histories = [*problem.internal_variables, *self._dashpots]
        state = PathState(start, problem.content, unknowns, histories)
        super().__init__(problem, set_load, steps, state)
        self._steps = steps

    def _begin(self, targets: Sequence[float], *, restarted: bool) -> None:
        """Let the state be one of rest."""
        for motion in motions_in(self._problem.content.coefficients):
            motion.stop()
        if not restarted:
            self._advance()

    def _advance(self) -> None:
        """Let dashpots take the present displacement for the last one."""
        for last, u in self._dashpots.items():
            last.x.array[:] = u.x.array

    def _remedy(self, error: ConvergenceError) -> str:
        """Say what helps: the linear solver says it itself; at a limit point no increment does."""
        if "the linear solver: " in str(error):
            return ""
        if "indefinite" in str(error) or any(step.indefinite for step in self._problem.history):
            return LIMIT_POINT
        return self.remedy

    def _is_met(self, target: float) -> bool:
        return self.at == target and (self._steps.rtol is None or self._met[-1] == target)

    def _arrive(self, step: dict[str, Any]) -> LoadStep:
        """Let the increment grow after a quick step."""
        found = LoadStep(**step)
        extra = max(len(self._problem.volume_changes) - 1, 0)  # a step for each multiplier
        tangents = sum(step.tangent_lag == 0 for step in found.history)
        if found.failures == 0 and tangents - extra <= self._steps.quick:
            self._length = max(self._length, self._steps.growth * abs(found.increment))
        return found

    def _attempt(self, to: float, target: float) -> None:
        """Solve from a prediction, or else with the tangent of the last equilibrium."""
        early = abs(to - self.at) > self._steps.least * (1.0 + ROUNDING)  # it can be shortened
        solve = partial(self._problem.solve, renew=False, give_up_early=early)
        rough = (self._steps.rtol, self._steps.linear_rtol) if to != target else (None, None)
        rtol, linear_rtol = (tolerance or 0.0 for tolerance in rough)
        with loosened(self._problem.solver, rtol=rtol, linear_rtol=linear_rtol):
            if len(self._past) > self.order:
                self._set_place(to)
                reference = self._problem.residual_norm()
                self.state.set(self._predicted(to))
                try:
                    solve(reference=reference)
                    return
                except ConvergenceError:
                    if self._problem.solver.getConvergedReason() != INADMISSIBLE:
                        raise
                self._set_place(self.at)
                self._back()
            tangent = self._problem.linearise()
            self._set_place(to)
            solve(first_tangent=tangent)

    def _predicted(self, load: float) -> list[Array]:
        """Extend the polynomial through the unknowns of equilibria to another load."""
        t = np.array([place.at for place in self._past])
        rest = [np.delete(t, i) for i in range(len(t))]
        w = [np.prod((load - s) / (here - s)) for here, s in zip(t, rest, strict=True)]
        columns = zip(*map(self.state.unknowns, self._past), strict=True)
        return [sum(a * array for a, array in zip(w, arrays, strict=True)) for arrays in columns]
