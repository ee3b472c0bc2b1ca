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
Then = Callable[[PETSc.KSP, PETSc.Vec, PETSc.Vec], object]


def event_clock(names: Sequence[str], comm: MPI.Comm) -> Callable[[], dict[str, float]]:
    """Return a function that returns the seconds of PETSc's log events from now on.

    Both are collective.

    Args:
        names: Names of the events.
        comm: Communicator; the seconds are those of its slowest process.
    """
    PETSc.Log.begin()
    begun = np.array(seconds_of(names))

    def seconds() -> dict[str, float]:
        spent = np.array(seconds_of(names)) - begun
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
        self._times: list[Array] = []  # begun, ready, ended; clock, processor
        self._begun = self._ready = np.zeros(2)

    def hook(self, ksp: PETSc.KSP, then: Then | None = None) -> None:
        """Hook into a solver; ``then`` is called after each solve, and its time does not count."""

        def before(_ksp: PETSc.KSP, _b: PETSc.Vec, _x: PETSc.Vec) -> None:
            self._begun = self._ready = self._now()

        def monitor(_ksp: PETSc.KSP, iteration: int, _norm: float) -> None:
            if iteration == 0:
                self._ready = self._now()

        def after(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
            self._times.append(np.diff([self._begun, self._ready, self._now()], axis=0))
            if then is not None:
                then(ksp, b, x)

        ksp.setPreSolve(before)
        ksp.setMonitor(monitor)
        ksp.setPostSolve(after)

    def each(self) -> Array:
        """Return the slowest process's seconds of each solve, (solves, 2). Collective."""
        return self._over_all(0, MPI.MAX)

    def processor(self) -> Array:
        """Return all processes' processor time of each solve, (solves, 2). Collective."""
        return self._over_all(1, MPI.SUM)

    def _over_all(self, clock: int, op: MPI.Op) -> Array:
        own = np.ascontiguousarray(np.array(self._times).reshape(-1, 2, 2)[:, :, clock])
        found = np.empty_like(own)
        self._comm.Allreduce(own, found, op=op)
        return found

    def _now(self) -> Array:
        self._comm.Barrier()
        return np.array([time.perf_counter(), time.process_time()])
