# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The loop of solves and updates of multipliers (augmented Lagrangian, docs/theory.md).

Multipliers λ enforce constraints: that cells keep their volume (``volume_multipliers``), or that a
body does not enter a tool (``contacts``). After each solve λ is updated, until all constraints are
satisfied.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from dolfinx_feti.errors import ConvergenceError

#: Largest number of updates in a solve: a bound on iterations that do not converge.
MAX_UPDATES = 50


class MultiplierUpdates(Protocol):
    """The updates of the multipliers of one kind of constraint, in one solve of a problem."""

    def end_solve(self) -> bool:
        """Measure the violation in the state just solved for; return True if it is small.

        λ may be set to the pressure of that state, which stays in equilibrium. Collective.
        """

    def update(self) -> None:
        """Set λ for the next solve. Collective."""

    def failure(self) -> str:
        """Return the message of a constraint that is not satisfied, with the remedy."""


def update_until_met(
    constraints: Sequence[MultiplierUpdates], solve: Callable[[int], bool]
) -> None:
    """Solve and update multipliers in turn, until all constraints are satisfied.

    Args:
        constraints: The updates of the multipliers of each constraint.
        solve: Function of the number of updates before it, n_updates. It solves with the present
            multipliers, and returns True if the state is within the solver's own tolerances.

    Raises:
        ConvergenceError: There were too many updates, or ``solve`` failed.
    """
    are_met: list[bool] = []
    for n_updates in range(MAX_UPDATES):
        is_solved = solve(n_updates)
        are_met = [updates.end_solve() for updates in constraints]
        if is_solved and all(are_met):
            return
        for updates in constraints:
            updates.update()
    failures = [
        updates.failure()
        for updates, is_met in zip(constraints, are_met, strict=True)
        if not is_met
    ]
    if not failures:
        failures = ["Newton's method does not reach its tolerances; raise snes_rtol or snes_max_it"]
    raise ConvergenceError(f"After {MAX_UPDATES} updates of the multipliers {'; '.join(failures)}.")
