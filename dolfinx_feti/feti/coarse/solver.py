# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Direct solver for a coarse system N x = b, whose right-hand side is gathered on all processes.

N is either coarse matrix, (N_c, N_c). It is solved in one of three ways (docs/theory.md, *Coarse
matrices on several processes*):

- *fronts* (``fronts``), if N is positive definite and its factor not too large: the first process
  of each computer has a Cholesky factor of all of N, and sends the solution to the others;
- *inverse* (``inverse``), if N is also small: each process has this factor, computes its own rows
  of N⁻¹ from it, and multiplies with them;
- *group* (``group``), otherwise: each group of processes has a factor of any solver of PETSc.

A solve gathers b in one collective call. Fronts need a second one for the solution, and a group
those of its solver. The first call also sums a number of each process, which saves a Krylov method
a reduction.
"""

from __future__ import annotations

from typing import Protocol

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.coarse.fronts import factor_by_fronts
from dolfinx_feti.feti.coarse.group import GroupFactor
from dolfinx_feti.feti.coarse.inverse import accurate_inverse
from dolfinx_feti.feti.subdomain.factors.protocol import FactorInertia
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.collective import DeferredErrors, error_message, on_all
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime

#: Rows of the inverse for each process, on average, up to which it is formed. Forming it costs as
#: much as the product with it saves in 20 to 60 solves (docs/theory.md), and a matrix serves some
#: 30 solves. Twice as many rows cost four times as much.
INVERSE_ROWS_PER_PROCESS = 128


class CoarseFactor(Protocol):
    """One way to solve N x = b for a right-hand side that all processes have."""

    @property
    def kind(self) -> str:
        """What this is, for a report: ``inverse`` or ``factored``."""

    @property
    def processes(self) -> int:
        """Number of processes that share it."""

    @property
    def inertia(self) -> FactorInertia:
        """Numbers of negative eigenvalues and of zero pivots; None if not reported."""

    def solve_own_rows(self, b_all: Array) -> Array:
        """Return the part of N⁻¹ b of this process, (N_c,) → (n_c,). Collective.

        N has rows. If the solve fails, the result is NaN, and the error is collected.
        """

    def memory(self) -> float | None:
        """Return the memory of the factor of the first process, and of all rows of N⁻¹, in MiB.

        The memory is None if it is not known. Only the value of the first process counts: others
        may return any.
        """

    def destroy(self) -> None:
        """Free everything, communicators included."""


class CoarseSolver:
    """Direct solver for a coarse matrix N.

    Attributes:
        factor: A factor of N, or rows of N⁻¹.
    """

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
        self._comm = N.comm.tompi4py()
        self._gatherer = _Gatherer(N)
        try:
            self.factor = _create_factor(
                N,
                options=options,
                is_symmetric=is_symmetric,
                errors=DeferredErrors() if errors is None else errors,
                zero_pivot=zero_pivot,
                block_widths=block_widths,
            )
        except Exception as error:
            raise SetUpError(
                f"The coarse problem could not be factored ({error_message(error)}): look at the "
                f"options -{options.prefix}…"
            ) from error

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
            if len(b_all):
                x.array[:] = self.factor.solve_own_rows(b_all)
        return sum_of_addends

    def memory(self) -> float | None:
        """Return the memory of one factor and of all rows of the inverse in MiB. Collective.

        The factor is that of the first process, which has one in each of the three ways.

        Returns:
            The memory, the same on all processes; None if the solver does not report it.
        """
        return self._comm.bcast(on_all(self.factor.memory, self._comm))

    def inertia(self) -> FactorInertia:
        """Return numbers of negative eigenvalues and zero pivots, if reported. Collective.

        They are read from the factor of the first process, and the same on all processes.
        """
        return self._comm.bcast(on_all(lambda: self.factor.inertia, self._comm))

    def __str__(self) -> str:
        """Return how the system is solved, for a report."""
        processes = self.factor.processes
        return f"{self.factor.kind} on {processes} {'process' if processes == 1 else 'processes'}"

    def destroy(self) -> None:
        """Free the factor."""
        self.factor.destroy()


def _create_factor(
    N: PETSc.Mat,
    *,
    options: DirectOptions,
    is_symmetric: bool,
    errors: DeferredErrors,
    zero_pivot: float | None,
    block_widths: Numbers | None,
) -> CoarseFactor:
    """Factor N in one of the three ways. Collective. Arguments are those of the solver."""
    comm = N.comm.tompi4py()
    if is_symmetric and block_widths is not None:
        is_small = N.getSize()[0] <= INVERSE_ROWS_PER_PROCESS * comm.size
        fronts = factor_by_fronts(
            N,
            block_widths,
            on_each_process=is_small,
            options=options,
            zero_pivot=zero_pivot,
            errors=errors,
        )
        if fronts is not None:
            with Lifetime() as created:
                created.own(fronts)
                inverse = accurate_inverse(N, fronts) if is_small else None
                created.release()
            return fronts if inverse is None else inverse
    return GroupFactor(
        N, options=options, is_symmetric=is_symmetric, zero_pivot=zero_pivot, errors=errors
    )


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
