# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Seconds of a FETI solver: of its phases, by PETSc's log, and of its solves, by the clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.events import seconds_of

__all__ = ["CLOCKS", "Clock", "Events", "Stopwatch"]

#: Phases of a linear solve in a record, and their log events.
PHASES = {
    "gluing": "FETIGluing",
    "factor": "FETIFactor",
    "coarse": "FETICoarse",
    "iterations": "FETIIterations",
}

#: Processor time is that of one process alone, which other work on the machine hardly disturbs.
CLOCKS = {"wall": time.perf_counter, "processor": time.process_time}

Then = Callable[[PETSc.KSP, PETSc.Vec, PETSc.Vec], object]


class Events:
    """Seconds of PETSc's log events since this object was created."""

    def __init__(self, names: Iterable[str], comm: MPI.Comm) -> None:
        """Begin; PETSc's logging is begun if it is not."""
        PETSc.Log.begin()
        self._names, self._comm = list(names), comm
        self._begun = np.array(seconds_of(self._names))

    def seconds(self) -> dict[str, float]:
        """Return the seconds of each event, those of the slowest process. Collective."""
        spent = np.array(seconds_of(self._names)) - self._begun
        slowest = np.empty_like(spent)
        self._comm.Allreduce(spent, slowest, op=MPI.MAX)
        return dict(zip(self._names, slowest.tolist(), strict=True))


class Clock:
    """Wall-clock and processor time before set-up, between set-up and solution, and after it."""

    def __init__(self, comm: MPI.Comm) -> None:
        """Begin; the processes are synchronised when the time is read."""
        self._comm = comm
        self._events = Events(PHASES.values(), comm)
        self._times = [self._now()]

    def watch(self, ksp: PETSc.KSP) -> None:
        """Hook into a solver; it is set up before its first solution."""

        def before(ksp: PETSc.KSP, _b: PETSc.Vec, _x: PETSc.Vec) -> None:
            self._times.append(self._now())
            ksp.setUp()
            self._times.append(self._now())

        ksp.setPreSolve(before)
        ksp.setPostSolve(lambda *_: self._times.append(self._now()))

    def record(self) -> dict[str, float]:
        """Return the seconds of assembly, set-up and solution, and of their phases. Collective."""
        wall, processor = np.diff(np.array(self._times), axis=0).T
        parts = ("assembly", "setup", "solve")
        found = {f"seconds_{name}": float(s) for name, s in zip(parts, wall, strict=True)}
        used = self._comm.allreduce(processor)
        found |= {f"cpu_seconds_{name}": float(s) for name, s in zip(parts, used, strict=True)}
        spent = self._events.seconds()
        return found | {f"seconds_{name}": spent[event] for name, event in PHASES.items()}

    def _now(self) -> tuple[float, float]:
        self._comm.Barrier()
        return time.perf_counter(), time.process_time()


class Stopwatch:
    """Set-up and Krylov method of each solve of a KSP, say of those of Newton's method.

    What comes before the norm of the first residual is the set-up.
    """

    def __init__(self, comm: MPI.Comm, *, clock: str = "wall") -> None:
        """Begin with nothing; ``clock`` is a key of :data:`CLOCKS`."""
        self._comm, self._clock = comm, CLOCKS[clock]
        self._begun = self._ready = 0.0
        self._solves: list[tuple[float, float]] = []  # set-up and Krylov method, here

    def hook(self, ksp: PETSc.KSP, then: Then | None = None) -> None:
        """Hook into a solver; ``then`` is called after each solve, and its time does not count."""

        def before(_ksp: PETSc.KSP, _b: PETSc.Vec, _x: PETSc.Vec) -> None:
            self._begun = self._ready = self._now()

        def monitor(_ksp: PETSc.KSP, iteration: int, _norm: float) -> None:
            if iteration == 0:
                self._ready = self._now()

        def after(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
            self._solves.append((self._ready - self._begun, self._now() - self._ready))
            if then is not None:
                then(ksp, b, x)

        ksp.setPreSolve(before)
        ksp.setMonitor(monitor)
        ksp.setPostSolve(after)

    def each(self) -> npt.NDArray[np.float64]:
        """Return the slowest process's seconds of each solve, (solves, 2). Collective."""
        own = np.array(self._solves).reshape(-1, 2)
        slowest = np.empty_like(own)
        self._comm.Allreduce(own, slowest, op=MPI.MAX)
        return slowest

    def _now(self) -> float:
        self._comm.Barrier()
        return self._clock()
