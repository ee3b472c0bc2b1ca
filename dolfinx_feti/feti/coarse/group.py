# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A factor of a coarse matrix N, (K, K), on each group of processes, of any solver of PETSc.

A coarse matrix has a few rows per subdomain, and a group a process for about :data:`ROWS` rows.
MUMPS, which factors unless the options name another, tells the inertia of an indefinite matrix, and
leaves out pivots that are zero.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.subdomain.factors.direct import (
    factor_with_work_space,
    mebibytes,
    pivots_of,
    prepare_mumps,
    set_default_factor,
)
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all

__all__ = ["GroupFactor", "copy_of_rows", "processes_of_node"]


#: Rows that are worth a process.
ROWS = 4000


class GroupFactor:
    """The factor of the process's group.

    Attributes:
        ksp: The solver; None if there are no rows.
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
            Exception: The options are wrong, or the factorisation failed; on all processes.
        """
        comm, total = N.comm.tompi4py(), N.getSize()[0]
        self._group = comm.Split(_group(comm.rank, comm.size, total), comm.rank)
        rank, size = self._group.rank, self._group.size
        self._rows = slice(total * rank // size, total * (rank + 1) // size)
        local, own = copy_of_rows(N, self._rows), (self._rows.stop - self._rows.start, total)
        csr = local.getValuesCSR()
        local.destroy()
        self._matrix = PETSc.Mat().createAIJ((own, own), csr=csr, comm=self._group)
        del csr
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
        self._b, self._x = self._matrix.createVecs()
        self._from_group, self._solution = PETSc.Scatter.toAll(self._x)
        self.ksp: PETSc.KSP | None = None

        def factor() -> None:
            if total:
                self.ksp = _factor(self._matrix, prefix, symmetric, zero)

        try:
            on_all(factor, comm)
        except Exception:
            self.destroy()
            raise

    @property
    def pivots(self) -> Pivots:
        """Numbers of negative and zero pivots; None if not known."""
        return Pivots(0, 0) if self.ksp is None else pivots_of(self.ksp.getPC())

    def solve(self, b: Array) -> Array:
        """Return N⁻¹ b, (K,) → (K,); NaN where the solver fails. Collective."""
        assert self.ksp is not None
        self._b.array[:] = b[self._rows]
        self.ksp.solve(self._b, self._x)
        self._from_group.scatter(self._x, self._solution)
        x = self._solution.array_r
        return x if self.ksp.getConvergedReason() > 0 else np.full_like(x, np.nan)

    def memory(self) -> float | None:
        """Return the memory of the factor in MiB; None if the solver has no figure."""
        return 0.0 if self.ksp is None else mebibytes(self.ksp.getPC())

    def __str__(self) -> str:
        """Say where the factors are."""
        return f"a factor on every {self._group.size} process(es)"

    def destroy(self) -> None:
        """Free solver, matrix and communicator."""
        for owned in (self.ksp, self._matrix, self._b, self._x, self._from_group, self._solution):
            if owned is not None:
                owned.destroy()
        self._group.Free()


def _group(rank: int, processes: int, rows: int) -> int:
    """Return the group of a process: consecutive ones, with about ROWS rows each."""
    size = min(processes, max(1, -(-rows // ROWS)))
    return min(rank // size, processes // size - 1)


def processes_of_node(comm: MPI.Comm) -> MPI.Comm:
    """Return the communicator of the processes that share memory with this one. Collective."""
    return comm.Split_type(MPI.COMM_TYPE_SHARED)


def copy_of_rows(N: PETSc.Mat, rows: slice) -> PETSc.Mat:
    """Return a sequential copy of some rows of a distributed N, (rows, K). Collective."""
    count, total = rows.stop - rows.start, N.getSize()[0]
    taken = PETSc.IS().createStride(count, first=rows.start, step=1, comm=PETSc.COMM_SELF)
    all_ = PETSc.IS().createStride(total, first=0, step=1, comm=PETSc.COMM_SELF)
    (local,) = N.createSubMatrices(taken, all_)
    for owned in (taken, all_):
        owned.destroy()
    return local


def _factor(N: PETSc.Mat, prefix: str, symmetric: bool, zero: float | None) -> PETSc.KSP:
    """Set the solver of a group up."""

    def prepare(ksp: PETSc.KSP, percent: int) -> None:
        ksp.setOptionsPrefix(prefix)
        ksp.setOperators(N)
        ksp.setType(PETSc.KSP.Type.PREONLY)
        set_default_factor(ksp.getPC(), symmetric)
        ksp.setFromOptions()
        prepare_mumps(ksp.getPC(), percent, zero)

    return factor_with_work_space(lambda: PETSc.KSP().create(N.comm), prepare)
