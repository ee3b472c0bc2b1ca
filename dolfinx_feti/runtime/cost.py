# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The cost of a solver, time and memory, measured in the same way for all solvers.

Memory is the peak of a process above its memory with the assembled matrix, before the solver is
created. Temporary memory of the set-up is included.
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

#: Folder of Linux's figures of this process (proc(5)).
PROC = Path("/proc/self")

#: Text that resets the peak of memory when written to ``clear_refs`` (proc(5)).
RESET_PEAK = "5"


@dataclass(frozen=True, slots=True)
class Cost:
    """The cost of one solve.

    Attributes:
        seconds_setup: Time to create and set up the solver on the slowest process [s].
        seconds_solve: Time to solve for one right-hand side on the slowest process [s].
        peak_mib: Peak memory above that before the solver was created, summed over all processes
            [MiB]; NaN if the system does not report it.
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
        """Return freed memory to the system and reset the peak."""
        self._start = np.nan
        with contextlib.suppress(AttributeError):  # not the GNU C library
            ctypes.CDLL(None).malloc_trim(0)
        with contextlib.suppress(OSError):  # the peak cannot be reset
            (PROC / "clear_refs").write_text(RESET_PEAK)
            self._start = _memory_figure("VmRSS")

    def mib(self, comm: MPI.Comm) -> float:
        """Return the sum of the peaks of all processes [MiB], NaN if unknown. Collective.

        If the peak could not be reset, it is the peak since the start of the process.
        """
        return comm.allreduce(_memory_figure("VmHWM"))

    def mib_above_start(self, comm: MPI.Comm) -> float:
        """Return the sum of the peaks above the start [MiB], NaN if unknown. Collective."""
        above = np.maximum(_memory_figure("VmHWM") - self._start, 0.0)  # NaN if one of them is
        return comm.allreduce(float(above))


def measure(create: Callable[[], PETSc.KSP], b: PETSc.Vec) -> tuple[Cost, PETSc.Vec]:
    """Return the cost of one solve, and the solution; destroy the solver. Collective.

    Args:
        create: Creates the solver of a matrix that has been assembled before the call.
        b: Right-hand side.

    Returns:
        The cost, the same on all processes, and the solution, which the caller destroys.
    """
    x = b.duplicate()
    cost, ksp = timed_solve(create, b, x)
    ksp.destroy()
    return cost, x


def timed_solve(
    create: Callable[[], PETSc.KSP], b: PETSc.Vec, x: PETSc.Vec
) -> tuple[Cost, PETSc.KSP]:
    """Return the cost of one solve, and the solver. Collective.

    Args:
        create: Creates the solver, or returns one that has to be set up again.
        b: Right-hand side.
        x: The solution is written to it.

    Returns:
        The cost, the same on all processes, and the solver, which the caller destroys.
    """
    comm = b.comm.tompi4py()
    comm.Barrier()
    peak = PeakMemory()
    started = time.perf_counter()
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


def _memory_figure(name: str) -> float:
    """Return a memory figure of this process, such as VmHWM, [MiB]; NaN if it is not reported."""
    try:
        lines = (PROC / "status").read_text().splitlines()
    except OSError:
        return np.nan
    for line in lines:
        if line.startswith(name + ":"):
            return float(line.split()[1]) / 2**10  # reported in KiB
    return np.nan
