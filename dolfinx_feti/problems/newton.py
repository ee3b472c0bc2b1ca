# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Newton's method as a PETSc SNES, every step solved by FETI.

.. math:: K'(U^k)\, ΔU = \mathcal F - K(U^k), \qquad U^{k+1} = U^k + α\, ΔU

(eq. 23, Augustin_eq:NewtonRecursion_h). The step length α is one unless the trial state turns a
cell inside out, meets a NaN, or overshoots: with :math:`g(α) = ΔU·r(U + α ΔU)` a step is taken once
:math:`-η ≤ g(α)/g(0) ≤ 1 + η`, a search for the critical point of the energy along the step. With a
condensed pressure, g(α) holds :math:`r_u(U + α ΔU, p + α Δp)` and not the condensed residual: what
condensation adds grows with κ, though it is linear in Δp and the next step removes it.

If the problem has a potential Π (the strain energy, with the load's part), Newton's method
is kept on the way down: a step is taken if it lowers Π enough (Armijo),

.. math:: Π(U + α ΔU) ≤ Π(U) + 10^{-4}\, α\, ΔU·r,

with the condensed pressure that its own equation demands for either state; g has a say only while
prescribed displacements move, and where the change of Π drowns in rounding. And an indefinite
tangent leads to a saddle or a maximum: then

.. math:: (K' + σ \operatorname{diag}|k|)\, ΔU = -r

is solved with the stiffness k of the dofs, with σ growing from 1e-4 until no negative eigenvalue is
left that can be proved (``stability``), which is known before the first iteration, and ΔU leads
downhill, ΔU·r < 0. A step that σ has made too short, :math:`g(α) > 0.9\, g(0)`, is doubled while Π
falls (Wolfe's second condition). In the next steps σ falls, to zero at the end. A tangent that
turns out singular on the way counts as indefinite.
"""

from __future__ import annotations

import time

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti._compat import residual_is_nan
from dolfinx_feti.events import event
from dolfinx_feti.problems.history import NewtonStep, record_step
from dolfinx_feti.problems.system import System

__all__ = ["Newton"]

Array = npt.NDArray[np.float64]
Reason, LinearReason = PETSc.SNES.ConvergedReason, PETSc.KSP.ConvergedReason

#: By how much g(α)/g(0) of an accepted step may leave the interval from zero to one.
ETA = 0.8

#: Shortest step that is tried, and the longest with a shift.
SHORTEST, LONGEST = 1.0 / 1024, 16.0

#: Where g(α)/g(0) is still above this, a step with a shift is too short (Wolfe).
FLAT = 0.9

#: Share of the potential below which its change is rounding.
ROUNDING = 1e-9

#: Share of the slope by which a step has to lower the potential (Armijo).
DESCENT = 1e-4

#: The first shift of an indefinite tangent, its growth, and the one that is given up at.
LEAST_SHIFT, GROWTH = 1e-4, 4.0
MOST_SHIFT = LEAST_SHIFT * GROWTH**7


class Newton:
    """Context of a SNES that drives a ``System`` with a FETI KSP.

    Attributes:
        history: A record for each step of the last solve.
        message: What went wrong and what helps, or an empty string.
        has_tangent: Whether the matrix already holds the tangent for the first step.
        reference: Most that the residual at the start counts in the next solve's tolerance.
    """

    def __init__(self, system: System) -> None:
        """Take the system; the state stays in the user's functions."""
        self._system = system
        self.history: list[NewtonStep] = []
        self.message = ""
        self.has_tangent = False
        self.reference = np.inf
        self._shift, self._grown = 0.0, False  # σ of the last step, and whether it had to grow
        self._indefinite: int | None = 0

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, x: PETSc.Vec) -> None:
        """Iterate from the state of the user's functions until the residual is small."""
        system = self._system
        comm = snes.comm.tompi4py()
        self.history, self.message = [], ""
        has_tangent, self.has_tangent = self.has_tangent, False
        started = time.perf_counter()
        r = system.residual()
        norm = _norm(r, comm)
        first, self.reference = min(norm, self.reference), np.inf
        if system.least_volume_ratio() <= 0.0:
            self._stop(snes, Reason.DIVERGED_FUNCTION_DOMAIN, _INVERTED)
            return
        reason = self._judge(snes, 0, norm, first)
        while reason == Reason.ITERATING:
            if not has_tangent:
                with event("FETITangent"):
                    system.linearise()
            has_tangent = False
            seconds = time.perf_counter() - started
            du, iterations = self._direction(snes, r)
            linear = snes.getKSP()
            if du is None:
                feti = linear.getPythonContext()
                message = f"the linear solver: {feti.message}" if feti.message else _INDEFINITE
                self._stop(snes, Reason.DIVERGED_LINEAR_SOLVE, message)
                break
            seconds_linear = time.perf_counter() - started - seconds
            started = time.perf_counter()
            alpha, r = self._search(system, r, du, comm)
            step = record_step(
                linear,
                norm,
                alpha,
                indefinite=self._indefinite,
                shift=self._shift,
                iterations=iterations,
                assembly=seconds,
                linear=seconds_linear,
            )
            self.history.append(step)
            if alpha == 0.0 and self._shift_more():
                has_tangent = True  # once more from here
                continue
            if alpha == 0.0:
                self._stop(snes, Reason.DIVERGED_LINE_SEARCH, _NO_STEP)
                break
            norm = _norm(r, comm)
            reason = self._judge(snes, len(self.history), norm, first)
        x.array[:] = system.state()[0]

    def refer_tolerance(self) -> None:
        """Let the relative tolerance of the next solve refer to the present residual."""
        system = self._system
        self.reference = _norm(system.residual(), system.u.function_space.mesh.comm)

    def _direction(self, snes: PETSc.SNES, r: Array) -> tuple[Array | None, list[int]]:
        """Solve (K + σ diag|k|) ΔU = −r with the least σ that leads downhill.

        Returns:
            ΔU, or None if there is none, and the iterations of each solve.
        """
        ksp, system, iterations = snes.getKSP(), self._system, []
        feti, comm = ksp.getPythonContext(), snes.comm.tompi4py()
        self._shift /= GROWTH if self._grown else GROWTH**2
        if self._shift < LEAST_SHIFT / GROWTH:
            self._shift = 0.0
        self._grown = False
        feti.refuse_indefinite = system.has_potential
        while self._shift <= MOST_SHIFT:
            if self._shift > 0.0:
                system.shift(self._shift)
            du = self._step(ksp, r)
            if self._shift == 0.0:
                self._indefinite = feti.inertia and feti.inertia.assembled
            reason = ksp.getConvergedReason()
            if reason != LinearReason.DIVERGED_INDEFINITE_MAT:
                iterations.append(feti.iterations)
            uphill = system.has_potential and _dot(du, r, comm) >= 0.0
            if reason > 0 and not uphill:
                return du, iterations
            failed = reason == LinearReason.DIVERGED_PCSETUP_FAILED
            if not system.has_potential or (failed and not (feti.singular and self.history)):
                break
            self._shift, self._grown = max(LEAST_SHIFT, GROWTH * self._shift), True
        self._shift = 0.0
        return None, iterations

    def _shift_more(self) -> bool:
        """Let the next direction begin with a larger shift; tell whether there is one."""
        if not self._system.has_potential or self._shift >= MOST_SHIFT:
            return False
        self._shift, self._grown = max(LEAST_SHIFT, GROWTH * self._shift) * GROWTH, True
        return True

    def _step(self, ksp: PETSc.KSP, r: Array) -> Array:
        """Solve K ΔU = −r."""
        rhs, du = self._system.A.createVecs()
        rhs.array[:] = -r
        ksp.setOperators(self._system.A)
        ksp.solve(rhs, du)
        step = du.array_r.copy()
        rhs.destroy()
        du.destroy()
        return step

    def _search(self, system: System, r: Array, du: Array, comm: MPI.Comm) -> tuple[float, Array]:
        """Find a step length and move there; without one, stay and return zero."""
        start, step = system.state(), system.increment(du)
        slope = _dot(du, r, comm)  # g(0) < 0
        height = system.potential() if system.has_potential else np.nan
        only_down = abs(slope) > ROUNDING * abs(height) and not system.moves_boundary(du)

        def move(alpha: float) -> tuple[bool, float, Array]:
            """Move; tell whether the step will do, g(α)/g(0), and the residual."""
            system.set_state((start[0] + alpha * step[0], start[1] + alpha * step[1]))
            if system.least_volume_ratio() <= 0.0:
                return False, np.nan, r
            trial = system.residual()
            ratio = _dot(du, system.force, comm) / slope if slope else 0.0
            fits = not only_down and -ETA <= ratio <= 1.0 + ETA
            if not fits and system.has_potential:
                fits = system.potential() <= height + DESCENT * alpha * slope
            return fits, ratio, trial

        alpha = 1.0
        fits, ratio, trial = move(alpha)
        while not fits:
            secant = 1.0 / (1.0 - ratio) if ratio < 0.0 else 0.5  # zero of the line through g
            alpha *= min(max(secant, 0.1), 0.5)
            if alpha < SHORTEST:
                system.set_state(start)
                return 0.0, system.residual()
            fits, ratio, trial = move(alpha)
        while self._shift > 0.0 and ratio > FLAT and 1.0 <= alpha < LONGEST:
            fits, ratio, longer = move(2.0 * alpha)
            if not fits:
                _, _, trial = move(alpha)
                break
            alpha, trial = 2.0 * alpha, longer
        return alpha, trial

    def _judge(self, snes: PETSc.SNES, its: int, norm: float, first: float) -> int:
        """Monitor and decide whether to go on."""
        rtol, atol, _, max_it = snes.getTolerances()
        snes.setIterationNumber(its)
        snes.setFunctionNorm(norm)
        snes.logConvergenceHistory(norm, snes.getKSP().getIterationNumber())
        snes.monitor(its, norm)
        reason = Reason.ITERATING
        if not np.isfinite(norm):
            reason, self.message = residual_is_nan(), _NOT_A_NUMBER
        elif norm <= atol:
            reason = Reason.CONVERGED_FNORM_ABS
        elif norm <= rtol * first:
            reason = Reason.CONVERGED_FNORM_RELATIVE
        elif its >= max_it:
            reason, self.message = Reason.DIVERGED_MAX_IT, _TOO_MANY.format(max_it)
        snes.setConvergedReason(reason)
        return reason

    def _stop(self, snes: PETSc.SNES, reason: int, message: str) -> None:
        self.message = message
        snes.setConvergedReason(reason)


_INVERTED = (
    "the volume ratio det F is not positive at the start: begin with u = 0 or an admissible state"
)
_INDEFINITE = "the tangent is indefinite and a shift does not help: load in smaller steps"
_NO_STEP = "no admissible step length was found: load in smaller steps"
_NOT_A_NUMBER = (
    "the residual is NaN or Inf: begin with an admissible state, or load in smaller steps"
)
_TOO_MANY = "no convergence within {0} steps: load in smaller steps or raise snes_max_it"


def _dot(a: Array, b: Array, comm: MPI.Comm) -> float:
    return float(comm.allreduce(a @ b))


def _norm(r: Array, comm: MPI.Comm) -> float:
    return float(np.sqrt(_dot(r, r, comm)))
