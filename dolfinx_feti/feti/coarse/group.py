# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A factor of a coarse matrix on each group of processes, by any solver of PETSc.

A coarse matrix N (or A₀), (N_c, N_c), is too small for all processes: they would spend the time in
messages. So it is copied to groups of consecutive processes. A group has one process for each
:data:`ROWS_PER_PROCESS` rows, and there are as many groups as fit. A solve communicates within the
groups only. MUMPS is the default: it counts the negative pivots of an indefinite matrix, and leaves
out those that are zero.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.subdomain.factors.petsc_solver import (
    factor_memory,
    inertia_of,
    set_default_solver,
    set_mumps_controls,
    set_up_with_retries,
)
from dolfinx_feti.feti.subdomain.factors.protocol import FactorInertia
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import DeferredErrors, on_all
from dolfinx_feti.runtime.lifetime import Lifetime

#: Rows of N for each process of a group. With fewer rows a process, MUMPS spends its time in
#: messages; with more, its factor takes longer than necessary. Measured once with MUMPS on a busy
#: computer of two cores: two processes factor 4100 rows in 1.7 times the time of one, 8200 rows in
#: 0.85 and 16000 rows in 0.75 times; their solves take longer in each case. An order of magnitude.
ROWS_PER_PROCESS = 4000


class GroupFactor:
    """The factor of the group of this process; a ``solver.CoarseFactor``.

    Attributes:
        kind: ``factored``.
        group: Communicator of the group.
        ksp: The solver; None if N has no rows.
    """

    kind = "factored"

    def __init__(
        self,
        N: PETSc.Mat,
        *,
        options: DirectOptions,
        is_symmetric: bool,
        zero_pivot: float | None,
        errors: DeferredErrors,
    ) -> None:
        """Copy N to each group and factor it. Collective.

        Args:
            N: Coarse matrix, (N_c, N_c), distributed in any way.
            options: Options of the solver.
            is_symmetric: Whether N is symmetric (Cholesky) or not (LU).
            zero_pivot: Multiple of the norm of N up to which a pivot is zero; None for exact zeros.
            errors: Collector of errors of solves.

        Raises:
            MemoryError: Memory or work space ran out; on all processes.
            FactorError: The factorisation failed for another reason; on all processes.
            PETSc.Error: The options are wrong; on all processes.
        """
        comm = N.comm.tompi4py()
        N_c = N.getSize()[0]
        self.group = _create_group(comm, N_c)
        self._own_rows = slice(*N.getOwnershipRange())
        self._errors = errors
        self.ksp: PETSc.KSP | None = None
        self._owned = Lifetime()
        try:
            self._rows = _rows_of_process(N_c, self.group)
            self._matrix = self._owned.own(_redistribute(N, self._rows, self.group))
            self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, is_symmetric)
            self._b, self._x = (self._owned.own(vector) for vector in self._matrix.createVecs())
            scatter, x_all = PETSc.Scatter.toAll(self._x)
            self._to_all = self._owned.own(scatter)
            self._x_all = self._owned.own(x_all)  # x on each process of the group, (N_c,)
            if N_c:
                self.ksp = on_all(lambda: self._factor(options, is_symmetric, zero_pivot), comm)
        except Exception:
            self.destroy()
            raise

    def _factor(
        self, options: DirectOptions, is_symmetric: bool, zero_pivot: float | None
    ) -> PETSc.KSP:
        """Return a solver with a factor, which this object destroys. Collective on the group."""

        def configure(ksp: PETSc.KSP, percent: int) -> None:
            """Configure a solver for a work space of this size above MUMPS's estimate [%]."""
            ksp.setOptionsPrefix(options.prefix)
            ksp.setOperators(self._matrix)
            ksp.setType(PETSc.KSP.Type.PREONLY)
            set_default_solver(ksp.getPC(), is_symmetric)
            ksp.setFromOptions()
            set_mumps_controls(ksp.getPC(), percent, zero_pivot)

        ksp = set_up_with_retries(lambda: PETSc.KSP().create(self.group), configure)
        return self._owned.own(ksp)

    @property
    def processes(self) -> int:
        """Number of processes of the group."""
        return int(self.group.size)

    @property
    def inertia(self) -> FactorInertia:
        """Numbers of negative eigenvalues and of zero pivots; None if not reported."""
        return FactorInertia(0, 0) if self.ksp is None else inertia_of(self.ksp.getPC())

    def solve_own_rows(self, b_all: Array) -> Array:
        """Return the part of N⁻¹ b of this process, (N_c,) → (n_c,). Collective on the group.

        Guarded work must not be collective, as it may fail on one process only. This solve is an
        exception: MUMPS and PETSc's Krylov methods report a failure on all processes of the group.
        The result is NaN if it fails.
        """
        return self._errors.guard(lambda: self.solve(b_all), b_all.shape)[self._own_rows]

    def solve(self, b: Array) -> Array:
        """Solve N x = b. Collective on the group.

        Args:
            b: All of the right-hand side, (N_c,), the same on each process of the group.

        Returns:
            All of x, (N_c,), in an array that the next solve overwrites; NaN if the solver fails.

        Raises:
            RuntimeError: N has no rows.
        """
        if self.ksp is None:
            raise RuntimeError("a coarse matrix without rows has no solver")
        self._b.array[:] = b[self._rows]
        self.ksp.solve(self._b, self._x)
        self._to_all.scatter(self._x, self._x_all)
        x = self._x_all.array_r
        return x if self.ksp.getConvergedReason() > 0 else np.full_like(x, np.nan)

    def memory(self) -> float | None:
        """Return the memory of the factor in MiB; None if the solver does not report it."""
        return 0.0 if self.ksp is None else factor_memory(self.ksp.getPC())

    def destroy(self) -> None:
        """Free solver, matrix and communicator."""
        self._owned.close()
        self.group.Free()


def _create_group(comm: MPI.Comm, N_c: int) -> MPI.Comm:
    """Create the communicator of the group of this process for N_c rows. Collective."""
    size = min(comm.size, max(1, -(-N_c // ROWS_PER_PROCESS)))  # rounded up
    number_of_groups = comm.size // size
    color = min(comm.rank // size, number_of_groups - 1)  # the last group has the remainder, too
    return comm.Split(color, comm.rank)


def _rows_of_process(N_c: int, group: MPI.Comm) -> slice:
    """Return the rows of this process if a group shares N_c rows evenly."""
    return slice(N_c * group.rank // group.size, N_c * (group.rank + 1) // group.size)


def _redistribute(N: PETSc.Mat, rows: slice, group: MPI.Comm) -> PETSc.Mat:
    """Return a copy of N on a group, with these rows on this process. Collective."""
    local = copy_of_rows(N, rows)
    csr = local.getValuesCSR()
    local.destroy()
    layout = (rows.stop - rows.start, N.getSize()[0])
    return PETSc.Mat().createAIJ((layout, layout), csr=csr, comm=group)


def copy_of_rows(N: PETSc.Mat, rows: slice) -> PETSc.Mat:
    """Copy consecutive rows of a distributed matrix to this process. Collective.

    Args:
        N: Matrix, (N_c, N_c).
        rows: Rows that this process copies, numbered over all processes. Each process may pass
            different ones.

    Returns:
        A sequential matrix, (rows, N_c); the caller destroys it.
    """
    count = rows.stop - rows.start
    columns = N.getSize()[0]
    row_set = PETSc.IS().createStride(count, first=rows.start, step=1, comm=PETSc.COMM_SELF)
    column_set = PETSc.IS().createStride(columns, first=0, step=1, comm=PETSc.COMM_SELF)
    (local,) = N.createSubMatrices(row_set, column_set)
    row_set.destroy()
    column_set.destroy()
    return local
