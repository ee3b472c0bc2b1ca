# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Which trial states of a line search are accepted (docs/theory.md).

A trial is *within bounds* if the work g of the free forces neither overshoots nor grows, and it
*descends* if the potential Π falls by Armijo's rule:

.. math:: -η ≤ g(α)/g_0 ≤ 1 + η, \qquad Π(U + α ΔU) ≤ Π(U) + 10^{-4}\, α\, g_0.

A trial is accepted if

1. it is within bounds, and Π need not decide; or
2. it descends and does not overshoot, g(α)/g_0 ≥ −η; with a shift it may overshoot.

Π decides if it is known, its change is not rounding, and ΔU has a shift or no field is condensed:
for an unshifted step with a condensed pressure g is enough. Π is not used while a constraint is
violated, as a prescribed displacement does work, nor for directions that need not descend.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dolfinx_feti.problems.equations.system import System
from dolfinx_feti.problems.iteration.line import Line, Trial

#: η: how far g(α)/g_0 of an accepted trial may lie outside [0, 1]. Below 1, so that a step that
#: reverses g completely is shortened; it is a choice, not measured.
OVERSHOOT = 0.8

#: Share of Π below which its change is rounding of a sum over many cells: 1e-16 times the root of
#: the number of quadrature points, with room to spare. Not measured.
POTENTIAL_ROUNDING = 1e-9

#: Share of the slope g_0 by which Π has to fall (Armijo's usual 1e-4).
ARMIJO = 1e-4


class StepTest:
    """The test of the trials along one line.

    Attributes:
        potential: Π(U); nan if it was not evaluated.
    """

    def __init__(self, system: System, line: Line) -> None:
        """Evaluate Π(U) if there is a potential and ΔU was required to descend. Collective.

        Args:
            system: The equations, at U.
            line: The line; its iterate may know Π(U).
        """
        self._system = system
        self._line = line
        self._is_shifted = line.direction.is_shifted
        self.potential = np.nan
        if system.has_potential and line.direction.is_descent:
            self.potential = line.iterate.potential
            if np.isnan(self.potential):
                self.potential = system.potential()
        is_known = not np.isnan(self.potential)
        self._uses_potential = is_known and not line.iterate.violates_constraints
        is_rounding = abs(line.slope) <= POTENTIAL_ROUNDING * abs(self.potential)
        has_fields = line.iterate.residual.blocks is not None
        may_decide = self._is_shifted or not has_fields
        self._potential_decides = self._uses_potential and not is_rounding and may_decide

    def judge(self, trial: Trial) -> Trial:
        """Return the trial, where the state is, with ``is_accepted`` and Π if needed. Collective.

        A trial with a cell inside out or a NaN is not accepted.
        """
        if np.isnan(trial.ratio):
            return trial
        is_within_bounds = -OVERSHOOT <= trial.ratio <= 1.0 + OVERSHOOT
        if is_within_bounds and not self._potential_decides:
            return replace(trial, is_accepted=True)  # 1
        if not self._uses_potential:
            return trial
        potential = self._system.potential()
        descends = potential <= self.potential + ARMIJO * trial.alpha * self._line.slope
        may_be_accepted = self._is_shifted or trial.ratio >= -OVERSHOOT
        return replace(trial, is_accepted=descends and may_be_accepted, potential=potential)  # 2
