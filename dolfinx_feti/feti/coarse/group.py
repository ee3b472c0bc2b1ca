# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A factor of a coarse matrix N, (K, K), on each group of processes, of any solver of PETSc.

A group has a process for about :data:`ROWS` rows. MUMPS, which factors unless the options name
another, tells the inertia of an indefinite matrix, and leaves out pivots that are zero.
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

#: Rows that are worth a process.
ROWS = 4000


class GroupFactor:
    """The factor of the process's group.

    Attributes:
        group: Its processes.
        ksp: The solver; None if there are no rows.
    """

    def __init__(
        self, N: PETSc.Mat, *, prefix: str, symmetric: bool, zero: float | None = None
    ) -> None:
        """Gather the rows and factor, with the arguments of ``GatheredSolver``. Collective.

        Raises:
            Exception: The options are wrong, or the factorisation failed; on all processes.
        """
        comm, total = N.comm.tompi4py(), N.getSize()[0]
        most = min(comm.size, max(1, -(-total // ROWS)))  # processes of a group
        group = min(comm.rank // most, comm.size // most - 1)  # consecutive ones
        self.group = comm.Split(group, comm.rank)
        rank, size = self.group.rank, self.group.size
        self._rows = slice(total * rank // size, total * (rank + 1) // size)
        local, own = copy_of_rows(N, self._rows), (self._rows.stop - self._rows.start, total)
        csr = local.getValuesCSR()
        local.destroy()
        self._matrix = PETSc.Mat().createAIJ((own, own), csr=csr, comm=self.group)
        del csr
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
        self._b, self._x = self._matrix.createVecs()
        self._from_group, self._solution = PETSc.Scatter.toAll(self._x)
        self.ksp: PETSc.KSP | None = None

        def prepare(ksp: PETSc.KSP, percent: int) -> None:
            ksp.setOptionsPrefix(prefix)
            ksp.setOperators(self._matrix)
            ksp.setType(PETSc.KSP.Type.PREONLY)
            set_default_factor(ksp.getPC(), symmetric)
            ksp.setFromOptions()
            prepare_mumps(ksp.getPC(), percent, zero)

        def factor() -> None:
            if total:
                self.ksp = factor_with_work_space(lambda: PETSc.KSP().create(self.group), prepare)

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

    def destroy(self) -> None:
        """Free solver, matrix and communicator."""
        for owned in (self.ksp, self._matrix, self._b, self._x, self._from_group, self._solution):
            if owned is not None:
                owned.destroy()
        self.group.Free()


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
