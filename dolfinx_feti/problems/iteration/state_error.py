# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""When Newton's method has converged, by the estimated error of the state (docs/theory.md).

.. math:: ΔU ≈ -M r(U), \qquad
          η = \max_c \frac{\|ΔU_c\|}{(\|U_c\|^2 + \|U_c - U^0_c\|^2)^{1/2}}

by one application M of the preconditioner of the last tangent (``feti.accuracy`` has the components
c and their sizes). A residual can be small compared with the forces of a penalty although u is
still wrong; η shows that error. Scalars s are included, each relative to its own size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.converged_reason import LOGGED_ROUNDING_SHARE, MAX_ROUNDING_SHARE
from dolfinx_feti.feti.solve_settings import ErrorAllowance
from dolfinx_feti.problems.equations.system import System
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.iteration.convergence import Verdict
from dolfinx_feti.problems.iteration.iterate import Iterate, Start
from dolfinx_feti.problems.solvers import relative_tolerance
from dolfinx_feti.runtime.collective import warn

Reason = PETSc.SNES.ConvergedReason

#: Factor by which a step has to lower η for another one to follow. If rounding limits η, each step
#: leaves about as much. It is a choice, not measured.
REQUIRED_REDUCTION = 0.5

#: Estimated error that a linear solve may leave of ΔU: the next step removes it. Between 1e-4 and
#: 1e-2 the iterations of tubes and beams hardly differ; with 1e-8 they are a fifth more. With a
#: stiff penalty each Newton step lowers the error of U by this factor only.
LINEAR_ERROR = 1e-3

#: Error that a linear solve may leave, as a share of the tolerance of U: a tenth hardly adds to the
#: error of Newton's method. It is a choice, not measured.
ERROR_SHARE = 0.1

#: Multiple of the last floor of rounding below which the error is estimated although ‖r‖ does not
#: end the solve. The floor of the present state would need its tangent. That of the state before is
#: used instead, and the factor of ten allows for the change of the tangent in one step.
FLOOR_MULTIPLE = 10.0

_ROUNDED_ERROR = (
    "Newton's method ends with an estimated error of {0:.0e} of u, above its tolerance of {1:.0e}: "
    "a further step does not lower it, as rounding leaves as much. Lower a penalty, or scale the "
    "unknowns alike."
)


@dataclass(frozen=True, slots=True)
class ErrorEstimate:
    """The estimated error of one iterate, and what follows from it.

    Attributes:
        rtol: Its tolerance.
        eta: η; NaN if it was not measured.
        eta_before: η of the iterate before; NaN if that was not measured.
        lacks_scalar_solve: Whether η could not be measured because no linear solve with scalars
            came before, which sets up the border of the scalars.
    """

    rtol: float
    eta: float = np.nan
    eta_before: float = np.nan
    lacks_scalar_solve: bool = False

    @property
    def is_too_large(self) -> bool:
        """Whether η is known, and above its tolerance."""
        return bool(self.eta > self.rtol)

    @property
    def is_acceptable_as_rounding(self) -> bool:
        """Whether η is known, and no more than rounding may leave."""
        return bool(self.eta <= MAX_ROUNDING_SHARE)

    @property
    def needs_step(self) -> bool:
        """Whether a step has to follow although ‖r‖ would let the solve end.

        That is so if η is too large, unless the last step has hardly lowered it: rounding leaves
        the rest. It is also so if η is unknown because no linear solve with scalars came before.
        """
        if self.lacks_scalar_solve:
            return True
        return self.is_too_large and not self.eta > REQUIRED_REDUCTION * self.eta_before

    def target(self, iterate: Iterate) -> float:
        """Return the ‖r‖ at which η is expected to meet its tolerance; NaN if η is unknown."""
        return iterate.norm * self.rtol / self.eta

    def warn_if_visible(self, comm: MPI.Comm) -> None:
        """Log an error above its tolerance, if more than tiny rounding leaves it. Collective."""
        if self.is_too_large and self.eta > LOGGED_ROUNDING_SHARE:
            warn(_ROUNDED_ERROR.format(self.eta, self.rtol), comm)


class StateError:
    """Measures the estimated error of the iterates of one solve."""

    def __init__(self, system: System, snes: PETSc.SNES, start: Start) -> None:
        """Store the state that the solve begins with, U⁰.

        Args:
            system: The equations, at that state.
            snes: The SNES, with a FETI KSP; its relative tolerance is that of η.
            start: How the solve begins.
        """
        self._rtol = relative_tolerance(snes)
        self._system = system
        self._ksp: PETSc.KSP = snes.getKSP()
        self._origin = system.state.values()
        self._has_first_tangent = start.tangent is not None
        self._last_eta = np.nan  # of the last iterate

    def unknown(self) -> ErrorEstimate:
        """Return the estimate of an iterate that is not measured."""
        return ErrorEstimate(self._rtol)

    def measure(
        self, iterate: Iterate, verdict: Verdict, history: Sequence[NewtonStep]
    ) -> ErrorEstimate:
        """Measure η if ‖r‖ is within the relative tolerance, or near rounding. Collective.

        It is not measured if an absolute tolerance ends the solve. If the matrix holds no tangent,
        or one with a shift, the present one is assembled into it; no step reuses a tangent then.

        Args:
            iterate: Present iterate.
            verdict: Whether its ‖r‖ ends the solve.
            history: Steps before it.
        """
        eta_before = self._last_eta
        self._last_eta = np.nan
        ends = verdict.reason == Reason.CONVERGED_FNORM_RELATIVE and verdict.is_within_tolerances
        is_undecided = not verdict.ends and _is_near_floor(iterate, history)
        if iterate.norm == 0.0 or not (ends or is_undecided):
            return self.unknown()
        if self._lacks_tangent(history):
            self._system.linearise(iterate.residual)
        self._last_eta = self._measured(iterate)
        is_unknown = bool(np.isnan(self._last_eta))
        has_scalars = self._system.scalars.size > 0
        return ErrorEstimate(
            self._rtol,
            self._last_eta,
            eta_before,
            lacks_scalar_solve=ends and is_unknown and not history and has_scalars,
        )

    def linear_allowance(self, estimate: ErrorEstimate) -> ErrorAllowance:
        """Return bounds of the estimated error of ΔU, within which the next linear solve may end.

        Args:
            estimate: The error of the iterate where the step begins.
        """
        share = LINEAR_ERROR
        if estimate.is_too_large:
            share = min(LINEAR_ERROR, ERROR_SHARE * self._rtol / estimate.eta)
        return ErrorAllowance(share, ERROR_SHARE * self._rtol * self._system.state.values().u)

    def _lacks_tangent(self, history: Sequence[NewtonStep]) -> bool:
        """Return True if the matrix holds no tangent without a shift.

        Before the first step, a KSP that was set up has the tangent of an earlier solve. Its
        preconditioner is all that η needs.
        """
        if history:
            return history[-1].shift > 0.0
        is_set_up = bool(self._ksp.getPythonContext().formulation)
        return not (self._has_first_tangent or is_set_up)

    def _measured(self, iterate: Iterate) -> float:
        """Return η of the present iterate; nan without a preconditioner. Collective."""
        system = self._system
        residual = iterate.residual
        correction = system.scalars.correction(self._ksp, residual.of_u, residual.of_scalars)
        if correction is None:
            return np.nan
        du, ds = correction
        u, _, s = system.state.values()
        change_of_u = u - self._origin.u
        change_of_s = s - self._origin.s
        error, _ = self._ksp.getPythonContext().errors_of_correction(du, [u, change_of_u])
        size_of_u = np.maximum(np.abs(u), np.abs(change_of_u))
        size_of_s = np.maximum(np.abs(s), np.abs(change_of_s))
        return float(max(error, system.scalars.error_of_scalars(ds, size_of_s, size_of_u)))


def _is_near_floor(iterate: Iterate, history: Sequence[NewtonStep]) -> bool:
    """Return True if ‖r‖ is near the rounding errors at the last iterate."""
    if not history or iterate.violates_constraints:
        return False
    return iterate.norm <= FLOOR_MULTIPLE * history[-1].floor
