# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A small distributed system N x = b, of which each group of processes factors a copy.

A coarse matrix has a few rows per subdomain, and a group a process for about :data:`ROWS` rows: a
solve is one collective call that gives b to all; each process takes its x from its own group.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.subdomain.factors.direct import (
    factor_with_work_space,
    mebibytes,
    pivots_of,
    prepare_mumps,
    set_default_factor,
)
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots
from dolfinx_feti.runtime.collective import on_all, reason
from dolfinx_feti.runtime.events import event

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
        """Gather the rows and factor. Collective.

        Args:
            N: Matrix, (K, K), distributed in any way.
            prefix: Options prefix of the solver.
            symmetric: Whether N is symmetric (Cholesky) or not (LU).
            zero: MUMPS takes a pivot below this multiple of the norm of N for zero, and solves
                without its row and column; None for exact zeros only.

        Raises:
            SetUpError: The options are wrong, or the factorisation failed; on all processes.
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
        """Return the memory of the factor in MiB; None if the solver has no figure. Collective."""
        used = 0.0 if self.ksp is None else mebibytes(self.ksp.getPC())
        return self._world.bcast(used)

    def pivots(self) -> Pivots:
        """Return how many pivots are negative and zero; None if not known. Collective."""
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
    """Return the group of a process: consecutive ones, with about ROWS rows each."""
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
    """Set the solver of a group up."""

    def create(percent: int) -> PETSc.KSP:
        ksp = PETSc.KSP().create(N.comm)
        ksp.setOptionsPrefix(prefix)
        ksp.setOperators(N)
        ksp.setType(PETSc.KSP.Type.PREONLY)
        set_default_factor(ksp.getPC(), symmetric)
        ksp.setFromOptions()
        prepare_mumps(ksp.getPC(), percent, zero)
        return ksp

    return factor_with_work_space(create)
