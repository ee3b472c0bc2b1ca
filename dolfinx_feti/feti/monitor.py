# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The monitors of the user's KSP, called during the solves of a formulation."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.petsc_errors import python_errors

#: Function of (iteration, ‖b − A x‖).
Monitor = Callable[[int, float], None]


class OuterMonitor:
    """Calls the monitors of the user's KSP, and extends its history, in each iteration."""

    def __init__(self, ksp: PETSc.KSP) -> None:
        """Detect whether some process has a monitor in Python. Collective.

        Args:
            ksp: The user's KSP.
        """
        self._ksp = ksp
        self._comm = ksp.comm.tompi4py()
        # A monitor in Python may be set on one process alone, and raise an error there.
        self._has_monitors = self._comm.allreduce(bool(ksp.getMonitor()), op=MPI.LOR)

    def for_start(self, iterations_before: int, *, is_first: bool) -> Monitor:
        """Return the monitor of one start of a Krylov method.

        Args:
            iterations_before: Number of iterations before this start.
            is_first: Whether it is the first start of the user's solve, whose iteration 0 is shown.
                That of a later start is not: its residual is the last one of the start before.
        """

        def monitor(iteration: int, norm: float) -> None:
            if iteration > 0 or is_first:
                self._show(iterations_before + iteration, norm)

        return monitor

    def _show(self, iteration: int, norm: float) -> None:
        """Call the monitors; an error of one of them is raised on all processes."""
        self._ksp.logConvergenceHistory(norm)

        def call() -> None:
            with python_errors():
                self._ksp.monitor(iteration, norm)

        if self._has_monitors:
            on_all(call, self._comm)
        else:
            call()
