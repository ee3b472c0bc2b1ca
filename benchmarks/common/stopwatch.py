# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Seconds of set-up and of the Krylov method in each solve of a KSP."""

from __future__ import annotations

import time
from collections.abc import Callable

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

__all__ = ["CLOCKS", "Stopwatch"]

#: Processor time is that of one process alone, which other work on the machine hardly disturbs.
CLOCKS = {"wall": time.perf_counter, "processor": time.process_time}

Then = Callable[[PETSc.KSP, PETSc.Vec, PETSc.Vec], object]


class Stopwatch:
    """Measures the solves of a KSP, say those of Newton's method.

    What comes before the norm of the first residual is the set-up.
    """

    def __init__(self, comm: MPI.Comm, *, clock: str = "wall") -> None:
        """Begin with nothing.

        Args:
            comm: Its processes are synchronised when the time is read.
            clock: Key of :data:`CLOCKS`.
        """
        self._comm, self._clock = comm, CLOCKS[clock]
        self._begun = self._ready = 0.0
        self._solves: list[tuple[float, float]] = []  # set-up and Krylov method, here

    @property
    def solves(self) -> int:
        """Number of solves so far."""
        return len(self._solves)

    def hook(self, ksp: PETSc.KSP, then: Then | None = None) -> None:
        """Hook into a solver.

        Args:
            ksp: The solver.
            then: Called after each solve with the solver, b and x; its time does not count.
        """

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
        """Return the seconds of set-up and Krylov method of each solve, (solves, 2).

        Those of the slowest process.

        Note:
            Collective.
        """
        own = np.array(self._solves).reshape(-1, 2)
        slowest = np.empty_like(own)
        self._comm.Allreduce(own, slowest, op=MPI.MAX)
        return slowest

    def seconds(self) -> tuple[float, float]:
        """Return the seconds of all set-ups and of all Krylov methods.

        Note:
            Collective.
        """
        setup, krylov = map(float, self.each().sum(axis=0))
        return setup, krylov

    def _now(self) -> float:
        self._comm.Barrier()
        return self._clock()
