# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A small distributed system, of which every few processes hold a copy.

The coarse matrix N has a few rows per subdomain. Spread over all processes it is mostly messages;
on one of them it would have all others send to that one and wait for it. So each group of
processes, one for about :data:`ROWS` rows, factors N for itself: a solve is one collective call
that gives the right-hand side to all, and each process takes what it needs from its own group. What
fails in a factorisation fails on all processes.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.collective import on_all, reason
from dolfinx_feti.errors import FactorError, SetUpError
from dolfinx_feti.events import event
from dolfinx_feti.feti.subdomain.direct import (
    WORK_SPACE,
    Pivots,
    failure,
    mebibytes,
    pivots_of,
    prepare_mumps,
    set_zero_pivot,
)

__all__ = ["GatheredSolver"]

#: Rows that are worth a process.
ROWS = 4000


class GatheredSolver:
    """Direct solver for a matrix that is gathered in each group of processes.

    Attributes:
        ksp: The solver of the process's group; None if there are no rows.
    """

    def __init__(
        self, N: PETSc.Mat, *, prefix: str, symmetric: bool, zero: float | None = None
    ) -> None:
        """Gather the rows and factor.

        Args:
            N: Matrix, (K, K), distributed anyhow.
            prefix: Options prefix of the solver.
            symmetric: Whether N is symmetric (Cholesky) or not (LU).
            zero: MUMPS takes a pivot below this multiple of the norm of N for zero, and solves
                without its row and column; None for exact zeros only.

        Raises:
            SetUpError: The options are wrong, or the factorisation failed; on all processes.

        Note:
            Collective.
        """
        comm, total = N.comm.tompi4py(), N.getSize()[0]
        self._world, self._own = comm, slice(*N.getOwnershipRange())
        self._group = comm.Split(_group(comm.rank, comm.size, total), comm.rank)
        rank, size = self._group.rank, self._group.size
        self._rows = slice(total * rank // size, total * (rank + 1) // size)
        layout = N.createVecRight()
        self._to_all, self._whole = PETSc.Scatter.toAll(layout)
        layout.destroy()
        self._matrix = _copy_of_rows(N, self._rows, self._group)
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
        self._b, self._x = self._matrix.createVecs()
        self._from_group, self._solution = PETSc.Scatter.toAll(self._x)
        self.ksp: PETSc.KSP | None = None

        def factor() -> None:
            if total:
                self.ksp = _factor(self._matrix, prefix, symmetric, zero)

        try:
            on_all(factor, comm)
        except Exception as error:
            self.destroy()
            raise SetUpError(
                f"The coarse problem could not be factored ({reason(error)}): look at the options "
                f"-{prefix}…"
            ) from error

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve N x = b, both in N's own layout; where the solver fails, x is NaN."""
        if self.ksp is None:
            return
        with event("FETICoarseSolve"):
            self._to_all.scatter(b, self._whole)
            self._b.array[:] = self._whole.array_r[self._rows]
            self.ksp.solve(self._b, self._x)
            self._from_group.scatter(self._x, self._solution)
        solved = self.ksp.getConvergedReason() > 0
        x.array[:] = self._solution.array_r[self._own] if solved else np.nan

    def memory(self) -> float | None:
        """Return the memory of the factor in MiB; None where the solver does not tell.

        Note:
            Collective.
        """
        used = 0.0 if self.ksp is None else mebibytes(self.ksp.getPC())
        return self._world.bcast(used)

    def pivots(self) -> Pivots:
        """Return the number of negative and zero pivots; None where the factor does not tell.

        Note:
            Collective.
        """
        counts = Pivots(0, 0) if self.ksp is None else pivots_of(self.ksp.getPC())
        return self._world.bcast(counts)

    def destroy(self) -> None:
        """Free solver, matrix and communicator."""
        for owned in (self._to_all, self._whole, self._from_group, self._solution):
            owned.destroy()
        for owned in (self.ksp, self._matrix, self._b, self._x):
            if owned is not None:
                owned.destroy()
        self._group.Free()


def _group(rank: int, processes: int, rows: int) -> int:
    """Return the group of a process: so many consecutive ones that each has about ROWS rows."""
    size = min(processes, max(1, -(-rows // ROWS)))
    return min(rank // size, processes // size - 1)


def _copy_of_rows(N: PETSc.Mat, rows: slice, group: MPI.Comm) -> PETSc.Mat:
    """Return a copy of N, distributed over a group whose process has these rows. Collective."""
    total = N.getSize()[0]
    count = rows.stop - rows.start
    taken = PETSc.IS().createStride(count, first=rows.start, step=1, comm=PETSc.COMM_SELF)
    all_ = PETSc.IS().createStride(total, first=0, step=1, comm=PETSc.COMM_SELF)
    (local,) = N.createSubMatrices(taken, all_)
    csr = local.getValuesCSR()
    for owned in (local, taken, all_):
        owned.destroy()
    return PETSc.Mat().createAIJ(((count, total), (count, total)), csr=csr, comm=group)


def _factor(N: PETSc.Mat, prefix: str, symmetric: bool, zero: float | None) -> PETSc.KSP:
    """Set the solver up, with more work space for MUMPS if it runs out of it."""
    cause = ""
    for percent in WORK_SPACE:
        ksp = _create_ksp(N, prefix, symmetric, percent)
        if zero is not None:
            set_zero_pivot(ksp.getPC(), zero)
        ksp.setUp()
        pc = ksp.getPC()
        failed = pc.getFailedReason()
        if not failed:
            return ksp
        cause = failure(pc)
        ksp.destroy()
        if failed != PETSc.PC.FailedReason.FACTOR_OUTMEMORY:
            break
    raise FactorError(cause)


def _create_ksp(N: PETSc.Mat, prefix: str, symmetric: bool, percent: int) -> PETSc.KSP:
    ksp = PETSc.KSP().create(N.comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setOperators(N)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    pc = ksp.getPC()
    pc.setType(PETSc.PC.Type.CHOLESKY if symmetric else PETSc.PC.Type.LU)
    pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    ksp.setFromOptions()
    prepare_mumps(pc, percent)
    return ksp
