# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Seconds of set-up and of the Krylov method, summed over the solves of a KSP.

One process is timed by its processor time, which other work on the machine hardly disturbs; several
processes, which wait for each other, by the clock on the wall.
"""

from __future__ import annotations

import time

from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["Stopwatch"]


class Stopwatch:
    """Measures the solves of a KSP, say those of Newton's method.

    What comes before the norm of the first residual is the set-up.

    Attributes:
        solves: Number of solves so far.
        clock: ``processor`` or ``wall``.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        """Begin with nothing.

        Args:
            comm: Its processes are synchronised when the time is read.
        """
        self._comm = comm
        self._setup = self._krylov = 0.0
        self._begun = self._ready = 0.0
        self.solves = 0
        self.clock = "processor" if comm.size == 1 else "wall"

    def hook(self, ksp: PETSc.KSP) -> None:
        """Hook into a solver."""

        def before(_ksp: PETSc.KSP, _b: PETSc.Vec, _x: PETSc.Vec) -> None:
            self._begun = self._ready = self._now()

        def monitor(_ksp: PETSc.KSP, iteration: int, _norm: float) -> None:
            if iteration == 0:
                self._ready = self._now()

        def after(_ksp: PETSc.KSP, _b: PETSc.Vec, _x: PETSc.Vec) -> None:
            self._setup += self._ready - self._begun
            self._krylov += self._now() - self._ready
            self.solves += 1

        ksp.setPreSolve(before)
        ksp.setMonitor(monitor)
        ksp.setPostSolve(after)

    def seconds(self) -> tuple[float, float]:
        """Return the seconds of all set-ups and of all Krylov methods, of the slowest process.

        Note:
            Collective.
        """
        setup, krylov = (
            self._comm.allreduce(part, op=MPI.MAX) for part in (self._setup, self._krylov)
        )
        return float(setup), float(krylov)

    def _now(self) -> float:
        if self.clock == "processor":
            return time.process_time()
        self._comm.Barrier()
        return time.perf_counter()
