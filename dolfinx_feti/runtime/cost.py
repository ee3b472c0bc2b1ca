# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The cost of a solver: the same measure of time and memory for all solvers.

Memory is the peak above what was in use before, when the matrix existed: all that a solver
allocates counts, including what it frees again before it ends.
"""

from __future__ import annotations

import contextlib
import ctypes
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

PROC = Path("/proc/self")


@dataclass(frozen=True, slots=True)
class Cost:
    """The cost of one solve.

    Attributes:
        seconds_setup: Time for the factors and everything else that needs no right-hand side, on
            the slowest process.
        seconds_solve: Time for the solution, likewise.
        peak_mib: Peak memory above what was in use before, summed over all processes [MiB]; nan
            where the system does not report it.
        iterations: Krylov iterations.
        converged_reason: PETSc's reason, negative if it failed.
    """

    seconds_setup: float
    seconds_solve: float
    peak_mib: float
    iterations: int
    converged_reason: int


class PeakMemory:
    """The peak memory of each process since this object was created, as Linux records it."""

    def __init__(self) -> None:
        """Return free memory to the system and reset its peak."""
        self._start = np.nan
        with contextlib.suppress(AttributeError):  # not the GNU C library
            ctypes.CDLL(None).malloc_trim(0)
        with contextlib.suppress(OSError):  # the peak cannot be reset
            (PROC / "clear_refs").write_text("5")
            self._start = _status("VmRSS")

    def mib(self, comm: MPI.Comm) -> float:
        """Return the sum of all processes' peaks [MiB], nan if unknown. Collective.

        Where the peak cannot be reset, it is that of the whole run.
        """
        return comm.allreduce(_status("VmHWM"))

    def mib_above_start(self, comm: MPI.Comm) -> float:
        """Return the sum of the peaks above the first memory [MiB], nan if unknown. Collective."""
        return comm.allreduce(max(_status("VmHWM") - self._start, 0.0))


def measure(create: Callable[[], PETSc.KSP], b: PETSc.Vec) -> tuple[Cost, PETSc.Vec]:
    """Create a solver for a matrix that exists, set it up, solve for b, and destroy it. Collective.

    Returns:
        The cost and the solution, which belongs to the caller.
    """
    x = b.duplicate()
    cost, ksp = timed_solve(create, b, x)
    ksp.destroy()
    return cost, x


def timed_solve(
    create: Callable[[], PETSc.KSP], b: PETSc.Vec, x: PETSc.Vec
) -> tuple[Cost, PETSc.KSP]:
    """Create a solver, set it up and solve for b.

    Args:
        create: Creates the solver, or returns one that is to be set up anew.
        b: Right-hand side.
        x: Takes the solution.

    Returns:
        The cost, the same on all processes, and the solver, which belongs to the caller.

    Note:
        Collective.
    """
    comm = b.comm.tompi4py()
    comm.Barrier()
    peak, started = PeakMemory(), time.perf_counter()
    ksp = create()
    ksp.setUp()
    set_up = time.perf_counter()
    ksp.solve(b, x)
    solved = time.perf_counter()
    cost = Cost(
        seconds_setup=comm.allreduce(set_up - started, op=MPI.MAX),
        seconds_solve=comm.allreduce(solved - set_up, op=MPI.MAX),
        peak_mib=peak.mib_above_start(comm),
        iterations=ksp.getIterationNumber(),
        converged_reason=ksp.getConvergedReason(),
    )
    return cost, ksp


def _status(name: str) -> float:
    """Return a memory figure of this process [MiB]; nan where the system does not report it."""
    try:
        lines = (PROC / "status").read_text().splitlines()
    except OSError:
        return np.nan
    return next((float(s.split()[1]) / 2**10 for s in lines if s.startswith(name + ":")), np.nan)
