# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Newton's method as a PETSc SNES, every step solved by FETI (docs/theory.md).

.. math:: (K'(U^k) + σ \operatorname{diag}|k|)\, ΔU = \mathcal F - K(U^k), \qquad
          U^{k+1} = U^k + α\, ΔU

(eq. 22, Augustin_eq:NewtonRecursion, and eq. 23, Augustin_eq:NewtonRecursion_h), with α of
``line_search``, until ‖r‖ of the free dofs is small beside
:math:`\max(\min(‖r^0‖, \text{reference}), ‖R‖/10)` with the reactions R, or is rounding. With a
potential the shift σ grows until no negative eigenvalue can be proved and ΔU leads downhill,
ΔU·r < 0. A singular tangent counts as indefinite.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.diagnosis.advice import Advice
from dolfinx_feti.feti.solver import DOUBTFUL, FETI
from dolfinx_feti.problems.derivative import difference_from_derivative
from dolfinx_feti.problems.history import CLOSER, FAILURES, NewtonStep, Stop, proved_negative
from dolfinx_feti.problems.line_search import line_search
from dolfinx_feti.problems.solvers import RTOL, no_closer_than
from dolfinx_feti.problems.system import Residual, System, Tangent
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all, warn
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.petsc_errors import python_errors

Reason, Linear = PETSc.SNES.ConvergedReason, PETSc.KSP.ConvergedReason

#: Share of the residual that Newton's method aims at which a linear solve may leave.
LEFT = 0.1

#: Share of the reactions that counts as the load of a solve at least.
LEAST_REACTION = 0.1

#: Over so many states the highest potential has to fall.
MEMORY = 8

#: What of its first residual a rough solve leaves.
ROUGH = 0.1

#: So many plain steps with an indefinite tangent may follow those that have moved the boundary.
PATIENCE = 3

#: Share of the residual down to which a linear solve that stagnates there leads on.
CLOSE = 1e-3

#: The shifts: none, others that grow, and the least of these that is tried without one before it.
SHIFTS, LEAST = (0.0, *(1e-4 * 4.0**k for k in range(-1, 8))), 2

#: So many steps, each of which leaves more than this share of the residual, are slow.
SLOW_STEPS, SLOW = 3, 0.03

#: So many steps, each shorter than this, crawl.
CRAWLING_STEPS, CRAWLING = 2, 0.1

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


@dataclass(frozen=True, slots=True)
class Direction:
    """Where a Newton step leads, and what that has cost (:class:`NewtonStep`)."""

    du: Array  # ΔU, (owned,)
    shift: float
    iterations: list[int]  # of each linear solve
    indefinite: int | None
    plain: bool  # may it lead anywhere, and not only down the potential?


class Newton:
    """Context of a SNES that drives a ``System``, whose state is the user's, with a FETI KSP.

    Attributes:
        start: What the next solve begins with: PETSc hands nothing on.
        history: A record for each step of the last solve.
        message: What went wrong in it and what helps, or an empty string.
        residual: ``Residual.equations`` of its last iterate, (owned,).
        at_end: Whether that is within the SNES's own tolerances, also after a rough solve.
        mismatch: How the tangent is not the derivative, once a solve has found that.
    """

    def __init__(self, system: System, mismatch: list[Advice]) -> None:
        self._system, self.start, self.mismatch = system, Start(), mismatch
        self.history: list[NewtonStep] = []
        self.message, self.at_end = "", False
        self.residual = self._du = np.zeros(system.owned)

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, x: PETSc.Vec) -> None:
        """Iterate from the state of the user's functions until the residual is small."""
        system, self._start, self.start = self._system, self.start, Start()
        self.history, self.message = [], ""
        self._compared = bool(self.mismatch)
        try:
            reason = self._iterate(snes, self._start)
        except Stop as stop:
            failure, *detail = stop.args
            reason, text = FAILURES[failure]
            self.message = text.format(CLOSER[system.is_displacement], *detail)
            if reason in NOT_CLOSER and self.history and not self._compared:
                system.linearise()
                self._compare(system.residual())
            if reason in NOT_CLOSER and self.mismatch:
                said = self.message.partition(":")[0]
                self.message = f"{said}: {NO_DERIVATIVE}: {self.mismatch[0]}"
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
        self._heights, self._level = [np.nan], 0  # Π of the last states if known, and of SHIFTS
        self._patience = PATIENCE if moved else 0
        self._refuse = start.early and start.tangent is None and first > start.reference
        at_most = LEAST_REACTION * (1.0 if moved or rtol <= RTOL else RTOL / rtol)
        while True:
            moves = system.boundary_moves(here)
            scale = max(load, at_most * system.reaction(here))
            rough = ROUGH * (scale if moved else first) if start.rough else 0.0
            reason = self._judge(snes, norm, scale, rough, moves=moves)
            if reason != Reason.ITERATING:
                return reason
            aim = max(rtol * scale, atol)
            next_norm = norm * self._share_left(norm)  # if the last tangent is as good again
            kept = not moves and next_norm <= aim
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
            if not kept and not self._compared and self._is_slow(norm):
                self._compare(here)
            with no_closer_than(LEFT * aim, snes.getKSP()):
                here = self._step(snes.getKSP(), here, norm, floor, kept=kept, moves=moves)
            self.residual = here.equations
            norm = system.norm(here.condensed)
            lengths = [step.step_length for step in self.history[-CRAWLING_STEPS:]]
            if start.early and len(lengths) == CRAWLING_STEPS and max(lengths) < CRAWLING:
                raise Stop("crawls", CRAWLING)

    def _share_left(self, norm: float) -> float:
        """Return the share of ‖r‖ that a whole step with a tangent of its own left; or infinity."""
        last = self.history[-1] if self.history else None
        if last is None or last.step_length != 1.0 or last.shift or last.tangent_lag:
            return np.inf
        return norm / last.residual if last.residual > 0.0 else np.inf

    def _is_slow(self, norm: float) -> bool:
        """Tell whether each of the last steps has left much of the residual, now ‖r‖."""
        norms = np.array([*(step.residual for step in self.history[-SLOW_STEPS:]), norm])
        before, after = norms[:-1], norms[1:]
        return len(after) == SLOW_STEPS and bool(np.all((SLOW * before < after) & (after < before)))

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
        directions = self._directions(ksp, seen, moves=moves)
        while True:
            assembled = time.perf_counter()
            found = next(directions)
            solved = time.perf_counter()
            heights, height = self._heights, np.nan
            if system.has_potential and not found.plain:
                height = system.potential() if np.isnan(heights[-1]) else heights[-1]
            bounds = {"height": height, "highest": float(np.fmax.reduce(heights))}
            shifted, early = found.shift > 0.0, self._start.early
            end = line_search(system, seen, found.du, **bounds, shifted=shifted, early=early)
            self._heights = [*heights[1 - MEMORY :], end.potential]
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

    def _directions(self, ksp: PETSc.KSP, here: Residual, *, moves: bool) -> Iterator[Direction]:
        """Yield one direction after the other, until one of them leads on.

        With a potential the plain one comes last, but while prescribed displacements move and for a
        few steps after that. Without one a shift is what is left where the plain solve fails, or
        Stop is raised. With scalars no tangent is refused: they lead on where K does not.
        """
        system, feti, first = self._system, ksp.getPythonContext(), not self.history
        refuse = self._refuse and first and not system.scalars.size
        down, indefinite, iterations, leads = system.has_potential, None, [], False
        least = self._level if down else LEAST
        levels = [least, *range(max(LEAST, least + 1), len(SHIFTS))]
        may_shift = not moves and (down or not self._start.early)
        tries = [(level, False) for level in levels if may_shift]
        plain_first = not down or moves or self._patience > 0
        tries.insert(0 if plain_first else len(tries), (0, True))
        for level, plain in tries:
            system.shift(SHIFTS[level])
            feti.refuse_indefinite = not plain or refuse
            du = system.scalars.solve(ksp, system.A, here.equations, here.scalar)
            reason = ksp.getConvergedReason()
            failed = reason == Linear.DIVERGED_PCSETUP_FAILED
            if level == 0:
                indefinite = proved_negative(feti)
                system.is_held |= not failed
            if reason != Linear.DIVERGED_INDEFINITE_MAT:
                iterations.append(feti.iterations)
            elif refuse:
                raise Stop("poor guess")
            close = reason == Linear.DIVERGED_BREAKDOWN and feti.residual <= CLOSE
            leads = (reason > 0 or close) and (plain or system.dot(du, here.condensed) < 0.0)
            if leads:
                self._level = max(0, level - (1 if level > self._level else 2))
                self._patience -= plain and not moves and indefinite != 0
                yield Direction(du, SHIFTS[level], iterations, indefinite, plain)
                iterations = []
            elif failed and (first or not feti.singular):
                break
        self._level = 0
        raise Stop("no step") if leads else self._linear_failure(feti)

    def _linear_failure(self, feti: FETI) -> Stop:
        """Say why there is no direction: on the way a singular tangent lacks no support."""
        on_the_way = self._system.is_held or np.isfinite(self._start.reference)
        if not feti.message:
            return Stop("indefinite")
        if feti.singular and on_the_way:
            return Stop("singular")
        if on_the_way and (proved_negative(feti) or 0) > 0:
            return Stop("trial", feti.message.rstrip("."))
        return Stop("linear", feti.message)

    def _compare(self, here: Residual) -> None:
        """Compare the tangent with the derivative along the last ΔU, once in a solve, and tell."""
        self._compared = True
        found = difference_from_derivative(self._system, here, self._du)
        if found is not None:
            self.mismatch.append(found)
            warn(f"{NO_DERIVATIVE}: {found}", self._system.comm)
