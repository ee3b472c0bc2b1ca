# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The iterations of a form as the KSP's monitors and history see them."""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc

from dolfinx_feti.collective import on_all
from dolfinx_feti.petsc_errors import python_errors

__all__ = ["outer_monitor"]


def outer_monitor(ksp: PETSc.KSP, done: int, *, first: bool) -> Callable[[int, float], None]:
    """Hand the inner iterations on to the monitors and the history of the outer KSP.

    Args:
        ksp: The outer KSP.
        done: Iterations before this inner solve.
        first: Whether the start is still to be shown.
    """
    users_own = bool(ksp.getMonitor())  # in Python, which may raise on one process alone
    comm = ksp.comm.tompi4py()

    def show(its: int, norm: float) -> None:
        with python_errors():
            ksp.monitor(done + its, norm)

    def monitor(its: int, norm: float) -> None:
        if its > 0 or first:
            ksp.logConvergenceHistory(norm)
            if users_own:
                on_all(lambda: show(its, norm), comm)
            else:
                ksp.monitor(done + its, norm)

    return monitor
