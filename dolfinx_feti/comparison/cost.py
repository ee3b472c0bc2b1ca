# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a solver costs: the same measure of time and memory for all of them.

What a solver takes of memory is the largest amount above what was in use when it began. Torn and
assembled matrix exist before and count for nobody; whatever a solver makes of them counts, and also
what it frees again before it ends.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

__all__ = [
    "Cost",
    "PeakMemory",
    "measure",
    "record_cost",
]

PROC = Path("/proc/self")


@dataclass(frozen=True, slots=True)
class Cost:
    """What a solver cost.

    Attributes:
        seconds_setup: Time for factors and whatever else needs no right-hand side, of the slowest
            process.
        seconds_solve: Time for the solution, likewise.
        peak_mib: Most memory above what was in use before, over all processes [MiB]; nan where the
            system does not tell.
        iterations: Krylov iterations.
        converged_reason: PETSc's reason, negative if it failed.
    """

    seconds_setup: float
    seconds_solve: float
    peak_mib: float
    iterations: int
    converged_reason: int


class PeakMemory:
    """The most memory that each process has had since this was made, by the kernel's own mark."""

    def __init__(self) -> None:
        """Give free memory back and put the mark down."""
        try:
            ctypes.CDLL(None).malloc_trim(0)
        except AttributeError:
            pass  # another C library than GNU's
        self._start = np.nan
        try:
            (PROC / "clear_refs").write_text("5")
            self._start = _status("VmRSS")
        except OSError:
            pass  # the mark stays where it is

    def mib(self, comm: MPI.Comm) -> float:
        """Return the sum of all processes' peaks [MiB]; nan where the system does not tell.

        Where the mark cannot be put down it is the peak of the whole run.

        Note:
            Collective.
        """
        return comm.allreduce(_status("VmHWM"))

    def mib_above_start(self, comm: MPI.Comm) -> float:
        """Return by how much the peaks are above the beginning [MiB]; nan if that is not known.

        Note:
            Collective.
        """
        return comm.allreduce(max(_status("VmHWM") - self._start, 0.0))


def measure(create: Callable[[], PETSc.KSP], b: PETSc.Vec) -> tuple[Cost, PETSc.Vec]:
    """Create a solver, set it up and solve with it.

    Args:
        create: Creates the solver; the matrix exists before.
        b: Right-hand side.

    Returns:
        What it cost, and the solution. The solver is destroyed, the solution is the caller's.

    Note:
        Collective.
    """
    comm = b.comm.tompi4py()
    x = b.duplicate()
    comm.Barrier()
    peak = PeakMemory()
    times = [time.perf_counter()]
    ksp = create()
    ksp.setUp()
    times.append(time.perf_counter())
    ksp.solve(b, x)
    times.append(time.perf_counter())
    cost = record_cost(ksp, times, peak)
    ksp.destroy()
    return cost, x


def record_cost(ksp: PETSc.KSP, times: Sequence[float], peak: PeakMemory) -> Cost:
    """Take down what a solver cost, equal on all processes.

    Args:
        ksp: The solver.
        times: Time of this process before set-up, after it and after the solution [s].
        peak: Made before set-up.

    Note:
        Collective.
    """
    comm = ksp.comm.tompi4py()
    started, set_up, solved = times
    return Cost(
        seconds_setup=comm.allreduce(set_up - started, op=MPI.MAX),
        seconds_solve=comm.allreduce(solved - set_up, op=MPI.MAX),
        peak_mib=peak.mib_above_start(comm),
        iterations=ksp.getIterationNumber(),
        converged_reason=ksp.getConvergedReason(),
    )


def _status(name: str) -> float:
    """Return a size of this process [MiB]; nan where the system does not tell."""
    try:
        lines = (PROC / "status").read_text().splitlines()
    except OSError:
        return np.nan
    return next((float(s.split()[1]) / 2**10 for s in lines if s.startswith(name + ":")), np.nan)
