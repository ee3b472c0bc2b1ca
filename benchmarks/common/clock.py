# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Where the time of a FETI solve goes: assembly, set-up and its phases, solution."""

from __future__ import annotations

import time

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.events import seconds_of

__all__ = ["Clock"]

#: Log events, and the names of their seconds in a record.
EVENTS = {
    "FETIGluing": "gluing",
    "FETIFactor": "factor",
    "FETICoarse": "coarse",
    "FETIIterations": "iterations",
}


class Clock:
    """Wall-clock and processor time before set-up, between set-up and solution, and after it."""

    def __init__(self, comm: MPI.Comm) -> None:
        """Begin.

        Args:
            comm: Its processes are synchronised when the time is read.
        """
        self._comm = comm
        PETSc.Log.begin()
        self._events = np.array(seconds_of(EVENTS))
        self._times = [self._now()]

    def watch(self, ksp: PETSc.KSP) -> None:
        """Hook into a solver; it is set up before its first solution."""

        def before(ksp: PETSc.KSP, _b: PETSc.Vec, _x: PETSc.Vec) -> None:
            self._times.append(self._now())
            ksp.setUp()
            self._times.append(self._now())

        def after(_ksp: PETSc.KSP, _b: PETSc.Vec, _x: PETSc.Vec) -> None:
            self._times.append(self._now())

        ksp.setPreSolve(before)
        ksp.setPostSolve(after)

    def record(self) -> dict[str, float]:
        """Return the seconds of assembly, set-up and solution, and of their phases.

        The seconds of a phase are those of the slowest process.

        Note:
            Collective.
        """
        wall, processor = np.diff(np.array(self._times), axis=0).T
        phases = ("assembly", "setup", "solve")
        names = [f"{kind}_{phase}" for kind in ("seconds", "cpu_seconds") for phase in phases]
        values = [*wall, *self._comm.allreduce(processor)]
        names += [f"seconds_{phase}" for phase in EVENTS.values()]
        spent = np.array(seconds_of(EVENTS)) - self._events
        values += [self._comm.allreduce(float(seconds), op=MPI.MAX) for seconds in spent]
        return dict(zip(names, map(float, values), strict=True))

    def _now(self) -> tuple[float, float]:
        self._comm.Barrier()
        return time.perf_counter(), time.process_time()
