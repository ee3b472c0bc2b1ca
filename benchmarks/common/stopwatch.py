# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Seconds of set-up and of the Krylov method, summed over the solves of a KSP."""

from __future__ import annotations

import time

from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["Stopwatch"]

#: Log event of what follows the set-up.
EVENT = "FETISolve"


class Stopwatch:
    """Measures the solves of a KSP with a FETI context, say those of Newton's method.

    Attributes:
        solves: Number of solves so far.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        """Begin with nothing.

        Args:
            comm: Its processes are synchronised when the time is read.
        """
        PETSc.Log.begin()
        self._comm = comm
        self._whole = self._begun = 0.0
        self._before = _seconds()
        self.solves = 0

    def hook(self, ksp: PETSc.KSP) -> None:
        """Hook into a solver."""

        def before(_ksp: PETSc.KSP, _b: PETSc.Vec, _x: PETSc.Vec) -> None:
            self._begun = self._now()

        def after(_ksp: PETSc.KSP, _b: PETSc.Vec, _x: PETSc.Vec) -> None:
            self._whole += self._now() - self._begun
            self.solves += 1

        ksp.setPreSolve(before)
        ksp.setPostSolve(after)

    def seconds(self) -> tuple[float, float]:
        """Return the seconds of all set-ups and of all Krylov methods.

        Note:
            Collective.
        """
        krylov = self._comm.allreduce(_seconds() - self._before, op=MPI.MAX)
        return max(0.0, self._whole - krylov), krylov

    def _now(self) -> float:
        self._comm.Barrier()
        return time.perf_counter()


def _seconds() -> float:
    return float(PETSc.Log.Event(EVENT).getPerfInfo()["time"])
