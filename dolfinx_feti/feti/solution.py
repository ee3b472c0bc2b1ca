# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a solve in either form of the method ends with, and what it tells on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.petsc_errors import python_errors

#: Called with (iteration, norm of the residual of the assembled system).
Monitor = Callable[[int, float], None]

#: Reasons for which CG ends when a quadratic form is negative.
CURVATURE = (
    PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT,
    PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC,
)

#: Iterations after which GMRES begins anew, as it keeps a vector or two for each.
RESTART = 200

#: Iterations without a new least residual that end a solve, for a fresh start.
STAGNATION = 200


@dataclass(frozen=True, slots=True)
class RitzVectors:
    """What a solve in the primal form leaves to later ones, by copies of the interface dofs.

    Attributes:
        W: Ritz vectors, (n, k).
        Q: M⁻¹ W, with the M of the solves that W came from, (n, k).
    """

    W: Array
    Q: Array


@dataclass(frozen=True, slots=True)
class Solution:
    """How a solve has ended.

    Attributes:
        reason: PETSc's converged reason.
        iterations: Number of iterations.
        eigenvalues: Extreme Ritz values of CG, (λ_min, λ_max); nan for other methods.
        ritz_vectors: What a solve in the primal form leaves to later ones.
        residual: ‖b − A x‖/‖b − A x_D‖; nan where it is not measured.
        rtol: Its largest value that the tolerances allow, likewise.
        floor: What rounding leaves of it, if that has ended the solve; else nan.
    """

    reason: int
    iterations: int = 0
    eigenvalues: tuple[float, float] = (np.nan, np.nan)
    ritz_vectors: RitzVectors | None = None
    residual: float = np.nan
    rtol: float = np.nan
    floor: float = np.nan


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
