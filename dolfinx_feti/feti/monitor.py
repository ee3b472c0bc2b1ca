# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The iterations of a form as the KSP's monitors and history see them."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_feti.feti.solution import Monitor
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.petsc_errors import python_errors

__all__ = ["outer_monitor"]


def outer_monitor(ksp: PETSc.KSP) -> Callable[..., Monitor]:
    """Hand the inner iterations on to the monitors and the history of the outer KSP. Collective.

    Returns ``monitor_from(done, *, show_start)``, the monitor of a solve after ``done`` iterations.
    """
    comm = ksp.comm.tompi4py()
    # A monitor in Python, which may be set on one process alone, may raise there.
    users_own = comm.allreduce(bool(ksp.getMonitor()), op=MPI.LOR)

    def show(its: int, norm: float) -> None:
        with python_errors():
            ksp.monitor(its, norm)

    def monitor_from(done: int, *, show_start: bool) -> Monitor:
        def monitor(its: int, norm: float) -> None:
            if its > 0 or show_start:
                ksp.logConvergenceHistory(norm)
                if users_own:
                    on_all(lambda: show(done + its, norm), comm)
                else:
                    show(done + its, norm)

        return monitor

    return monitor_from
