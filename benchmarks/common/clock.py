# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Seconds of a FETI solver: of its phases, by PETSc's log, and of its solves, by the clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.events import seconds_of

#: Called after a solve with the KSP, the right-hand side and the solution.
AfterSolve = Callable[[PETSc.KSP, PETSc.Vec, PETSc.Vec], object]


def event_clock(names: Sequence[str], comm: MPI.Comm) -> Callable[[], dict[str, float]]:
    """Return a function that returns the seconds of PETSc's log events from now on.

    Both are collective.

    Args:
        names: Names of the events.
        comm: Communicator; the seconds are those of its slowest process.
    """
    PETSc.Log.begin()
    start = np.array(seconds_of(names))

    def seconds() -> dict[str, float]:
        spent = np.array(seconds_of(names)) - start
        slowest = np.empty_like(spent)
        comm.Allreduce(spent, slowest, op=MPI.MAX)
        return dict(zip(names, slowest.tolist(), strict=True))

    return seconds


class Stopwatch:
    """Times of set-up and Krylov method for each solve of a KSP, such as that of Newton's method.

    The set-up ends when the KSP monitors the norm of the first residual. Other work on the machine
    disturbs processor time less than the clock.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        """Create a stopwatch without times."""
        self._comm = comm
        self._times: list[Array] = []  # of each solve (2, 2): set-up, solution; clock, processor
        self._started = self._ready = np.zeros(2)

    def hook(self, ksp: PETSc.KSP, then: AfterSolve | None = None) -> None:
        """Time the solves of a KSP from now on; its own hooks and monitor are replaced.

        Args:
            ksp: The solver.
            then: Called after each solve; its time does not count.
        """

        def before(_ksp: PETSc.KSP, _b: PETSc.Vec, _x: PETSc.Vec) -> None:
            self._started = self._ready = self._now()

        def monitor(_ksp: PETSc.KSP, iteration: int, _norm: float) -> None:
            if iteration == 0:
                self._ready = self._now()

        def after(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
            self._times.append(np.diff([self._started, self._ready, self._now()], axis=0))
            if then is not None:
                then(ksp, b, x)

        ksp.setPreSolve(before)
        ksp.setMonitor(monitor)
        ksp.setPostSolve(after)

    def wall_times(self) -> Array:
        """Return the wall time of set-up and solution of each solve, (solves, 2) [s]. Collective.

        It is that of the slowest process.
        """
        return self._over_all(0, MPI.MAX)

    def processor_times(self) -> Array:
        """Return the processor time of set-up and solution of each solve, (solves, 2) [s].

        It is summed over the processes. Collective.
        """
        return self._over_all(1, MPI.SUM)

    def _over_all(self, clock: int, op: MPI.Op) -> Array:
        """Return a clock's times of all solves, (solves, 2), reduced over the processes."""
        of_process = np.ascontiguousarray(np.array(self._times).reshape(-1, 2, 2)[:, :, clock])
        reduced = np.empty_like(of_process)
        self._comm.Allreduce(of_process, reduced, op=op)
        return reduced

    def _now(self) -> Array:
        """Return clock and processor time, (2,), once all processes are here."""
        self._comm.Barrier()
        return np.array([time.perf_counter(), time.process_time()])
