# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A small distributed system N x = b, of which each group of processes factors a copy.

A coarse matrix has a few rows per subdomain, and a group a process for about :data:`ROWS` rows: a
solve is one collective call that gives b to all, and with it a number that each process adds to a
sum; each process takes its x from its own group.

Up to :data:`SPREAD` rows of N for each process, a process keeps its own rows of the inverse in
place of the factor, and the call is followed by nothing but its share of one dense product,

.. math:: x_p = (N^{-1})_p\, b.

It then reads K²/P numbers in a solve, and not the entries of the factor twice.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.subdomain.factors.direct import (
    factor_with_work_space,
    is_mumps,
    mebibytes,
    pivots_of,
    prepare_mumps,
    set_default_factor,
)
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots
from dolfinx_feti.runtime.collective import on_all, reason
from dolfinx_feti.runtime.events import event

__all__ = ["GatheredSolver"]

Array = npt.NDArray[np.float64]

#: Rows that are worth a process.
ROWS = 4000

#: Rows of the inverse for each process, on average, up to which they are formed: in blocks, six of
#: them take as long as one solve with the factor, and a matrix serves some thirty solves.
SPREAD = 128

#: Right-hand sides at a time.
BLOCK = 64

#: Condition number, of the norm of the largest row, above which the factor solves, and better.
CONDITION = 1e10


class GatheredSolver:
    """Direct solver for a matrix that is gathered in each group of processes.

    Attributes:
        ksp: The solver of the process's group; None if there are no rows.
        inverse: Own rows of N⁻¹, (own rows, K), if they are spread over the processes.
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
        self._counts = np.array(comm.allgather(self._own.stop - self._own.start)) + 1
        self._last = np.cumsum(self._counts) - 1  # places of the numbers that travel with b
        self._is_b = np.ones(total + comm.size, dtype=bool)
        self._is_b[self._last] = False
        self._matrix = _copy_of_rows(N, self._rows, self._group)
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
        self._b, self._x = self._matrix.createVecs()
        self._from_group, self._solution = PETSc.Scatter.toAll(self._x)
        self.ksp: PETSc.KSP | None = None
        self.inverse: Array | None = None

        def factor() -> None:
            if total:
                self.ksp = _factor(self._matrix, prefix, symmetric, zero)
                if total <= SPREAD * comm.size and _is_factor(self.ksp):
                    self.inverse = self._rows_of_inverse(self.ksp, symmetric)

        try:
            on_all(factor, comm)
        except Exception as error:
            self.destroy()
            raise SetUpError(
                f"The coarse problem could not be factored ({reason(error)}): look at the options "
                f"-{prefix}…"
            ) from error
        if self.inverse is not None and not self._is_accurate(N, self.inverse):
            self.inverse = None

    def solve(
        self, b: PETSc.Vec, x: PETSc.Vec, *, first: bool = False, addend: float = 0.0
    ) -> float:
        """Solve N x = b, both in N's own layout; where the solver fails, x is NaN.

        Whether b is the ``first`` right-hand side of a Krylov method, does not matter here.

        Returns:
            The sum of the ``addend`` of all processes.
        """
        with event("FETICoarseSolve"):
            gathered = np.empty(len(self._is_b))
            self._world.Allgatherv(np.append(b.array_r, addend), (gathered, self._counts))
            whole, sum_ = gathered[self._is_b], float(gathered[self._last].sum())
            if self.inverse is not None:
                x.array[:] = self.inverse @ whole  # x_p = (N⁻¹)_p b
            elif self.ksp is not None:
                self._b.array[:] = whole[self._rows]
                self.ksp.solve(self._b, self._x)
                self._from_group.scatter(self._x, self._solution)
                solved = self.ksp.getConvergedReason() > 0
                x.array[:] = self._solution.array_r[self._own] if solved else np.nan
        return sum_

    def memory(self) -> float | None:
        """Return the memory of the factor in MiB; None if the solver has no figure. Collective."""
        used = 0.0 if self.ksp is None else mebibytes(self.ksp.getPC())
        rows = 0 if self.inverse is None else self.inverse.nbytes
        spread = self._world.allreduce(rows) / 2**20
        return self._world.bcast(None if used is None else used + spread)

    def __str__(self) -> str:
        """Say how it solves."""
        if self.inverse is not None:
            return f"inverse spread over {self._world.size} process(es)"
        return f"a factor on every {self._group.size} process(es)"

    def pivots(self) -> Pivots:
        """Return how many pivots are negative and zero; None if not known. Collective."""
        counts = Pivots(0, 0) if self.ksp is None else pivots_of(self.ksp.getPC())
        return self._world.bcast(counts)

    def _rows_of_inverse(self, ksp: PETSc.KSP, symmetric: bool) -> Array:
        """Return the process's rows of N⁻¹, (own rows, K). Collective on the group."""
        owners = self._group.allgather(self._own)
        rows, total = self._rows, int(self._is_b.sum())
        F = ksp.getPC().getFactorMatrix()
        F.setMumpsIcntl(9, 1 if symmetric else 0)  # N⊤: its columns are rows
        parts: list[Array] = [np.empty((rows.stop - rows.start, 0))]
        for first in range(owners[0].start, owners[-1].stop, BLOCK):
            columns = np.arange(first, min(first + BLOCK, owners[-1].stop))
            shape = ((rows.stop - rows.start, total), (None, len(columns)))
            Y = PETSc.Mat().createDense(shape, comm=self._group)
            Y.setUp()
            here = (rows.start <= columns) & (columns < rows.stop)
            Y.getDenseArray()[columns[here] - rows.start, np.flatnonzero(here)] = 1.0
            Y.assemble()
            X = Y.duplicate()
            X.assemble()
            ksp.matSolve(Y, X)  # N⊤ X = I, rows of the group
            parts.append(X.getDenseArray().copy())
            for owned in (X, Y):
                owned.destroy()
        F.setMumpsIcntl(9, 1)
        X_rows, before = np.hstack(parts), owners[0].start
        theirs = [X_rows[:, own.start - before : own.stop - before].T for own in owners]
        return np.hstack(self._group.alltoall(theirs))

    def _is_accurate(self, N: PETSc.Mat, inverse: Array) -> bool:
        """Tell whether rounding leaves a solve with the inverse some digits. Collective."""
        largest = np.abs(inverse).sum(axis=1).max(initial=0.0)
        condition = largest * N.norm(PETSc.NormType.INFINITY)
        return bool(self._world.allreduce(bool(condition <= CONDITION), op=MPI.LAND))

    def destroy(self) -> None:
        """Free solver, matrix and communicator."""
        for owned in (self.ksp, self._matrix, self._b, self._x, self._from_group, self._solution):
            if owned is not None:
                owned.destroy()
        self._group.Free()


def _is_factor(ksp: PETSc.KSP) -> bool:
    """Tell whether the solver is a factor that takes blocks of right-hand sides."""
    return ksp.getType() == PETSc.KSP.Type.PREONLY and is_mumps(ksp.getPC())


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
