# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A small distributed system, solved on as few processes as serve.

The coarse matrix N has a few rows a subdomain. Spread over all processes it is mostly messages; so
its rows move to the first processes, about :data:`ROWS` each, which factor it together.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

__all__ = ["GatheredSolver"]

#: Rows that are worth a process.
ROWS = 4000

#: A pivot below this multiple of the norm of the (scaled) matrix is zero.
ZERO = 1e-11


class GatheredSolver:
    """Direct solver for a matrix whose rows live on the first few processes.

    Attributes:
        ksp: The solver, on those processes; None elsewhere.
    """

    def __init__(self, N: PETSc.Mat, *, prefix: str, symmetric: bool) -> None:
        """Move the rows and factor.

        Args:
            N: Matrix, (K, K), distributed anyhow.
            prefix: Options prefix of the solver.
            symmetric: Whether N is symmetric (Cholesky) or not (LU).

        Note:
            Collective.
        """
        self._symmetric = symmetric
        comm = N.comm.tompi4py()
        total = N.getSize()[0]
        active = min(comm.size, max(1, -(-total // ROWS)))
        first, last = (total * min(comm.rank + j, active) // active for j in (0, 1))
        rows = PETSc.IS().createStride(last - first, first=first, step=1, comm=N.comm)
        self._gathered = N.createSubMatrix(rows, rows)
        self._b = self._gathered.createVecLeft()
        self._x = self._gathered.createVecRight()
        self._scatter = PETSc.Scatter().create(N.createVecRight(), rows, self._x, None)
        self._comm = comm.Split(0 if comm.rank < active else MPI.UNDEFINED, comm.rank)
        self.ksp: PETSc.KSP | None = None
        self.empty = total == 0
        if self._comm != MPI.COMM_NULL and not self.empty:
            sizes = (last - first, total)
            csr = self._gathered.getValuesCSR()
            self._matrix = PETSc.Mat().createAIJ((sizes, sizes), csr=csr, comm=self._comm)
            self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
            self._sub_b, self._sub_x = self._matrix.createVecs()
            self.ksp = _create_ksp(self._matrix, prefix, symmetric)
            self.ksp.setUp()
        rows.destroy()

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve N x = b, both in N's own layout."""
        forward, backward = PETSc.ScatterMode.FORWARD, PETSc.ScatterMode.REVERSE
        self._scatter.scatter(b, self._b, mode=forward)
        if self.ksp is not None:
            self._sub_b.array[:] = self._b.array_r
            self.ksp.solve(self._sub_b, self._sub_x)
            self._x.array[:] = self._sub_x.array_r
        self._scatter.scatter(self._x, x, mode=backward)

    def memory(self) -> float:
        """Return the memory of the factor in MiB; nan where the solver does not tell.

        Note:
            Collective.
        """
        megabytes = 0.0
        if self.ksp is not None:
            F = _mumps_factor(self.ksp)
            megabytes = np.nan if F is None else F.getMumpsInfog(22)
        return float(self._gathered.comm.tompi4py().bcast(megabytes)) * 1e6 / 2**20

    def inertia(self) -> tuple[int | None, int | None]:
        """Return the numbers of negative and zero pivots; None where the factor does not tell.

        Note:
            Collective.
        """
        counts: tuple[int | None, int | None] = (0, 0)
        if self.ksp is not None:
            F = _mumps_factor(self.ksp)
            if F is None:
                counts = (None, None)
            else:
                counts = (F.getMumpsInfog(12) if self._symmetric else None, F.getMumpsInfog(28))
        return self._gathered.comm.tompi4py().bcast(counts)

    def destroy(self) -> None:
        """Free solver, matrices and communicator."""
        for owned in (self._gathered, self._b, self._x, self._scatter):
            owned.destroy()
        if self.ksp is not None:
            for owned in (self.ksp, self._matrix, self._sub_b, self._sub_x):
                owned.destroy()
        if self._comm != MPI.COMM_NULL:
            self._comm.Free()


def _create_ksp(N: PETSc.Mat, prefix: str, symmetric: bool) -> PETSc.KSP:
    ksp = PETSc.KSP().create(N.comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setOperators(N)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    pc = ksp.getPC()
    pc.setType(PETSc.PC.Type.CHOLESKY if symmetric else PETSc.PC.Type.LU)
    pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    ksp.setFromOptions()
    if _is_mumps(pc):
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(24, 1)  # report zero pivots: the global kernel
        pc.getFactorMatrix().setMumpsCntl(3, ZERO)
    return ksp


def _is_mumps(pc: PETSc.PC) -> bool:
    return pc.getType() in ("cholesky", "lu") and pc.getFactorSolverType() == "mumps"


def _mumps_factor(ksp: PETSc.KSP) -> PETSc.Mat | None:
    """Return the factor if it is MUMPS's."""
    pc = ksp.getPC()
    return pc.getFactorMatrix() if _is_mumps(pc) else None
