# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The states U + α ΔU along a direction, and the work of the free forces along it.

.. math:: g(α) = ΔU_f · r_f(U + α ΔU), \qquad g_0 = ΔU_f·(r_f + K_{fD}\, ΔU_D)

f are the free dofs and D the Dirichlet dofs. In g(α), r_f are the forces before fields are
condensed into them. In g_0 they are the condensed ones, so that g_0 is the slope of Π(u, p(u)).
Without condensed fields, and if no prescribed displacement moves, g_0 is g(0). If one moves, g_0 is
the work of the forces on the free dofs after the Dirichlet dofs have moved, and before the free
dofs have.

With scalars the force B Δs of their increments does work as well, and ΔU alone need not lead
downhill. Then :math:`g_0 = -|ΔU_f·(r_f + K_{fD} ΔU_D)| - |ΔU_f·B Δs|`, the size of both works.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_feti.problems.equations.system import Residual, System
from dolfinx_feti.problems.iteration.iterate import Direction, Iterate
from dolfinx_feti.runtime.norms import dot


@dataclass(frozen=True, slots=True)
class Trial:
    """A trial state U + α ΔU; at α = 0 the state where the step begins."""

    alpha: float
    residual: Residual  # that at α = 0 if a cell is inside out
    ratio: float = np.nan  # g(α)/g_0; nan if a cell is inside out or a force is, 0 if g_0 = 0
    is_accepted: bool = False
    potential: float = np.nan  # Π; nan if it was not evaluated


class Line:
    """The states along the direction of one Newton step.

    Attributes:
        comm: Communicator, for norms of the forces of trials.
        iterate: Where the step begins.
        direction: ΔU.
        slope: g_0. It is negative for a descent direction, and may be positive for others.
        start: The trial at α = 0, with g = g_0.
        allows_overshoot: Whether a whole step with finite forces may end anywhere
            (``line_search.WholeStep``).
    """

    def __init__(
        self,
        system: System,
        iterate: Iterate,
        direction: Direction,
        *,
        allows_overshoot: bool = False,
    ) -> None:
        """Compute g_0. Collective.

        Args:
            system: The equations, at the state of the iterate; its matrix holds the tangent.
            iterate: Where the step begins.
            direction: ΔU.
            allows_overshoot: Whether a whole step with finite forces may end anywhere.
        """
        self.comm = system.comm
        self.iterate = iterate
        self.direction = direction
        self.allows_overshoot = allows_overshoot
        self.start = Trial(0.0, iterate.residual, 1.0)
        self._system = system
        self._origin = system.state.values()
        self._step = system.increment(iterate.residual, direction.du, direction.ds)
        self._free_du = system.conditions.free(direction.du)  # ΔU_f
        self.slope = self._initial_slope()

    def _initial_slope(self) -> float:
        """Return g_0. Collective."""
        system = self._system
        r = self.iterate.residual.condensed
        if self.iterate.violates_constraints:
            prescribed_du = self.direction.du - self._free_du  # ΔU_D
            r = r + system.tangent.multiply(prescribed_du)  # r_f + K_fD ΔU_D
        slope = dot(self.comm, self._free_du, r)
        if system.scalars.size:
            force = system.scalars.force_of(self.direction.ds)  # B Δs
            work = dot(self.comm, self._free_du, force)
            slope = -abs(slope) - abs(work)
        return slope

    def move(self, alpha: float) -> Trial:
        """Move the state to U + α ΔU, and measure g there; nothing is accepted yet. Collective."""
        system = self._system
        system.state.set(self._origin.moved(alpha, self._step))
        if system.smallest_volume_ratio() <= 0.0:
            return Trial(alpha, self.start.residual)
        residual = system.residual()
        ratio = 0.0
        if self.slope:
            ratio = dot(self.comm, self._free_du, residual.force) / self.slope  # g(α)/g_0
        return Trial(alpha, residual, ratio)

    def stay(self) -> Trial:
        """Move the state back to U, as no step length is admissible. Collective."""
        self._system.state.set(self._origin)
        return Trial(0.0, self.start.residual)
