# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Is the tangent J the derivative of the residual? A difference quotient tells (docs/theory.md).

.. math:: q = \frac{r(U + h d) - r(U - h d)}{2 h}, \qquad J d = q\,?

along the last step d, with the condensed pressure, :math:`δp = -K_{pp}^{-1} K_{pu} d`. A mismatch
is beyond the error of q, below that of a one-sided quotient,

.. math:: e = \frac{\|r(U + h d) - 2 r(U) + r(U - h d)\|}{2 h}.

``-snes_test_jacobian`` takes a quotient for each dof, knows no condensed fields, and only prints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mpi4py import MPI

import numpy as np

from dolfinx_feti.problems.system import Residual, System
from dolfinx_feti.runtime.arrays import Array

__all__ = ["Mismatch", "difference_from_derivative"]


#: How many e a mismatch is at least.
SURE = 5.0

#: h |d| over |u|, greatest entries: the best for a central difference quotient.
STEP = float(np.cbrt(np.finfo(float).eps))

#: |cos| of the angle between d and q − J d below which these are orthogonal.
ORTHOGONAL = 1e-4

#: Share of r by which a coefficient has changed r, at the same state.
CHANGED = 1e-3

#: What is likely to be wrong, and what helps.
REMEDIES = {
    "rim": "It is the symmetric part of it, as of a pressure whose surface has a free rim: take "
    "follower_pressure_tangent(…, bcs=bcs), or kind='full'.",
    "term": "J lacks a term of F, such as the tangent of a pressure: add it, or leave J out, which "
    "is derived then.",
    "coefficient": "A coefficient of F changes with u from step to step, as in a monitor: write it "
    "as an expression in u, or change it between solves.",
}


@dataclass(frozen=True, slots=True)
class Mismatch:
    """A tangent that is not the derivative of the residual.

    Attributes:
        size: ‖q − J d‖/‖q‖ along an increment d; of a coefficient, the change of r at one state,
            over ‖r‖.
        error: More than the error of the size.
        cause: ``rim``: q − J d is orthogonal to d, as where J is the symmetric part of the
            derivative; ``coefficient``: r has changed while u has not; ``term``: neither.
    """

    size: float
    error: float
    cause: Literal["rim", "term", "coefficient"]

    @property
    def remedy(self) -> str:
        """What is likely to be wrong, and what helps."""
        return REMEDIES[self.cause]

    def __str__(self) -> str:
        """Return the finding and the remedy."""
        what = "at the same u F has changed" if self.cause == "coefficient" else "they differ"
        return (
            f"J is not the derivative of F along the last step: {what} by {self.size:.1e}, with an "
            f"error below {self.error:.0e}. {self.remedy}"
        )


def difference_from_derivative(system: System, here: Residual, d: Array) -> Mismatch | None:
    """Compare the tangent with a difference quotient along the last increment.

    Args:
        system: The system, whose matrix holds the tangent at its state, without a shift.
        here: The residual at this state, as it was met.
        d: Last increment of u, (owned,).

    Returns:
        The mismatch; None if there is none that is sure.

    Note:
        Collective. It takes two residuals, or three; the state is as before.
    """
    start, d, r = system.state(), system.free(d), system.free(here.force)
    most, reach = (_greatest(system, entries) for entries in (d, start[0]))
    if not 0.0 < most * reach < np.inf:
        return None
    h = STEP * reach / most
    dp = system.increment(here, d)[1] - system.increment(here, 0.0 * d)[1]  # δp = −K_pp⁻¹ K_pu d
    ends = []
    for sign in (1.0, -1.0):
        system.set_state((start[0] + sign * h * d, start[1] + sign * h * dp, start[2]))
        ends.append(system.free(system.residual().force))
    system.set_state(start)
    q = np.divide(ends[0] - ends[1], 2 * h)
    bend = system.norm((ends[0] + ends[1] - 2 * r) / 2)  # e h
    if bend > CHANGED * system.norm(r):
        change = system.norm(system.free(system.residual().force) - r) / system.norm(r)
        if change > CHANGED:
            return Mismatch(change, CHANGED, "coefficient")
    missed = q - system.free(system.multiply(d))  # q − J d
    norm, whole = system.norm(missed), system.norm(q)
    if not norm > SURE * bend / h:
        return None
    skew = abs(system.dot(d, missed)) <= ORTHOGONAL * system.norm(d) * norm
    return Mismatch(norm / whole, bend / h / whole, "rim" if skew else "term")


def _greatest(system: System, entries: Array) -> float:
    return system.comm.allreduce(float(np.abs(entries).max(initial=0.0)), op=MPI.MAX)
