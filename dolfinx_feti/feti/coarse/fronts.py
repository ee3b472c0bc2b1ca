# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Cholesky factor of a whole coarse matrix by fronts, on one of the processes that share it.

.. math:: N = U^⊤ U, \qquad (N_c, N_c)

N couples the subdomains in dense sub-matrices: two blocks, each the coarse dofs of one subdomain,
are coupled completely or not at all. The fronts eliminate one block after the other
(``subdomain.factors.multifrontal``). The factor proves that N is positive definite.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.coarse.group import copy_of_rows
from dolfinx_feti.feti.subdomain.factors.create import multifrontal_code
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor, Fronts
from dolfinx_feti.feti.subdomain.factors.protocol import FactorInertia
from dolfinx_feti.feti.subdomain.factors.work_space import WorkSpace
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.runtime.arrays import Array, Indices, Numbers, concatenate
from dolfinx_feti.runtime.collective import DeferredErrors, allgather_rows, on_all
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_library import csr_of
from dolfinx_feti.torn.rounding import EPS

#: Largest number of entries of a factor by fronts: 512 MiB for each computer. A larger one is
#: shared by a group of processes. A bound of the memory, not tuned.
MAX_FRONT_ENTRIES = 2**26


class SharedFronts:
    """A Cholesky factor on the first of the processes that share it; a ``solver.CoarseFactor``.

    Attributes:
        kind: ``factored``.
        inertia: No negative eigenvalues, and no zero pivots: N is positive definite.
        processes: Number of processes that share the factor.
        fronts: Fronts of N.
        factor: The factor on the first of the processes, None on the others.
    """

    kind = "factored"
    inertia = FactorInertia(0, 0)

    def __init__(
        self,
        fronts: Fronts,
        factor: FrontFactor | None,
        sharing: MPI.Comm,
        *,
        own_rows: slice,
        errors: DeferredErrors,
    ) -> None:
        """Own the factor and the communicator.

        Args:
            fronts: Fronts of N.
            factor: The factor on the first process of ``sharing``, None on the others.
            sharing: Communicator of the processes that share the factor.
            own_rows: Rows of N of this process.
            errors: Collector of errors of solves.
        """
        self.fronts = fronts
        self.factor = factor
        self.processes = sharing.size
        self._sharing = sharing
        self._own_rows = own_rows
        self._errors = errors

    def solve_own_rows(self, b_all: Array) -> Array:
        """Return the part of N⁻¹ b of this process, (N_c,) → (n_c,).

        Collective on the processes that share the factor. The result is NaN if the solve fails.
        """
        x_all = np.empty_like(b_all)
        if self.factor is not None:
            x_all[:] = self._errors.guard(lambda: self.solve(b_all), b_all.shape)
        self._sharing.Bcast(x_all)
        return x_all[self._own_rows]

    def solve(self, b_all: Array) -> Array:
        """Return N⁻¹ b on the process that has the factor, (N_c,) or (N_c, r)."""
        if self.factor is None:
            raise RuntimeError("another process has the factor of the coarse matrix")
        return self.factor.solve(b_all)

    def memory(self) -> float:
        """Return the memory of the factor in MiB; zero on processes without it."""
        return 0.0 if self.factor is None else self.factor.memory()

    def destroy(self) -> None:
        """Free factor and communicator."""
        if self.factor is not None:
            self.factor.destroy()
        self._sharing.Free()


def factor_by_fronts(
    N: PETSc.Mat,
    block_widths: Numbers,
    *,
    on_each_process: bool,
    options: DirectOptions,
    zero_pivot: float | None,
    errors: DeferredErrors,
) -> SharedFronts | None:
    """Factor a symmetric coarse matrix. Collective.

    Args:
        N: Coarse matrix, (N_c, N_c). The rows of a block are consecutive, and all of them have the
            same columns.
        block_widths: Rows of each block of this process, with the sum n_c; zeros are allowed.
        on_each_process: Whether each process has the factor; otherwise the first one of each
            computer.
        options: Options of the solver.
        zero_pivot: Multiple of the norm of N up to which a pivot is zero; None for N_c times the
            rounding unit.
        errors: Collector of errors of solves.

    Returns:
        The factor; None if fronts do not solve with N: it has no rows or is not positive definite,
        its factor would be too large, or the options name a solver.

    Raises:
        FactorError: The rows of some block have different columns; on all processes.
        MemoryError: There is not enough memory; on all processes.
        ValueError: The widths do not fit the rows of N; on all processes.
    """
    comm = N.comm.tompi4py()
    on_all(lambda: _require_rows(N, block_widths), comm)
    fronts = _fronts_of(N, block_widths, options)
    if fronts is None:
        return None
    N_c = N.getSize()[0]
    relative_pivot = EPS * N_c if zero_pivot is None else zero_pivot
    min_pivot = relative_pivot * N.norm(PETSc.NormType.INFINITY)
    with Lifetime() as created:
        sharing = MPI.COMM_SELF.Dup() if on_each_process else processes_of_computer(comm)
        created.callback(sharing.Free)
        has_factor = sharing.rank == 0
        with Lifetime() as temporary:
            matrix = temporary.own(copy_of_rows(N, slice(0, N_c if has_factor else 0)))
            factor = on_all(
                lambda: _definite_factor(fronts, matrix, min_pivot) if has_factor else None, comm
            )
        is_definite = factor is not None or not has_factor
        if not comm.allreduce(is_definite, op=MPI.LAND):
            return None
        created.release()
    own_rows = slice(*N.getOwnershipRange())
    return SharedFronts(fronts, factor, sharing, own_rows=own_rows, errors=errors)


def processes_of_computer(comm: MPI.Comm) -> MPI.Comm:
    """Return the communicator of the processes that share memory with this one. Collective."""
    return comm.Split_type(MPI.COMM_TYPE_SHARED)


def _fronts_of(N: PETSc.Mat, block_widths: Numbers, options: DirectOptions) -> Fronts | None:
    """Find the fronts of a coarse matrix. Collective.

    Args:
        N: Coarse matrix, (N_c, N_c).
        block_widths: Rows of each block of this process, with the sum n_c.
        options: Options of the solver.

    Returns:
        The fronts; None if N has no rows, its factor would be too large, or the options name a
        solver.
    """
    comm = N.comm.tompi4py()
    N_c = N.getSize()[0]
    code = multifrontal_code(options, comm)
    if code is None or N_c == 0:
        return None
    graph = _block_graph(N, block_widths)
    rows = np.arange(N_c, dtype=np.int32)
    no_interface = np.zeros(len(graph.widths), dtype=bool)  # N is factored as a whole
    # To the fronts, N is the matrix of one subdomain that has all rows, in the order of N.
    fronts = on_all(
        lambda: Fronts(
            code,
            rows=rows,
            local_index=rows,
            size=graph.widths,
            graph=(graph.ptr, graph.adjacent),
            is_on_interface=no_interface,
        ),
        comm,
    )
    return None if fronts.factor_entries > MAX_FRONT_ENTRIES else fronts


def _definite_factor(fronts: Fronts, matrix: PETSc.Mat, min_pivot: float) -> FrontFactor | None:
    """Factor a matrix; None if not all of its pivots are above a bound.

    Args:
        fronts: Fronts of the pattern of the matrix.
        matrix: Sequential matrix, (N_c, N_c).
        min_pivot: The bound.
    """
    with csr_of(matrix) as csr:
        elimination = fronts.factor(csr, WorkSpace())
    if elimination is None:
        return None
    factor = elimination.factor
    return factor if factor.smallest_pivot() > min_pivot else None


def _require_rows(N: PETSc.Mat, block_widths: Numbers) -> None:
    """Raise a ValueError unless the blocks of this process have as many rows as N has here."""
    n_c = N.getLocalSize()[0]
    if block_widths.sum() != n_c:
        raise ValueError(f"blocks have {block_widths.sum()} rows, but the coarse matrix {n_c}")


@dataclass(frozen=True, slots=True)
class _BlockGraph:
    """Which blocks of all processes a coarse matrix couples; blocks without rows are left out.

    Every process has all of it: a few numbers for each subdomain of all processes.

    Attributes:
        widths: Rows of each block, (blocks,).
        ptr: Index of the first neighbour of each block, and the end, (blocks + 1,).
        adjacent: Neighbours of each block, without itself.
    """

    widths: Indices
    ptr: Indices
    adjacent: Indices


def _block_graph(N: PETSc.Mat, block_widths: Numbers) -> _BlockGraph:
    """Read from the first row of each block which blocks it is coupled with. Collective.

    Args:
        N: Coarse matrix, (N_c, N_c).
        block_widths: Rows of each block of this process.
    """
    comm = N.comm.tompi4py()
    has_rows = block_widths > 0
    first_row = N.getOwnershipRange()[0] + np.cumsum(block_widths) - block_widths
    first_row = first_row[has_rows]
    first_row_of_all = allgather_rows(first_row, comm)
    neighbours = []
    for row in first_row:
        columns = N.getRow(row)[0]
        coupled = np.unique(np.searchsorted(first_row_of_all, columns, side="right") - 1)
        neighbours.append(coupled[first_row_of_all[coupled] != row])
    counts = allgather_rows([len(blocks) for blocks in neighbours], comm)
    return _BlockGraph(
        widths=allgather_rows(block_widths[has_rows], comm).astype(np.int32),
        ptr=np.cumsum(np.append(0, counts)).astype(np.int32),
        adjacent=allgather_rows(concatenate(neighbours, np.int64), comm).astype(np.int32),
    )
