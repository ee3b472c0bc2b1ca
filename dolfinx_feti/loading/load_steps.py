# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Load steps: from equilibrium to equilibrium, to the wanted loads (docs/load_steps.md).

The first steps begin with the tangent of the last equilibrium and the residual of the new load,
:math:`K'(U_n; t_n)\, ΔU = -r(U_n; t_{n+1})` (eq. 25 of the paper). Once three equilibria are known,
the parabola through them predicts the next one. If the prediction turns a cell inside out, or has
an indefinite tangent and a larger residual than the last equilibrium, the step begins with the
tangent of the last equilibrium again.

Newton's tolerance refers to :math:`\|r(U_n; t_{n+1})\|`, because the residual of a prediction can
be larger by orders of magnitude. FETI's preconditioner is reused from one load to the next. After a
checkpoint is written it is discarded: a restart does not have it, and has to take the same steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from numbers import Real

import dolfinx

from dolfinx_feti.errors import (
    ConvergenceError,
    InadmissibleStartError,
    IndefiniteTangentError,
    LinearSolverError,
    ToolCrossedError,
)
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.loading.checkpoint import Checkpoint
from dolfinx_feti.loading.dashpots import LastDisplacements
from dolfinx_feti.loading.load_step import LoadStep
from dolfinx_feti.loading.motion import stop_motions
from dolfinx_feti.loading.places import check_places
from dolfinx_feti.loading.problem import Problem
from dolfinx_feti.loading.state import PathState
from dolfinx_feti.loading.stepper import Stepper
from dolfinx_feti.loading.steps import Steps
from dolfinx_feti.loading.tolerances import loose_tolerances
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.values import require_sequence, require_type

__all__ = ["follow_load"]

#: Remedy if the tangent is indefinite, however short the step.
LIMIT_POINT = (
    "The tangent is indefinite there, as beyond a limit point of the load. If the least increment "
    "is small already, prescribe a displacement or a volume in place of the load; else allow "
    "smaller increments by Steps(least=…), and check the units of the load."
)

#: Remedy after other failures at the least increment.
SMALLER_INCREMENTS = (
    "Allow smaller increments by Steps(least=…), check the units of the load, or refine the mesh."
)

#: Errors whose messages name their remedy themselves.
WITH_REMEDY = (LinearSolverError, ToolCrossedError)

#: Degree of the polynomial that predicts the next equilibrium: a parabola.
PREDICTION_DEGREE = 2


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

    A :class:`~dolfinx_feti.loading.motion.Motion` in the forms is stopped: inertia and velocities
    are zero on the path.

    Example::

        problem = NonlinearProblem(energy, u, bcs=bcs)
        steps = Steps(first=0.1, least=0.01)
        follow_load(problem, set_load, [0.2, 0.5], steps, unit="kPa")

    Args:
        problem: The nonlinear problem, in equilibrium at the load ``start``.
        set_load: Sets the load in the user's forms.
        targets: Loads to be met exactly, one after the other. A target that differs from the load
            before it by rounding alone, as 3 * 0.1 from 0.3, takes no step.
        steps: How to choose the increments.
        state: Further Functions that a solve changes, such as one that ``before_assembly``
            computes. They are predicted by a parabola, restored after a failure, and written to
            the checkpoint, like those that the path finds in the problem and that need not be
            listed: u, condensed fields, internal variables, last displacements of dashpots.
        start: The present load.
        unloading: Whether the load may turn back on its way through the targets.
        on_step: Called in each new equilibrium on all processes, for output; the order of events is
            that of :mod:`~dolfinx_feti.loading.stepper`.
        checkpoint: Where each new equilibrium is written, after ``on_step`` is called. If it was
            opened to restart, its state replaces the present one and ``start``, and targets that
            were met before are skipped.
        unit: Name of the load's unit, for the progress bar on a terminal and for the line that each
            step writes to the log (logger ``dolfinx_feti``, level ``INFO``).

    Returns:
        The accepted steps, those before a restart included.

    Raises:
        TypeError: An argument has a wrong type.
        ValueError: A load is not a finite number, the load turns back although ``unloading`` is
            False, or a checkpoint is one of another problem.
        OSError: A checkpoint cannot be written; state and load are those of the last equilibrium.
        ConvergenceError: A step of the least increment failed; state and load are those of the last
            equilibrium.
        BaseException: Errors of ``set_load`` or ``on_step``, on all processes if on one;
            KeyboardInterrupt or SystemExit after Ctrl-C or SIGTERM. The state is the last accepted
            one.
    """
    if not isinstance(problem, Problem):
        raise TypeError(f"problem is {problem!r}: give a NonlinearProblem.")
    require_type(Steps, steps=steps)
    require_sequence(Real, targets=targets)
    require_sequence(dolfinx.fem.Function, state=state)
    require_type((Checkpoint, type(None)), checkpoint=checkpoint)
    comm = problem.unknown.function_space.mesh.comm
    on_all(partial(check_places, start, targets, steps.least, unloading=unloading), comm)
    stepper = _LoadStepper(problem, set_load, steps, state, start)
    return stepper.follow(targets, on_step=on_step, checkpoint=checkpoint, unit=unit)


class _LoadStepper(Stepper[LoadStep]):
    """Steps between equilibria, which the parabola through the last three predicts."""

    def __init__(
        self,
        problem: Problem,
        set_load: Callable[[float], object],
        steps: Steps,
        unknowns: Sequence[dolfinx.fem.Function],
        start: float,
    ) -> None:
        """Create the stepper in an equilibrium; see :func:`follow_load`. Collective."""
        constants = problem.content.constants
        stop_motions(constants)
        comm = problem.unknown.function_space.mesh.comm
        # with dolfinx's compiler options: interpolated once a step, if at all
        self._last_displacements = LastDisplacements(constants, Compiler(comm))
        histories = [*problem.internal_variables, *self._last_displacements.functions]
        state = PathState(start, problem.content, unknowns, histories, n_earlier=PREDICTION_DEGREE)
        super().__init__(
            problem,
            set_load,
            steps.length_rule(),
            state,
            step_type=LoadStep,
            function_name="follow_load",
            failure="No equilibrium was found beyond a load of",
            quantity="load",
        )
        self._steps = steps

    def _begin(self, targets: Sequence[float], *, is_restarted: bool) -> None:
        """Set the last displacements of dashpots, unless a restart has read them. Collective."""
        if not is_restarted:
            self._last_displacements.advance()

    def _advance(self) -> None:
        """Set the last displacements of dashpots to the present ones. Collective."""
        self._last_displacements.advance()

    def _remedy(self, error: ConvergenceError) -> str:
        """Return the remedy at the least increment; empty if the error names it itself."""
        if isinstance(error, WITH_REMEDY):
            return ""
        was_indefinite = any(step.indefinite for step in self._problem.history)
        if was_indefinite or isinstance(error, IndefiniteTangentError):
            return LIMIT_POINT
        return SMALLER_INCREMENTS

    def _is_met(self, target: float) -> bool:
        """Return True if the last equilibrium is at a target: steps lead to it exactly."""
        return self.at == target

    def _has_loose_tolerance(self, to: float, target: float) -> bool:
        """Return True on the way to a target if ``Steps.rtol`` is given."""
        return to != target and self._steps.rtol is not None

    def _complete(self, step: LoadStep) -> LoadStep:
        """Return the step as it is: an equilibrium needs no completion."""
        return step

    def _attempt(self, to: float, target: float) -> None:
        """Solve from a prediction, or else with the tangent of the last equilibrium. Collective."""
        rtol = 0.0  # leaves the solver's own tolerance
        linear_rtol = 0.0
        if to != target:
            rtol = self._steps.rtol or 0.0
            linear_rtol = self._steps.linear_rtol or 0.0
        with loose_tolerances(self._problem.solver, rtol=rtol, linear_rtol=linear_rtol):
            if self.state.can_extrapolate() and self._solve_from_prediction(to):
                return
            tangent = self._problem.linearise()  # before the load grows: K'(U_n; t_n)
            self._set_place(to)
            self._problem.solve(
                first_tangent=tangent,
                renew=False,
                give_up_early=self._can_shorten(to),
                check_cells=False,
            )

    def _solve_from_prediction(self, to: float) -> bool:
        """Solve from the parabola through the last equilibria. Collective.

        Returns:
            False if the prediction is not admissible; the state is the last equilibrium then.

        Raises:
            ConvergenceError: The solve failed for another reason.
        """
        self._set_place(to)
        reference = self._problem.residual_norm()
        self.state.extrapolate(to)
        try:
            self._problem.solve(
                reference=reference,
                renew=False,
                give_up_early=self._can_shorten(to),
                check_cells=False,
            )
        except InadmissibleStartError:
            self._set_place(self.at)
            self._restore()
            return False
        return True

    def _can_shorten(self, to: float) -> bool:
        """Return True if a failed step to a load can be repeated with a smaller increment."""
        return not self.length_rule.is_least(abs(to - self.at), self.at)
