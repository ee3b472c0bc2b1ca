# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The callbacks of the user's KSP: monitors are called, a convergence test is refused."""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.petsc_errors import python_errors

#: Attribute of a KSP in which petsc4py stores the user's convergence test, in all versions under
#: test. There is no getter.
CONVERGENCE_TEST = "__converged__"

#: Function of (iteration, ‖b − A x‖).
Monitor = Callable[[int, float], None]


class UserMonitors:
    """Calls the monitors of the user's KSP, and extends its history, in each iteration."""

    def __init__(self, ksp: PETSc.KSP) -> None:
        """Detect the callbacks, which may be set on one process alone. Collective.

        Args:
            ksp: The user's KSP.

        Raises:
            ValueError: It has a convergence test, which would never be called. On all processes.
        """
        self._ksp = ksp
        self._comm = ksp.comm.tompi4py()
        has_monitor = bool(ksp.getMonitor())
        has_test = ksp.getAttr(CONVERGENCE_TEST) is not None
        with_monitor, with_test = self._comm.allreduce(np.array([has_monitor, has_test], dtype=int))
        if with_test:
            raise ValueError(
                "ksp.setConvergenceTest has no effect: FETI stops by the residual and the "
                "estimated error of the assembled system. Leave it out, and set ksp_rtol, "
                "ksp_atol, ksp_max_it, or a monitor, which is called."
            )
        self._has_monitors = with_monitor > 0

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
