# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A small distributed system, solved on as few processes as serve.

The coarse matrix N has a few rows per subdomain. Spread over all processes it is mostly messages;
so its rows move to the first processes, about :data:`ROWS` each, which factor it together. What
fails there fails on all processes.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.collective import on_all, reason
from dolfinx_feti.errors import FactorError, SetUpError
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
    """Direct solver for a matrix whose rows live on the first few processes.

    Attributes:
        ksp: The solver, on those processes; None elsewhere.
    """

    def __init__(
        self, N: PETSc.Mat, *, prefix: str, symmetric: bool, zero: float | None = None
    ) -> None:
        """Move the rows and factor.

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
        comm = N.comm.tompi4py()
        total = N.getSize()[0]
        active = min(comm.size, max(1, -(-total // ROWS)))
        first, last = (total * min(comm.rank + j, active) // active for j in (0, 1))
        rows = PETSc.IS().createStride(last - first, first=first, step=1, comm=N.comm)
        gathered = N.createSubMatrix(rows, rows)
        self._b, self._x = gathered.createVecLeft(), gathered.createVecRight()
        layout = N.createVecRight()
        self._scatter = PETSc.Scatter().create(layout, rows, self._x, None)
        csr: tuple[npt.NDArray[np.number], ...] = gathered.getValuesCSR()
        for owned in (layout, rows, gathered):
            owned.destroy()
        self._comm = comm.Split(0 if comm.rank < active else MPI.UNDEFINED, comm.rank)
        self._matrix, self._sub_b, self._sub_x = PETSc.Mat(), PETSc.Vec(), PETSc.Vec()
        self.ksp: PETSc.KSP | None = None

        def factor() -> None:
            if self._comm != MPI.COMM_NULL and total:
                sizes = (last - first, total)
                self._matrix = PETSc.Mat().createAIJ((sizes, sizes), csr=csr, comm=self._comm)
                self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
                self._sub_b, self._sub_x = self._matrix.createVecs()
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
        forward, backward = PETSc.ScatterMode.FORWARD, PETSc.ScatterMode.REVERSE
        self._scatter.scatter(b, self._b, mode=forward)
        if self.ksp is not None:
            self._sub_b.array[:] = self._b.array_r
            self.ksp.solve(self._sub_b, self._sub_x)
            solved = self.ksp.getConvergedReason() > 0
            self._x.array[:] = self._sub_x.array_r if solved else np.nan
        self._scatter.scatter(self._x, x, mode=backward)

    def memory(self) -> float | None:
        """Return the memory of the factor in MiB; None where the solver does not tell.

        Note:
            Collective.
        """
        used = 0.0 if self.ksp is None else mebibytes(self.ksp.getPC())
        return self._b.comm.tompi4py().bcast(used)

    def pivots(self) -> Pivots:
        """Return the number of negative and zero pivots; None where the factor does not tell.

        Note:
            Collective.
        """
        counts = Pivots(0, 0) if self.ksp is None else pivots_of(self.ksp.getPC())
        return self._b.comm.tompi4py().bcast(counts)

    def destroy(self) -> None:
        """Free solver, matrices and communicator."""
        for owned in (self._b, self._x, self._scatter):
            owned.destroy()
        for owned in (self.ksp, self._matrix, self._sub_b, self._sub_x):
            if owned is not None and owned.handle:
                owned.destroy()
        if self._comm != MPI.COMM_NULL:
            self._comm.Free()


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
