# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""When Newton's method has converged, by the residual (docs/theory.md).

.. math:: \|r\| ≤ \max(\texttt{snes\_rtol}\, \max(\|r^0\|, \|R\|/10),\; \texttt{snes\_atol})

over the free dofs, once all constraints are satisfied (Dirichlet values and scalar equations). A
solve for a new load starts with a residual r⁰ of the size of that load. A solve for a prescribed
displacement starts without such a residual. Its residuals are compared with the reactions R, the
forces that supports, scalars or contacts exert.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.problems.iteration.iterate import Iterate, Start
from dolfinx_feti.problems.solvers import RTOL, relative_tolerance

Reason = PETSc.SNES.ConvergedReason

#: Share of the reactions that the relative tolerance refers to. A tenth is a margin, and not
#: measured: reactions of opposite supports may be larger than the load that they carry.
REACTION_SHARE = 0.1

#: Share of its first residual at which an intermediate solve ends, mostly after one step. It is a
#: choice, not measured: the next update of the multipliers changes the residual by more.
INTERMEDIATE_RTOL = 0.1


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a solve ends at an iterate."""

    reason: int  # PETSc's; ITERATING to go on
    is_within_tolerances: bool  # the SNES's own; an intermediate solve ends before

    @property
    def ends(self) -> bool:
        """Whether the test ends the solve."""
        return self.reason != Reason.ITERATING


class ConvergenceTest:
    """The package's test of ‖r‖, with the SNES's tolerances."""

    def __init__(self, snes: PETSc.SNES, start: Start, first: Iterate) -> None:
        """Create the test of a solve.

        Args:
            snes: The SNES, whose tolerances are read at each test.
            start: How the solve begins.
            first: Its first iterate, with the residual r⁰.
        """
        self._snes = snes
        self._start = start
        self._first_norm = first.norm
        self._has_prescribed_motion = first.violates_constraints
        # ‖r⁰‖, or the reference if that is smaller, as on a path; fmin ignores a reference of NaN
        self._load = float(np.fmin(first.norm, start.reference_norm))

    def reference_force(self, iterate: Iterate) -> float:
        """Return the force that the relative tolerance refers to, max(‖r⁰‖, share · ‖R‖).

        The share is a tenth if a prescribed displacement moves. If none does, a relative tolerance
        that is looser than the default is meant as a share of ‖r⁰‖: the share of ‖R‖ then shrinks
        in proportion, so that rtol · share · ‖R‖ keeps its default value.
        """
        rtol = relative_tolerance(self._snes)
        share = REACTION_SHARE
        if not self._has_prescribed_motion and rtol > RTOL:
            share *= RTOL / rtol
        return max(self._load, share * iterate.reaction_norm)

    def applied_load(self, iterate: Iterate) -> float:
        """Return the force that drives the solve: ‖r⁰‖, or the reactions to a prescribed motion.

        A warning compares rounding errors with it.
        """
        return self.reference_force(iterate) if self._has_prescribed_motion else self._load

    def target(self, iterate: Iterate) -> float:
        """Return the ‖r‖ that is small enough."""
        rtol, atol, *_ = self._snes.getTolerances()
        return max(rtol * self.reference_force(iterate), atol)

    def judge(self, iterate: Iterate) -> Verdict:
        """Compare ‖r‖ with the tolerances."""
        _, atol, *_ = self._snes.getTolerances()
        if iterate.violates_constraints:
            return Verdict(Reason.ITERATING, is_within_tolerances=False)
        is_within = iterate.norm <= self.target(iterate)
        if is_within and iterate.norm <= atol:
            return Verdict(Reason.CONVERGED_FNORM_ABS, is_within)
        if is_within or iterate.norm <= self._intermediate_target(iterate):
            return Verdict(Reason.CONVERGED_FNORM_RELATIVE, is_within)
        return Verdict(Reason.ITERATING, is_within_tolerances=False)

    def _intermediate_target(self, iterate: Iterate) -> float:
        """Return the ‖r‖ at which an intermediate solve ends; zero for other solves."""
        if not self._start.is_intermediate:
            return 0.0
        if self._has_prescribed_motion:
            return INTERMEDIATE_RTOL * self.reference_force(iterate)
        return INTERMEDIATE_RTOL * self._first_norm
