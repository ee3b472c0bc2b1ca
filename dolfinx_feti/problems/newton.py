# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Newton's method as a PETSc SNES, every step solved by FETI (docs/theory.md).

.. math:: K'(U^k)\, ΔU = \mathcal F - K(U^k), \qquad U^{k+1} = U^k + α\, ΔU

(eq. 22, Augustin_eq:NewtonRecursion, and eq. 23, Augustin_eq:NewtonRecursion_h), with ΔU of
``direction`` and α of ``line_search``, until ‖r‖ of the free dofs is small beside
:math:`\max(\min(‖r^0‖, \text{reference}), ‖R‖/10)` with the reactions R, or is rounding.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.diagnosis.advice import Advice
from dolfinx_feti.feti.solver import DOUBTFUL
from dolfinx_feti.problems.derivative import difference_from_derivative
from dolfinx_feti.problems.direction import Directions
from dolfinx_feti.problems.history import (
    CLOSER,
    CRAWLING,
    FAILURES,
    NewtonStep,
    Stop,
    crawls,
    is_slow,
    share_left,
)
from dolfinx_feti.problems.line_search import line_search
from dolfinx_feti.problems.solvers import RTOL, no_closer_than
from dolfinx_feti.problems.system import Residual, System, Tangent
from dolfinx_feti.runtime.collective import on_all, warn
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.petsc_errors import python_errors

Reason = PETSc.SNES.ConvergedReason

#: Share of the residual that Newton's method aims at which a linear solve may leave.
LEFT = 0.1

#: Share of the reactions that counts as the load of a solve at least.
LEAST_REACTION = 0.1

#: Over so many states the highest potential has to fall.
MEMORY = 8

#: What of its first residual a rough solve leaves.
ROUGH = 0.1

#: How a solve ends that does not get closer, perhaps for a tangent that is not the derivative.
NOT_CLOSER = (Reason.DIVERGED_MAX_IT, Reason.DIVERGED_LINE_SEARCH)

NO_DERIVATIVE = "J is not the derivative of F along the last step"

_DOUBTFUL = (
    "Newton's method ends where all of the residual is rounding, with {0:.0e} of a load of "
    "{1:.0e}: if the load has changed, the equilibrium is doubtful. Load in larger steps, or "
    "lower a penalty such as κ and let an augmented Lagrangian make up for it."
)


@dataclass(frozen=True, slots=True)
class Start:
    """What Newton's method begins with, beside the state itself."""

    reference: float = np.inf  # most that the first residual counts in the relative tolerance
    tangent: Tangent | None = None  # of the first step, which the matrix holds; that of the start
    rough: bool = False  # end at a tenth of the first residual; linear solves aim at the end still
    early: bool = False  # give up early: the caller has another start, or a shorter way


class Newton:
    """Context of a SNES that drives a ``System`` with a FETI KSP.

    Attributes:
        start: What the next solve begins with: PETSc hands nothing on.
        history: A record for each step of the last solve.
        message: What went wrong in it and what helps, or an empty string.
        residual: ``Residual.equations`` of its last iterate, (owned,).
        at_end: Whether that is within the SNES's own tolerances, also after a rough solve.
        mismatch: How the tangent is not the derivative, once a solve has found that; else None.
    """

    def __init__(self, system: System) -> None:
        """Take the system; the state stays in the user's functions."""
        self._system, self.start = system, Start()
        self.history: list[NewtonStep] = []
        self.message, self.at_end = "", False
        self.residual, self._du = np.zeros(system.owned), np.zeros(system.owned)
        self.mismatch: Advice | None = None

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, x: PETSc.Vec) -> None:
        """Iterate from the state of the user's functions until the residual is small."""
        system, start, self.start = self._system, self.start, Start()
        self._early, self._heights = start.early, [np.nan]  # Π of the last states
        self.history, self.message = [], ""
        self._compared = self.mismatch is not None
        try:
            reason = self._iterate(snes, start)
        except Stop as stop:
            failure, *detail = stop.args
            reason, text = FAILURES[failure]
            self.message = text.format(CLOSER[system.is_displacement], *detail)
            if reason in NOT_CLOSER and self.history and not self._compared:
                system.linearise()
                self._compare(system.residual())
            if reason in NOT_CLOSER and self.mismatch is not None:
                self.message = f"{self.message.partition(':')[0]}: {NO_DERIVATIVE}: {self.mismatch}"
        snes.setConvergedReason(reason)
        x.array[:] = system.state()[0]

    def _iterate(self, snes: PETSc.SNES, start: Start) -> int:
        """Take steps until the residual is small; return PETSc's reason for that."""
        system, self._started = self._system, time.perf_counter()
        rtol, atol, *_ = snes.getTolerances()
        here = system.residual()
        self.residual = here.equations
        first = norm = system.norm(here.condensed)
        if system.least_volume_ratio() <= 0.0:
            raise Stop("inverted")
        load, moved = float(np.fmin(first, start.reference)), system.boundary_moves(here)
        self._directions = Directions(
            system,
            moved=moved,
            refuse=start.early and start.tangent is None and first > start.reference,
            guess=bool(np.isfinite(start.reference)),
            shortens=start.early,
        )
        at_most = LEAST_REACTION * (1.0 if moved or rtol <= RTOL else RTOL / rtol)
        while True:
            moves = system.boundary_moves(here)
            scale = max(load, at_most * system.reaction(here))
            rough = ROUGH * (scale if moved else first) if start.rough else 0.0
            reason = self._judge(snes, norm, scale, rough, moves=moves)
            if reason != Reason.ITERATING:
                return reason
            aim, share = max(rtol * scale, atol), share_left(self.history, norm)
            fresh = bool(self.history) and self.history[-1].tangent_lag == 0
            kept = not moves and fresh and norm * share <= aim  # leads to the end, if as good again
            if not kept and (self.history or start.tangent is None):
                with event("FETITangent"):
                    system.linearise(here)
            floor = system.rounding()
            if not moves and norm <= (floor if self.history else system.least_rounding()):
                self.at_end = True
                force, known = system.norm(system.free(here.force)), scale if moved else load
                if self.history and force > DOUBTFUL * known:
                    warn(_DOUBTFUL.format(force, known), system.comm)
                return Reason.CONVERGED_FNORM_ABS
            if not kept and not self._compared and is_slow(self.history, norm):
                self._compare(here)
            with no_closer_than(LEFT * aim, snes.getKSP()):
                here = self._step(snes.getKSP(), here, norm, floor, kept=kept, moves=moves)
            self.residual = here.equations
            norm = system.norm(here.condensed)
            if start.early and crawls(self.history):
                raise Stop("crawls", CRAWLING)

    def _judge(
        self, snes: PETSc.SNES, norm: float, scale: float, rough: float, *, moves: bool
    ) -> int:
        """Monitor ‖r‖, relative to a force ``scale``; return whether to go on, or why to end."""
        rtol, atol, _, max_it = snes.getTolerances()
        its = len(self.history)
        snes.setIterationNumber(its)
        snes.setFunctionNorm(norm)
        snes.logConvergenceHistory(norm, snes.getKSP().getIterationNumber())

        def monitor() -> None:
            with python_errors():  # it may be the user's own
                snes.monitor(its, norm)

        on_all(monitor, self._system.comm)
        if not np.isfinite(norm):
            raise Stop("not a number")
        self.at_end = not moves and norm <= max(atol, rtol * scale)
        if self.at_end and norm <= atol:
            return Reason.CONVERGED_FNORM_ABS
        if self.at_end or (not moves and norm <= rough):
            return Reason.CONVERGED_FNORM_RELATIVE
        if its >= max_it:
            raise Stop("too many", max_it)
        return Reason.ITERATING

    def _step(
        self, ksp: PETSc.KSP, here: Residual, norm: float, floor: float, *, kept: bool, moves: bool
    ) -> Residual:
        """Take a step, with a larger shift where no step length is admissible, and record it.

        The matrix holds its tangent, perhaps kept from the step before. Below the floor of rounding
        no step length has to be admissible. It returns the residual where the step ends.
        """
        system = self._system
        seen = system.seen_by_tangent(here) if kept else here
        directions = self._directions.along(ksp, seen, moves=moves)
        while True:
            assembled = time.perf_counter()
            found = next(directions)
            solved = time.perf_counter()
            height = self._heights[-1]
            end = line_search(
                system,
                seen,
                found.du,
                shifted=found.shift > 0.0,
                potential=height if system.has_potential and not found.plain else None,
                highest=float(np.fmax.reduce(self._heights)),
                early=self._early,
            )
            self._heights = [*self._heights[1 - MEMORY :], end.potential]
            step = NewtonStep.after(
                ksp.getPythonContext(),
                found.iterations,
                residual=norm,
                step_length=end.alpha,
                indefinite=found.indefinite,
                shift=found.shift,
                seconds_assembly=assembled - self._started,
                seconds_linear=solved - assembled,
                floor=floor,
                tangent_lag=self.history[-1].tangent_lag + 1 if kept else 0,
            )
            self.history.append(step)
            self._du, self._started = found.du, solved
            if end.alpha > 0.0 or norm <= floor or kept:
                return end.residual if end.alpha > 0.0 else here

    def _compare(self, here: Residual) -> None:
        """Compare the tangent with the derivative along the last ΔU, once in a solve, and tell."""
        self._compared = True
        self.mismatch = difference_from_derivative(self._system, here, self._du)
        if self.mismatch is not None:
            warn(f"{NO_DERIVATIVE}: {self.mismatch}", self._system.comm)
