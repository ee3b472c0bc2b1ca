# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Is the tangent J the derivative of the residual? A difference quotient tells (docs/theory.md).

.. math:: q = \frac{r(U + h d) - r(U - h d)}{2 h}, \qquad \|q - J d\| > 5 e, \qquad
          e = \frac{\|r(U + h d) - 2 r(U) + r(U - h d)\|}{2 h}

along the last step d. ``-snes_test_jacobian`` takes a quotient for each dof, knows no condensed
fields, and only prints.
"""

from __future__ import annotations

import numpy as np

from dolfinx_feti.diagnosis.advice import Advice
from dolfinx_feti.problems.system import Residual, System
from dolfinx_feti.runtime.arrays import Array

QUANTITY = "difference of J from the derivative of F"

#: How many e a mismatch is at least.
SURE = 5.0

#: h |d| over |u|, greatest entries: the best for a central difference quotient.
STEP = float(np.cbrt(np.finfo(float).eps))

#: |cos| of the angle between d and q − J d below which these are orthogonal.
ORTHOGONAL = 1e-4

#: Share of r by which a coefficient has changed r, at the same state.
CHANGED = 1e-3

#: What is likely to be wrong, and what helps.
RIM = (
    "It is the symmetric part of it, as of a pressure whose surface has a free rim: take "
    "follower_pressure_tangent(…, bcs=bcs), or kind='full'."
)
TERM = (
    "J lacks a term of F, such as the tangent of a pressure: add it, or leave J out, which is "
    "derived then."
)
COEFFICIENT = (
    "A coefficient of F changes with u from step to step, as in a monitor: write it as an "
    "expression in u, or change it between solves."
)


def difference_from_derivative(system: System, here: Residual, d: Array) -> Advice | None:
    """Compare the tangent with a difference quotient along the last increment d of u, (owned,).

    The matrix holds the tangent at the present state, without a shift, and ``here`` is the residual
    as it was met there. The mismatch is ‖q − J d‖/‖q‖, or the change of r at one state over ‖r‖,
    beside its error; None if none is sure. Collective.
    """
    start, d, r = system.state(), system.free(d), system.free(here.force)
    most, reach = system.greatest(d), system.greatest(start[0])
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
            return Advice(COEFFICIENT, QUANTITY, change, CHANGED)
    missed = q - system.free(system.multiply(d))  # q − J d
    norm, error, whole = system.norm(missed), bend / h, system.norm(q)
    if not norm > SURE * error:
        return None
    skew = abs(system.dot(d, missed)) <= ORTHOGONAL * system.norm(d) * norm
    return Advice(RIM if skew else TERM, QUANTITY, norm / whole, error / whole)
