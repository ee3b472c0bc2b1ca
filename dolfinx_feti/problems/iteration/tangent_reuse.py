# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Reuse of a tangent for a second step, if that leads to the end (docs/theory.md).

.. math:: \|r_k\|\, q ≤ r_\mathrm{end}, \qquad q = \|r_k\| / \|r_{k-1}\|

A new tangent costs its assembly, its factors and its coarse matrix; a solve with the last one costs
a few iterations. Steps far from the end assemble a tangent each, and converge quadratically.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.iteration.iterate import Iterate


def leads_to_end(iterate: Iterate, history: Sequence[NewtonStep], target: float) -> bool:
    """Return True if a step with the last tangent is expected to reach a residual norm.

    Args:
        iterate: Present iterate.
        history: Steps before it.
        target: ‖r‖ that is small enough.
    """
    return not iterate.violates_constraints and iterate.norm * reduction(iterate, history) <= target


def reduction(iterate: Iterate, history: Sequence[NewtonStep]) -> float:
    """Return the reduction q of the last step; ∞ unless it was a whole step with a new tangent."""
    if not history:
        return np.inf
    last = history[-1]
    is_newton_step = last.step_length == 1.0 and last.shift == 0.0 and last.tangent_lag == 0
    if not is_newton_step or last.residual == 0.0:
        return np.inf
    return iterate.norm / last.residual
