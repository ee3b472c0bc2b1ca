# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The loop of all Krylov methods: when they precondition, test, step, and end.

``base.KrylovMethod`` is the whole solve, which a method does with :func:`iterate`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.monitor import Monitor
from dolfinx_feti.feti.primal.stopping import StoppingTest
from dolfinx_feti.runtime.arrays import Array

Reason = PETSc.KSP.ConvergedReason


@dataclass(frozen=True, slots=True)
class IterationEnd:
    """How the iterations of a method have ended.

    Attributes:
        reason: Converged reason; ``ITERATING`` if the method can neither converge nor continue.
        error_estimate: η of the last iterate; nan if it is not known.
    """

    reason: int
    error_estimate: float = np.nan

    @property
    def has_converged(self) -> bool:
        """Whether ‖r‖ and η have met their tolerances."""
        return self.reason == Reason.CONVERGED_RTOL

    @property
    def needs_fresh_start(self) -> bool:
        """Whether a new solve, for the residual of this one, may converge."""
        return self.reason == Reason.ITERATING


#: The end of a method that can neither converge nor continue.
FRESH_START = IterationEnd(Reason.ITERATING)


class KrylovIteration(Protocol):
    """The state of a method, which :func:`iterate` steps from one iterate to the next.

    Vectors are stored by copies, (n_Γ,). All methods are collective.
    """

    @property
    def its(self) -> int:
        """Number of completed iterations."""

    @property
    def norm(self) -> float:
        """‖r‖ of the present iterate."""

    @property
    def error_estimate(self) -> float:
        """η that :meth:`step` has found for the present iterate; nan if it does not estimate it."""

    def precondition(self) -> None:
        """Compute what the next step needs of Π M."""

    def preconditioned_residual(self) -> Array:
        """Return z = Π M r of the present iterate, (n_Γ,), after :meth:`precondition`."""

    def iterate(self) -> Array:
        """Return the present iterate x, (n_Γ,)."""

    def step(self, stopping: StoppingTest) -> IterationEnd | None:
        """Compute the next iterate, after :meth:`precondition`.

        Args:
            stopping: The test that the iterate is to pass.

        Returns:
            None if there is a next iterate, otherwise how the method ends at the present one.
        """

    def needs_fresh_start(self, stopping: StoppingTest) -> bool:
        """Return True if the present iterate shows that more iterations do not help.

        Args:
            stopping: The test that the iterate is to pass.
        """


def iterate(method: KrylovIteration, stopping: StoppingTest, monitor: Monitor) -> IterationEnd:
    """Step from iterate to iterate until the method ends. Collective.

    Args:
        method: The method at its initial guess.
        stopping: When it ends.
        monitor: Called with the number of iterations and ‖r‖ after each iteration.
    """
    reason = stopping.reason_of_residual(method.norm, 0)
    error_estimate = np.nan
    while reason == Reason.ITERATING:
        method.precondition()
        if stopping.needs_error_estimate(method.norm):
            error_estimate = stopping.estimate_error(
                method.preconditioned_residual(), method.iterate()
            )
            reason = stopping.reason_of_error(error_estimate, method.its)
            if reason != Reason.ITERATING:
                break
        end = method.step(stopping)
        if end is not None:
            return end
        monitor(method.its, method.norm)
        if method.needs_fresh_start(stopping):
            return FRESH_START
        error_estimate = method.error_estimate
        reason = stopping.reason_of_residual(method.norm, method.its, error_estimate)
    return IterationEnd(reason, error_estimate)
