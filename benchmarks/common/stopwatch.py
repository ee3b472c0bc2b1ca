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

__all__ = ["Stopwatch"]

#: Log event of what follows the set-up.
EVENT = "FETISolve"

Then = Callable[[PETSc.KSP, PETSc.Vec, PETSc.Vec], object]


class Stopwatch:
    """Measures the solves of a KSP with a FETI context, say those of Newton's method."""

    def __init__(self, comm: MPI.Comm) -> None:
        """Begin with nothing.

        Args:
            comm: Its processes are synchronised when the time is read.
        """
        PETSc.Log.begin()
        self._comm = comm
        self._begun = (0.0, 0.0)
        self._solves: list[tuple[float, float]] = []  # the whole and the Krylov method, here

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
            self._begun = self._now()

        def after(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
            whole, krylov = np.subtract(self._now(), self._begun)
            self._solves.append((whole, krylov))
            if then is not None:
                then(ksp, b, x)

        ksp.setPreSolve(before)
        ksp.setPostSolve(after)

    def each(self) -> npt.NDArray[np.float64]:
        """Return the seconds of set-up and Krylov method of each solve, (solves, 2).

        Note:
            Collective.
        """
        own = np.array(self._solves).reshape(-1, 2)
        slowest = np.empty_like(own)
        self._comm.Allreduce(own, slowest, op=MPI.MAX)
        whole, krylov = slowest.T
        return np.column_stack([np.maximum(0.0, whole - krylov), krylov])

    def seconds(self) -> tuple[float, float]:
        """Return the seconds of all set-ups and of all Krylov methods.

        Note:
            Collective.
        """
        setup, krylov = map(float, self.each().sum(axis=0))
        return setup, krylov

    def _now(self) -> tuple[float, float]:
        """Return the time, and the seconds of Krylov methods so far."""
        self._comm.Barrier()
        return time.perf_counter(), float(PETSc.Log.Event(EVENT).getPerfInfo()["time"])
