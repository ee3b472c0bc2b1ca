# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI beside other solvers: the same linear system, and the same measure of time and memory.

FETI solves with the torn matrix, others with the assembled one that PETSc converts from it. What a
solver takes of memory is the largest amount above what was in use when it began. Torn and assembled
matrix exist before and count for nobody; whatever a solver makes of them counts, and also what it
frees again before it ends.

Example::

    problem = dolfinx_feti.LinearProblem(a, L, bcs=[bc], subdomains=64, …)
    u = problem.solve()
    K, f = assembled_system(problem.A, problem.b)
    cost, x = measure(lambda: create_mumps(K), f)
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

from dolfinx_feti.torn import is_symmetric

__all__ = [
    "Cost",
    "PeakMemory",
    "assembled_system",
    "create_mumps",
    "measure",
    "record_cost",
    "relative_residual",
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


def assembled_system(A: PETSc.Mat, b: PETSc.Vec) -> tuple[PETSc.Mat, PETSc.Vec]:
    r"""Convert a torn matrix and its right-hand side to the assembled system that FETI solves.

    .. math:: K = \begin{pmatrix} A_{FF} & 0 \\ 0 & I \end{pmatrix}, \qquad
        f = \begin{pmatrix} b_F - A_{FD}\, b_D \\ b_D \end{pmatrix}

    with the free dofs F and the Dirichlet dofs D, on which b holds the prescribed values.

    Args:
        A: Torn matrix (MATIS).
        b: Right-hand side, (N,).

    Returns:
        K, (N, N), marked as symmetric if it is and with the near kernel of A, and f, (N,). The
        caller destroys them.

    Note:
        Collective.
    """
    K, f = PETSc.Mat(), b.copy()
    A.convert(PETSc.Mat.Type.AIJ, K)
    dirichlet = A.query("dirichlet")
    if dirichlet is not None:
        K.zeroRowsColumns(dirichlet.getIndices(), 1.0, b, f)
    K.setOption(PETSc.Mat.Option.SYMMETRIC, is_symmetric(K))
    near_kernel = A.getNearNullSpace()
    if near_kernel.handle:
        K.setNearNullSpace(near_kernel)
    return K, f


def create_mumps(K: PETSc.Mat) -> PETSc.KSP:
    """Create a direct solver, MUMPS on all processes of the matrix.

    Args:
        K: Assembled matrix. If it is marked as symmetric the factorisation is, too.

    Returns:
        The KSP, with the prefix ``mumps_``; the caller destroys it.
    """
    ksp = PETSc.KSP().create(K.comm)
    ksp.setOptionsPrefix("mumps_")
    ksp.setOperators(K)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    pc = ksp.getPC()
    pc.setType(PETSc.PC.Type.CHOLESKY if all(K.isSymmetricKnown()) else PETSc.PC.Type.LU)
    pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    pc.setFactorSetUpSolverType()
    pc.getFactorMatrix().setMumpsIcntl(14, 50)  # work space in per cent, or it fails on 2 processes
    ksp.setFromOptions()
    return ksp


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


def relative_residual(K: PETSc.Mat, f: PETSc.Vec, x: PETSc.Vec) -> float:
    """Return ‖f − K x‖/‖f‖.

    Note:
        Collective.
    """
    r = f.duplicate()
    K.mult(x, r)
    r.aypx(-1.0, f)  # r = f − K x
    norm = r.norm()
    r.destroy()
    return norm / f.norm()


def _status(name: str) -> float:
    """Return a size of this process [MiB]; nan where the system does not tell."""
    try:
        lines = (PROC / "status").read_text().splitlines()
    except OSError:
        return np.nan
    return next((float(s.split()[1]) / 2**10 for s in lines if s.startswith(name + ":")), np.nan)
