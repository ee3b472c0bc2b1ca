# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI beside MUMPS on the first linear system of a nonlinear problem."""

from __future__ import annotations

import ctypes
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from petsc4py import PETSc

from dolfinx_feti import NonlinearProblem

__all__ = ["Cost", "FirstStep"]


@dataclass(frozen=True, slots=True)
class Cost:
    """What a solver cost.

    Attributes:
        seconds_setup: Time for factors and whatever else precedes the right-hand side.
        seconds_solve: Time for the solution.
        peak_mib: Largest memory above what was in use before, over all processes.
        iterations: Krylov iterations.
        relative_residual: ‖b − K x‖/‖b‖.
    """

    seconds_setup: float
    seconds_solve: float
    peak_mib: float
    iterations: int
    relative_residual: float


class FirstStep:
    """Keeps the first linear system that a problem solves, with FETI's solution of it.

    Two hooks of the KSP do it, one before set-up and solution and one behind them.
    """

    def __init__(self, problem: NonlinearProblem) -> None:
        """Hook into the problem's KSP and begin to watch the memory."""
        ksp = problem.solver.getKSP()
        self.comm = ksp.comm.tompi4py()
        self._K: PETSc.Mat | None = None
        self._times: list[float] = []
        self._peak = PeakMemory()
        self._peak.begin()
        ksp.setPreSolve(self._before)
        ksp.setPostSolve(self._after)

    def _before(self, ksp: PETSc.KSP, _b: PETSc.Vec, _x: PETSc.Vec) -> None:
        if self._K is None:
            self._times = [time.perf_counter()]
            ksp.setUp()
            self._times.append(time.perf_counter())

    def _after(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        if self._K is None:
            self._times.append(time.perf_counter())
            self._peak.end()
            self._b, self._x = b.copy(), x.copy()
            self._iterations = ksp.getIterationNumber()
            self._K = assembled_matrix(ksp.getOperators()[0])

    def feti(self) -> Cost:
        """Return what FETI cost.

        Note:
            Collective.
        """
        return self._cost(self._times, self._iterations, self._x)

    def mumps(self) -> tuple[Cost, float]:
        """Solve the same system with a Cholesky factorisation by MUMPS.

        Returns:
            What it cost, and the relative difference of FETI's solution to this one.

        Note:
            Collective.
        """
        self.comm.Barrier()
        self._peak.begin()
        times = [time.perf_counter()]
        ksp = create_mumps(self._K)
        ksp.setUp()
        times.append(time.perf_counter())
        x = self._b.duplicate()
        ksp.solve(self._b, x)
        times.append(time.perf_counter())
        self._peak.end()
        ksp.destroy()
        cost = self._cost(times, 1, x)
        scale = x.norm()
        x.axpy(-1.0, self._x)
        return cost, x.norm() / scale

    def _cost(self, times: list[float], iterations: int, x: PETSc.Vec) -> Cost:
        r = self._b.duplicate()
        self._K.mult(x, r)
        r.axpy(-1.0, self._b)
        return Cost(
            seconds_setup=times[1] - times[0],
            seconds_solve=times[2] - times[1],
            peak_mib=self.comm.allreduce(self._peak.mib),
            iterations=iterations,
            relative_residual=r.norm() / self._b.norm(),
        )


def assembled_matrix(A: PETSc.Mat) -> PETSc.Mat:
    """Convert a torn matrix to the assembled one, with unit rows and columns at Dirichlet dofs."""
    K = PETSc.Mat()
    A.convert("aij", K)
    K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    K.zeroRowsColumns(A.query("dirichlet").getIndices(), 1.0)
    return K


def create_mumps(K: PETSc.Mat) -> PETSc.KSP:
    """Return a direct solver, MUMPS's symmetric factorisation."""
    ksp = PETSc.KSP().create(K.comm)
    ksp.setOptionsPrefix("mumps_")
    ksp.setOperators(K)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    pc = ksp.getPC()
    pc.setType(PETSc.PC.Type.CHOLESKY)
    pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    pc.setFactorSetUpSolverType()
    pc.getFactorMatrix().setMumpsIcntl(14, 50)  # work space in per cent, or it fails on 2 processes
    ksp.setFromOptions()
    return ksp


class PeakMemory:
    """Samples the resident memory of this process; `mib` is the most above the beginning."""

    def begin(self) -> None:
        """Give free memory back and begin."""
        try:
            ctypes.CDLL(None).malloc_trim(0)
        except AttributeError:
            pass  # another C library than GNU's
        self.mib, self._start = 0.0, _resident_mib()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop sampling."""
        self._done.set()
        self._thread.join()

    def _sample(self) -> None:
        while not self._done.wait(0.02):
            self.mib = max(self.mib, _resident_mib() - self._start)


def _resident_mib() -> float:
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:  # no Linux
        return 0.0
    return pages * 4096 / 2**20
