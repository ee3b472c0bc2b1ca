# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Direct solver for a coarse system N x = b, whose right-hand side is gathered on all processes.

N is either coarse matrix, (N_c, N_c). It is solved in one of three ways (docs/theory.md, *Coarse
matrices on several processes*):

- *fronts*: the first process of each computer has a Cholesky factor of all of N (``fronts``), and
  sends the solution to the others, if N is positive definite and its factor not too large;
- *inverse*: if N is also small, each process has this factor, and computes from it its own rows of
  N⁻¹, with which it multiplies;
- *group*: else each group of processes has a factor of any solver of PETSc (``group``).

A solve gathers b in one collective call. Fronts need a second one for the solution, and a group
those of its solver. The first call also sums a number of each process, which saves a Krylov method
a reduction.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.coarse.fronts import factor_by_fronts
from dolfinx_feti.feti.coarse.group import GroupFactor
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor
from dolfinx_feti.feti.subdomain.factors.protocol import FactorInertia
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.collective import DeferredErrors, error_message, on_all
from dolfinx_feti.runtime.events import event

#: Rows of the inverse for each process, on average, up to which it is formed. Forming it costs as
#: much as the product with it saves in 20 to 60 solves (docs/theory.md), and a matrix serves some
#: 30 solves. Twice as many rows cost four times as much.
INVERSE_ROWS_PER_PROCESS = 128

#: Condition number in the maximum norm up to which the inverse is used. It multiplies the rounding
#: errors of a product, and those of a factor hardly. On a cube with rods that are 1e8 times
#: stiffer, 1e10 takes 1000 iterations instead of 54; 1e5 takes 54, too.
MAX_INVERSE_CONDITION = 1e8


class CoarseSolver:
    """Direct solver for a coarse matrix N.

    Attributes:
        factor: The factor of this process. One by fronts has entries only on the first of the
            processes that share it.
        inverse: Rows of N⁻¹ of this process, (n_c, N_c); None if they are not formed.
    """

    factor: FrontFactor | GroupFactor
    inverse: Array | None

    def __init__(
        self,
        N: PETSc.Mat,
        *,
        options: DirectOptions,
        is_symmetric: bool,
        errors: DeferredErrors | None = None,
        zero_pivot: float | None = None,
        block_widths: Numbers | None = None,
    ) -> None:
        """Factor N, and form rows of the inverse if that pays. Collective.

        Args:
            N: Coarse matrix, (N_c, N_c), distributed by rows in any way, unless there are
                ``block_widths``.
            options: Options of the solver.
            is_symmetric: Whether N is symmetric (Cholesky) or not (LU).
            errors: Collector of errors of local work in iterations. If None, they are dropped: the
                caller sees the NaN that a failed solve returns.
            zero_pivot: Multiple of the norm of N up to which a pivot is zero; the solution is zero
                in its row. If None, N_c times the rounding unit by fronts, and zero in a group.
            block_widths: Rows of each block of this process, for a factor by fronts: the rows of a
                block are consecutive, have the same columns, and are on one process, and the widths
                have the sum n_c. None if fronts are not to be tried, because N is known to be
                indefinite or nearly singular.

        Raises:
            SetUpError: The options are wrong, the factorisation failed, or N does not have these
                blocks; on all processes.
        """
        comm = N.comm.tompi4py()
        self._comm = comm
        self._errors = DeferredErrors() if errors is None else errors
        self._rows = slice(*N.getOwnershipRange())
        self._gatherer = _Gatherer(N)
        is_small = N.getSize()[0] <= INVERSE_ROWS_PER_PROCESS * comm.size
        # Processes that share a factor by fronts: this one alone if it computes rows of the
        # inverse.
        self._sharing = MPI.COMM_SELF.Dup() if is_small else processes_of_computer(comm)
        self.inverse = None
        factor: FrontFactor | GroupFactor | None = None
        try:
            if is_symmetric and block_widths is not None:
                factor = factor_by_fronts(
                    N, block_widths, self._sharing, options=options, zero_pivot=zero_pivot
                )
                if factor is not None and is_small:
                    self.inverse = _accurate_inverse(N, factor)
            if factor is None:
                factor = GroupFactor(
                    N, options=options, is_symmetric=is_symmetric, zero_pivot=zero_pivot
                )
        except Exception as error:
            self._sharing.Free()
            raise SetUpError(
                f"The coarse problem could not be factored ({error_message(error)}): look at the "
                f"options -{options.prefix}…"
            ) from error
        self.factor = factor

    def solve(self, b: PETSc.Vec, x: PETSc.Vec, addend: float = 0.0) -> float:
        """Solve N x = b. Collective.

        Args:
            b: Right-hand side, distributed like the rows of N, (n_c,).
            x: The solution is written to it, (n_c,); NaN if the solver fails.
            addend: A number of this process. Its sum over all processes costs no further message.

        Returns:
            The sum of the addends of all processes.
        """
        with event("FETICoarseSolve"):
            b_all, sum_of_addends = self._gatherer.gather_and_sum(b.array_r, addend)
            if self.inverse is not None:
                x.array[:] = self.inverse @ b_all
            elif len(b_all):
                x.array[:] = self._solve_by_factor(b_all)[self._rows]
        return sum_of_addends

    def _solve_by_factor(self, b_all: Array) -> Array:
        """Return all of N⁻¹ b for all of b, (N_c,) → (N_c,); NaN if the solver fails. Collective.

        Guarded work must not be collective, as it may fail on one process only. The solve of a
        group is an exception: MUMPS and PETSc's Krylov methods report a failure on all of its
        processes.
        """
        if isinstance(self.factor, GroupFactor):
            return self._errors.guard(lambda: self.factor.solve(b_all), b_all.shape)
        x_all = np.empty_like(b_all)
        if self._sharing.rank == 0:
            x_all[:] = self._errors.guard(lambda: self.factor.solve(b_all), b_all.shape)
        self._sharing.Bcast(x_all)
        return x_all

    def memory(self) -> float | None:
        """Return the memory of one factor and of all rows of the inverse in MiB. Collective.

        The factor is that of the first process, which has entries in each of the three ways.

        Returns:
            The memory, the same on all processes; None if the solver does not report it.
        """
        of_factor = on_all(self.factor.memory, self._comm)
        of_inverse = 0 if self.inverse is None else self.inverse.nbytes
        of_inverse = self._comm.allreduce(of_inverse)
        memory = None if of_factor is None else of_factor + of_inverse / 2**20
        return self._comm.bcast(memory)

    def inertia(self) -> FactorInertia:
        """Return numbers of negative eigenvalues and zero pivots, if reported. Collective.

        They are read from the factor of the first process, and the same on all processes.
        """
        return self._comm.bcast(on_all(lambda: self.factor.inertia, self._comm))

    def __str__(self) -> str:
        """Return how the system is solved, for a report."""
        if self.inverse is not None:
            return f"inverse on {_processes(self._comm.size)}"
        if isinstance(self.factor, GroupFactor):
            return f"factored on {_processes(self.factor.group.size)}"
        return f"factored on {_processes(self._sharing.size)}"

    def destroy(self) -> None:
        """Free the factor and the communicator."""
        self.factor.destroy()
        self._sharing.Free()


def _accurate_inverse(N: PETSc.Mat, factor: FrontFactor) -> Array | None:
    """Return the rows of N⁻¹ of this process, (n_c, N_c). Collective.

    Args:
        N: Symmetric coarse matrix, (N_c, N_c).
        factor: Its factor, which has entries on each process.

    Returns:
        The rows; None if N is too badly conditioned for products with N⁻¹.
    """
    comm = N.comm.tompi4py()
    rows = slice(*N.getOwnershipRange())

    def compute_rows() -> Array:
        unit = np.zeros((N.getSize()[0], rows.stop - rows.start))
        np.fill_diagonal(unit[rows], 1.0)
        return np.ascontiguousarray(factor.solve(unit).T)  # columns of N⁻¹ = N⁻ᵀ

    inverse = on_all(compute_rows, comm)
    norm = np.abs(inverse).sum(axis=1).max(initial=0.0)  # ‖N⁻¹‖∞ is the largest of all processes
    condition = norm * N.norm(PETSc.NormType.INFINITY)
    is_accurate = comm.allreduce(bool(condition <= MAX_INVERSE_CONDITION), op=MPI.LAND)
    return inverse if is_accurate else None


def processes_of_computer(comm: MPI.Comm) -> MPI.Comm:
    """Return the communicator of the processes that share memory with this one. Collective."""
    return comm.Split_type(MPI.COMM_TYPE_SHARED)


def _processes(count: int) -> str:
    """Return a number of processes in words."""
    return "1 process" if count == 1 else f"{count} processes"


class _Gatherer:
    """Gathers distributed vectors on all processes, together with a number of each process."""

    def __init__(self, N: PETSc.Mat) -> None:
        """Count the rows of each process. Collective."""
        self._comm = N.comm.tompi4py()
        rows = np.array(self._comm.allgather(N.getLocalSize()[0]))
        self._counts = rows + 1  # entries of its rows, and then its number
        self._is_entry = np.ones(self._counts.sum(), dtype=bool)
        self._is_entry[np.cumsum(self._counts) - 1] = False

    def gather_and_sum(self, b: Array, addend: float) -> tuple[Array, float]:
        """Gather a vector on all processes, and sum a number of each. Collective.

        Args:
            b: Part of this process, (n_c,).
            addend: Number of this process.

        Returns:
            The vector of all processes, (N_c,), and the sum of the numbers.
        """
        gathered = np.empty(len(self._is_entry))
        self._comm.Allgatherv(np.append(b, addend), (gathered, self._counts))
        return gathered[self._is_entry], float(gathered[~self._is_entry].sum())
