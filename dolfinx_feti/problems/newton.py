# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Newton's method as a PETSc SNES, every step solved by FETI (docs/theory.md).

.. math:: K'(U^k)\, ΔU = \mathcal F - K(U^k), \qquad U^{k+1} = U^k + α\, ΔU

(eq. 22, Augustin_eq:NewtonRecursion, and eq. 23, Augustin_eq:NewtonRecursion_h), with ΔU of
``direction`` and α of ``line_search``. Forces r of the free dofs are small beside

.. math:: \max(\min(‖r^0‖, \text{reference}), ‖R‖/10)

with the reactions R. A step keeps a tangent that has served one step if it leads to the end, should
it leave as large a share of r again. A linear solve may leave a tenth of the ‖r‖ at the end, unless
options state its accuracy. Once in a solve that converges slowly or fails the tangent is compared
with the derivative (``derivative``). After a step, a residual that is rounding ends the solve.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.solver import DOUBTFUL
from dolfinx_feti.problems.derivative import Mismatch, difference_from_derivative
from dolfinx_feti.problems.direction import Directions
from dolfinx_feti.problems.history import CRAWLING, NewtonStep, Stop, crawls, is_slow, share_left
from dolfinx_feti.problems.line_search import line_search
from dolfinx_feti.problems.solvers import RTOL, no_closer_than
from dolfinx_feti.problems.system import Residual, System, Tangent
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all, warn
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.petsc_errors import python_errors

__all__ = ["Newton", "Start", "checked_start"]

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


@dataclass(frozen=True, slots=True)
class Start:
    """What Newton's method begins with, beside the state itself.

    Attributes:
        reference: Most that the residual at the start counts in the relative tolerance.
        tangent: The tangent of the first step, which the matrix holds; None for that of the start.
        rough: Whether to end at a tenth of the first residual; linear solves aim at the end still.
        early: Whether to give up early: the caller has another start, or a shorter way.
    """

    reference: float = np.inf
    tangent: Tangent | None = None
    rough: bool = False
    early: bool = False


def checked_start(
    system: System, reference: float | None, tangent: Tangent | None, *, early: bool
) -> Start:
    """Check what a solve is to begin with.

    Raises:
        ValueError: ``reference`` is negative, or the matrix no longer holds the tangent.

    Note:
        Collective.
    """
    if reference is not None and reference < 0.0:
        raise ValueError(f"reference is {reference}: give the norm of a residual.")
    replaced = tangent is not None and tangent != system.tangent()
    if system.comm.allreduce(replaced, op=MPI.LOR):
        raise ValueError(
            "first_tangent names a tangent that this problem's matrix does not hold any more: "
            "pass what linearise() has returned to the very next solve()."
        )
    return Start(np.inf if reference is None else float(reference), tangent, early=early)


class Newton:
    """Context of a SNES that drives a ``System`` with a FETI KSP.

    From one solve to the next it keeps whether a tangent of the problem has been regular: then the
    Dirichlet conditions are enough.

    Attributes:
        start: What the next solve begins with: PETSc hands nothing on.
        history: A record for each step of the last solve.
        message: What went wrong in it and what helps, or an empty string.
        residual: The (condensed) residual of its last iterate, (owned,), with u − g on Dirichlet
            dofs.
        at_end: Whether that is within the SNES's own tolerances, also after a rough solve.
        mismatch: How the tangent is not the derivative, once a solve has found that; else None.
    """

    def __init__(self, system: System) -> None:
        """Take the system; the state stays in the user's functions."""
        self._system = system
        self.start = Start()
        self._directions, self._heights = Directions(system), [np.nan]  # Π of the last states
        self._du = np.zeros(system.owned)
        self.history: list[NewtonStep] = []
        self.message = ""
        self.residual = np.zeros(system.owned)
        self.at_end = False
        self.mismatch: Mismatch | None = None
        self._compared = False

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, x: PETSc.Vec) -> None:
        """Iterate from the state of the user's functions until the residual is small."""
        start, self.start = self.start, Start()
        self._early = start.early
        self.history, self.message, self._heights = [], "", [np.nan]
        self._compared = self.mismatch is not None
        try:
            reason = self._iterate(snes, start)
        except Stop as stop:
            reason, self.message = stop.reason, stop.message
            if reason in NOT_CLOSER and self.history and not self._compared:
                self._system.linearise()
                self._compare(self._system.residual(), self._du)
            if reason in NOT_CLOSER and self.mismatch is not None:
                self.message = f"{stop.message.partition(':')[0]}: {self.mismatch}"
        snes.setConvergedReason(reason)
        x.array[:] = self._system.state()[0]

    def _iterate(self, snes: PETSc.SNES, start: Start) -> int:
        """Take steps until the residual is small; return PETSc's reason for that."""
        system, started = self._system, time.perf_counter()
        here = system.residual()
        self.residual = here.equations
        first = norm = system.norm(here.condensed)
        if system.least_volume_ratio() <= 0.0:
            raise self._directions.stop("inverted")
        load = float(np.fmin(first, start.reference))
        moved = system.boundary_moves(here)
        poor = start.early and start.tangent is None and first > start.reference
        guess = bool(np.isfinite(start.reference))
        self._directions.begin(moved=moved, refuse=poor, guess=guess, shortens=start.early)
        at_most = _share_of_reactions(snes, moved=moved)
        while True:
            moves = system.boundary_moves(here)
            reaction = at_most * system.reaction(here)
            scale = max(load, reaction)
            rough = ROUGH * (scale if moved else first) if start.rough else 0.0
            reason = self._judge(snes, norm, scale, rough, moves=moves)
            if reason != Reason.ITERATING:
                return reason
            aim, share = _end(snes, scale), share_left(self.history, norm)
            fresh = bool(self.history) and self.history[-1].tangent_lag == 0
            kept = not moves and fresh and norm * share <= aim
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
                self._compare(here, self._du)
            with no_closer_than(LEFT * aim, snes.getKSP()):
                here, started = self._step(snes, here, norm, floor, started, kept=kept, moves=moves)
            self.residual = here.equations
            norm = system.norm(here.condensed)
            if start.early and crawls(self.history):
                raise self._directions.stop("crawls", CRAWLING)

    def _judge(
        self, snes: PETSc.SNES, norm: float, scale: float, rough: float, *, moves: bool
    ) -> int:
        """Monitor ‖r‖, relative to a force ``scale``; return whether to go on, or why to end."""
        rtol, atol, _, max_it = snes.getTolerances()
        its = len(self.history)
        snes.setIterationNumber(its)
        snes.setFunctionNorm(norm)
        snes.logConvergenceHistory(norm, snes.getKSP().getIterationNumber())
        on_all(lambda: _monitor(snes, its, norm), snes.comm.tompi4py())
        if not np.isfinite(norm):
            raise self._directions.stop("not a number")
        self.at_end = not moves and norm <= max(atol, rtol * scale)
        if self.at_end and norm <= atol:
            return Reason.CONVERGED_FNORM_ABS
        if self.at_end or (not moves and norm <= rough):
            return Reason.CONVERGED_FNORM_RELATIVE
        if its >= max_it:
            raise self._directions.stop("too many", max_it)
        return Reason.ITERATING

    def _step(
        self,
        snes: PETSc.SNES,
        here: Residual,
        norm: float,
        floor: float,
        started: float,
        *,
        kept: bool,
        moves: bool,
    ) -> tuple[Residual, float]:
        """Take a step, with a larger shift where no step length is admissible, and record it.

        The matrix holds its tangent, perhaps kept from the step before. Below the floor of rounding
        no step length has to be admissible. It returns the residual where the step ends, and when
        that one's assembly began.
        """
        system, ksp = self._system, snes.getKSP()
        seen = system.seen_by_tangent(here) if kept else here
        directions = self._directions.along(ksp, seen, moves=moves)
        while True:
            assembled = time.perf_counter()
            found = next(directions)
            solved = time.perf_counter()
            height, shifted = self._heights[-1], found.shift > 0.0
            end = line_search(
                system,
                seen,
                found.du,
                shifted=shifted,
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
                seconds_assembly=assembled - started,
                seconds_linear=solved - assembled,
                floor=floor,
                tangent_lag=self.history[-1].tangent_lag + 1 if kept else 0,
            )
            self.history.append(step)
            self._du = found.du
            if end.alpha > 0.0 or norm <= floor or kept:
                return end.residual if end.alpha > 0.0 else here, solved
            started = solved

    def _compare(self, here: Residual, du: Array) -> None:
        """Compare the tangent with the derivative along ΔU, once in a solve, and tell."""
        self._compared = True
        self.mismatch = difference_from_derivative(self._system, here, du)
        if self.mismatch is not None:
            warn(str(self.mismatch), self._system.comm)


def _share_of_reactions(snes: PETSc.SNES, *, moved: bool) -> float:
    """Return the share of the reactions that counts as a load, less in a rough solve."""
    rtol, *_ = snes.getTolerances()
    return LEAST_REACTION * (1.0 if moved or rtol <= RTOL else RTOL / rtol)


def _end(snes: PETSc.SNES, scale: float) -> float:
    """Return the ‖r‖ that Newton's method aims at."""
    rtol, atol, *_ = snes.getTolerances()
    return max(rtol * scale, atol)


def _monitor(snes: PETSc.SNES, its: int, norm: float) -> None:
    """Call the monitors, which may be the user's own."""
    with python_errors():
        snes.monitor(its, norm)


_DOUBTFUL = (
    "Newton's method ends where all of the residual is rounding, with {0:.0e} of a load of "
    "{1:.0e}: if the load has changed, the equilibrium is doubtful. Load in larger steps, or "
    "lower a penalty such as κ and let an augmented Lagrangian make up for it."
)
