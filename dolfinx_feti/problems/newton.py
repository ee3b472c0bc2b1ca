# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Newton's method as a PETSc SNES, every step solved by FETI.

.. math:: K'(U^k)\, ΔU = \mathcal F - K(U^k), \qquad U^{k+1} = U^k + α\, ΔU

(eq. 22, Augustin_eq:NewtonRecursion, and eq. 23, Augustin_eq:NewtonRecursion_h), with the step
length α of ``line_search``.

If the problem has a potential Π, Newton's method is kept on the way down: an indefinite tangent
leads to a saddle or a maximum, and then

.. math:: (K' + σ \operatorname{diag}|k|)\, ΔU = -r

is solved with the stiffness k of the dofs, with σ growing (``shift``) until no negative eigenvalue
is left that can be proved (``space``), which is known before the first iteration, and ΔU leads
downhill, ΔU·r < 0. In the next steps σ falls, to zero at the end. A tangent that turns out singular
on the way counts as indefinite.

A step keeps the tangent of the last one if that leads to the end in two steps, should each leave
the share of the residual that the last step has left: no assembly, no factors, no coarse matrix.
Fields are then condensed by the K_up and K_pp of this tangent, or κ would multiply by how much they
have changed.

A linear solve is no more accurate than the step deserves: beside its own tolerance, a tenth of the
residual that Newton's method aims at, or that a step with a kept tangent leaves, is enough,
‖r + K' ΔU‖ ≤ 0.1 r_end. Options that state how accurate linear solves are, are kept to.

Where Newton's method converges slowly, or not at all, the tangent is compared with the derivative
(``derivative``), once in a solve.

A residual of the size of its rounding errors (``System.rounding``) is zero as far as anybody can
tell: after a step Newton's method ends there, whatever the tolerances. With a condensed pressure
these errors grow with κ, those of the residual before condensation do not: it tells how far from
equilibrium the state is.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.solver import DOUBTFUL, FETI
from dolfinx_feti.problems.derivative import Mismatch, difference_from_derivative
from dolfinx_feti.problems.history import (
    NewtonStep,
    is_slow,
    proved_negative,
    record_step,
    share_left,
)
from dolfinx_feti.problems.line_search import line_search
from dolfinx_feti.problems.shift import fallen, raised
from dolfinx_feti.problems.solvers import no_closer_than, solved
from dolfinx_feti.problems.system import Residual, System, Tangent
from dolfinx_feti.runtime.collective import on_all, warn
from dolfinx_feti.runtime.compat import residual_is_nan
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.petsc_errors import python_errors

__all__ = ["Newton", "Start", "checked_start"]

Array = npt.NDArray[np.float64]
Reason, LinearReason = PETSc.SNES.ConvergedReason, PETSc.KSP.ConvergedReason

#: Share of the residual that Newton's method aims at which a linear solve may leave.
LEFT = 0.1

#: Steps in which the last tangent has to lead to the end to be kept: together they cost less than
#: one with a new tangent; and the share of the residual that each is taken to leave at least.
KEPT, LEAST_SHARE = 2, 0.1

#: How a solve ends that does not get closer, perhaps for a tangent that is not the derivative.
NOT_CLOSER = (Reason.DIVERGED_MAX_IT, Reason.DIVERGED_LINE_SEARCH)


@dataclass(frozen=True, slots=True)
class Start:
    """What Newton's method begins with, beside the state itself.

    Attributes:
        reference: Most that the residual at the start counts in the relative tolerance.
        tangent: The tangent of the first step, which the matrix holds; None for that of the start.
        aim: ‖r‖ that linear solves aim at, if Newton's method aims at a larger one for now.
    """

    reference: float = np.inf
    tangent: Tangent | None = None
    aim: float = np.inf


def checked_start(system: System, reference: float | None, tangent: Tangent | None) -> Start:
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
    return Start(np.inf if reference is None else float(reference), tangent)


@dataclass(frozen=True, slots=True)
class Direction:
    """Where a Newton step leads.

    Attributes:
        du: ΔU, (owned,).
        shift: σ of the tangent that ΔU was solved with.
        iterations: Those of each linear solve.
        indefinite: Negative eigenvalues that the tangent without a shift is proved to have; None if
            they are not known.
    """

    du: Array
    shift: float
    iterations: tuple[int, ...]
    indefinite: int | None


class Newton:
    """Context of a SNES that drives a ``System`` with a FETI KSP.

    From one solve to the next it keeps whether a tangent of the problem has been regular: then the
    Dirichlet conditions are enough.

    Attributes:
        history: A record for each step of the last solve.
        message: What went wrong in it and what helps, or an empty string.
        residual: The (condensed) residual of its last iterate, (owned,).
        mismatch: How the tangent is not the derivative, once a solve has found that; else None.
    """

    def __init__(self, system: System) -> None:
        """Take the system; the state stays in the user's functions."""
        self._system = system
        self._start = Start()
        self._shift, self._potential = 0.0, np.nan
        self._du = np.zeros(system.owned)
        self._supported = False
        self.history: list[NewtonStep] = []
        self.message = ""
        self.residual = np.zeros(system.owned)
        self.mismatch: Mismatch | None = None
        self._compared = False

    @contextmanager
    def starting(self, start: Start) -> Iterator[None]:
        """Let a solve in this context begin with more than the state: PETSc hands nothing on."""
        self._start = start
        try:
            yield
        finally:
            self._start = Start()

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, x: PETSc.Vec) -> None:
        """Iterate from the state of the user's functions until the residual is small."""
        self.history, self.message, self._shift, self._potential = [], "", 0.0, np.nan
        self._compared = self.mismatch is not None
        try:
            reason = self._iterate(snes, self._start)
        except _Stop as stop:
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
        self.residual = here.condensed
        norm = system.norm(here.condensed)
        scale = float(np.fmin(norm, start.reference))
        if system.least_volume_ratio() <= 0.0:
            raise _Stop(Reason.DIVERGED_FUNCTION_DOMAIN, _INVERTED)
        reason = _judge(snes, 0, norm, scale)
        while reason == Reason.ITERATING:
            aim = min(_aim(snes, scale), start.aim)
            share = share_left(self.history, norm)
            kept = norm * share**KEPT <= aim
            left = norm * max(share, LEAST_SHARE) if kept else 0.0
            if not kept and (self.history or start.tangent is None):
                with event("FETITangent"):
                    system.linearise(here)
            floor = system.rounding()
            if self.history and norm <= floor:
                if (force := system.norm(here.force)) > DOUBTFUL * scale:
                    warn(_DOUBTFUL.format(force, scale), system.comm)
                return Reason.CONVERGED_FNORM_ABS
            if not kept and not self._compared and is_slow(self.history, norm):
                self._compare(here, self._du)
            with no_closer_than(LEFT * max(aim, left), snes.getKSP()):
                here, started = self._step(snes, here, norm, floor, started, kept=kept)
            self.residual = here.condensed
            norm = system.norm(here.condensed)
            reason = _judge(snes, len(self.history), norm, scale)
        return reason

    def _step(
        self,
        snes: PETSc.SNES,
        here: Residual,
        norm: float,
        floor: float,
        started: float,
        *,
        kept: bool,
    ) -> tuple[Residual, float]:
        """Take a step, with a larger shift where no step length is admissible, and record it.

        Args:
            snes: The SNES.
            here: The residual; the matrix holds the tangent of the step.
            norm: ‖r‖.
            floor: What rounding leaves of it; below, no step length has to be admissible.
            started: When the assembly began.
            kept: Whether the tangent is that of the step before.

        Returns:
            The residual where the step ends, and when its assembly began.
        """
        system, ksp = self._system, snes.getKSP()
        seen = system.seen_by_tangent(here) if kept else here
        while True:
            assembled = time.perf_counter()
            found = self._direction(ksp, seen.condensed)
            solved = time.perf_counter()
            end = line_search(
                system, seen, found.du, lengthen=found.shift > 0.0, potential=self._potential
            )
            self._potential = end.potential
            step = record_step(
                ksp.getPythonContext(),
                residual=norm,
                step_length=end.alpha,
                indefinite=found.indefinite,
                shift=found.shift,
                iterations=found.iterations,
                assembly=assembled - started,
                linear=solved - assembled,
                floor=floor,
                tangent_lag=self.history[-1].tangent_lag + 1 if kept else 0,
            )
            self.history.append(step)
            self._shift = fallen(found.shift, grown=found.shift > self._shift)
            self._du = found.du
            if end.alpha > 0.0 or norm <= floor or kept:
                return end.residual if end.alpha > 0.0 else here, solved
            larger = raised(found.shift) if system.has_potential else None
            if larger is None:
                raise _Stop(Reason.DIVERGED_LINE_SEARCH, _NO_STEP)
            self._shift, started = larger, solved

    def _compare(self, here: Residual, du: Array) -> None:
        """Compare the tangent with the derivative along ΔU, once in a solve, and tell."""
        self._compared = True
        self.mismatch = difference_from_derivative(self._system, here, du)
        if self.mismatch is not None:
            warn(str(self.mismatch), self._system.comm)

    def _direction(self, ksp: PETSc.KSP, r: Array) -> Direction:
        """Solve (K + σ diag|k|) ΔU = −r with the least σ that leads downhill.

        Raises:
            _Stop: There is none.
        """
        system, feti = self._system, ksp.getPythonContext()
        sigma: float | None = self._shift
        iterations: list[int] = []
        indefinite = None
        while sigma is not None:
            if sigma > 0.0:
                system.shift(sigma)
            du = solved(ksp, system.A, -r)
            reason = ksp.getConvergedReason()
            failed = reason == LinearReason.DIVERGED_PCSETUP_FAILED
            if sigma == 0.0:
                indefinite = proved_negative(feti)
                self._supported = self._supported or not failed
            if reason != LinearReason.DIVERGED_INDEFINITE_MAT:
                iterations.append(feti.iterations)
            uphill = system.has_potential and system.dot(du, r) >= 0.0
            if reason > 0 and not uphill:
                return Direction(du, sigma, tuple(iterations), indefinite)
            if not system.has_potential or (failed and not (feti.singular and self.history)):
                break
            sigma = raised(sigma)
        self._shift = 0.0
        raise _Stop(Reason.DIVERGED_LINEAR_SOLVE, self._linear_failure(feti))

    def _linear_failure(self, feti: FETI) -> str:
        """Say why there is no direction, and what helps."""
        if not feti.message:
            return _INDEFINITE
        on_the_way = self._supported or np.isfinite(self._start.reference)
        if feti.singular and on_the_way:
            return _SINGULAR
        if on_the_way and (proved_negative(feti) or 0) > 0:
            return _TRIAL.format(feti.message.rstrip("."))
        return f"the linear solver: {feti.message}"


class _Stop(Exception):  # noqa: N818
    """Newton's method ends here; raised on all processes.

    Attributes:
        reason: PETSc's reason.
        message: What went wrong and what helps.
    """

    def __init__(self, reason: int, message: str) -> None:
        super().__init__(message)
        self.reason, self.message = reason, message


def _judge(snes: PETSc.SNES, its: int, norm: float, scale: float) -> int:
    """Monitor the residual; return whether to go on, or PETSc's reason to end.

    Raises:
        _Stop: The residual is no number, or there were too many steps.
    """
    rtol, atol, _, max_it = snes.getTolerances()
    snes.setIterationNumber(its)
    snes.setFunctionNorm(norm)
    snes.logConvergenceHistory(norm, snes.getKSP().getIterationNumber())
    on_all(lambda: _monitor(snes, its, norm), snes.comm.tompi4py())
    if not np.isfinite(norm):
        raise _Stop(residual_is_nan(), _NOT_A_NUMBER)
    if norm <= atol:
        return Reason.CONVERGED_FNORM_ABS
    if norm <= rtol * scale:
        return Reason.CONVERGED_FNORM_RELATIVE
    if its >= max_it:
        raise _Stop(Reason.DIVERGED_MAX_IT, _TOO_MANY.format(max_it))
    return Reason.ITERATING


def _aim(snes: PETSc.SNES, scale: float) -> float:
    """Return the ‖r‖ that Newton's method aims at."""
    rtol, atol, *_ = snes.getTolerances()
    return max(rtol * scale, atol)


def _monitor(snes: PETSc.SNES, its: int, norm: float) -> None:
    """Call the monitors, which may be the user's own."""
    with python_errors():
        snes.monitor(its, norm)


_INVERTED = (
    "the volume ratio det F is not positive at the start: begin with u = 0 or an admissible state"
)
_INDEFINITE = "the tangent is indefinite and a shift does not help: load in smaller steps"
_SINGULAR = (
    "the tangent at this trial state is singular or indefinite, although the body is held: load in "
    "smaller steps"
)
_TRIAL = "the tangent at this trial state is indefinite: load in smaller steps (linear solver: {0})"
_NO_STEP = "no admissible step length was found: load in smaller steps"
_NOT_A_NUMBER = (
    "the residual is NaN or Inf: begin with an admissible state, or load in smaller steps"
)
_DOUBTFUL = (
    "Newton's method ends where all of the residual is rounding, with {0:.0e} of the {1:.0e} that "
    "it began with: if the load has changed, the equilibrium is doubtful. Load in larger steps, or "
    "lower a penalty such as κ and let an augmented Lagrangian make up for it."
)
_TOO_MANY = "no convergence within {0} steps: load in smaller steps or raise snes_max_it"
