# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A small distributed system N x = b: a factor, or the inverse, spread over all processes.

A solve gives b to all in one collective call, with a number that each process adds to a sum. The
factor is Cholesky's by fronts, with a node for all columns of a subdomain, on one process of each
machine; or, where N may be indefinite or is too large, or the options name a solver, that of a
group of processes (``group``, docs/theory.md).
"""

from __future__ import annotations

from contextlib import suppress
from functools import partial

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import FactorError, SetUpError
from dolfinx_feti.feti.coarse.group import GroupFactor, copy_of_rows, processes_of_node
from dolfinx_feti.feti.coarse.near import joined
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor, Fronts, load_fronts_for
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots
from dolfinx_feti.runtime.arrays import Array, Indices, Numbers
from dolfinx_feti.runtime.collective import deferred, join, on_all, reason
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_library import rows_of
from dolfinx_feti.torn.rounding import EPS

#: Rows of the inverse for each process, on average, up to which they are formed.
SPREAD = 128

#: Condition number, of the norm of the largest row, above which the factor solves, and better.
CONDITION = 1e10

#: Most entries of a factor that a process has for its machine: 512 MiB.
MOST = 2**26


class GatheredSolver:
    """Direct solver for a matrix whose right-hand sides are gathered.

    Attributes:
        factor: What solves on this process, or on the first one of its node.
        inverse: Own rows of N⁻¹, (own rows, K), if they are formed.
    """

    factor: FrontFactor | GroupFactor

    def __init__(
        self,
        N: PETSc.Mat,
        *,
        prefix: str,
        symmetric: bool,
        zero: float | None = None,
        counts: Numbers | None = None,
    ) -> None:
        """Factor, and form the inverse if that pays. Collective.

        Args:
            N: Matrix, (K, K), distributed in any way.
            prefix: Options prefix of the solver.
            symmetric: Whether N is symmetric (Cholesky) or not (LU).
            zero: A pivot below this multiple of the norm of N is zero, and N solved without its row
                and column; None for exact zeros only.
            counts: Rows of each subdomain of this process; None where the inertia is asked for.

        Raises:
            SetUpError: The options are wrong, or the factorisation failed; on all processes.
        """
        comm, total = N.comm.tompi4py(), N.getSize()[0]
        self._world = comm
        self._counts = np.array(comm.allgather(N.getLocalSize()[0])) + 1
        self._is_b = np.ones(total + comm.size, dtype=bool)
        self._is_b[np.cumsum(self._counts) - 1] = False  # the numbers that travel with b
        self._own = slice(*N.getOwnershipRange())
        self.inverse: Array | None = None
        whole, spread = None, total <= SPREAD * comm.size
        self._node = MPI.COMM_SELF.Dup() if spread else processes_of_node(comm)
        try:
            if symmetric and counts is not None:
                whole = whole_factor(N, counts, self._node, prefix=prefix, zero=zero)
            if whole is not None and spread:
                self.inverse = on_all(partial(self._rows_of_inverse, whole), comm)
            self.factor = whole or GroupFactor(N, prefix=prefix, symmetric=symmetric, zero=zero)
        except Exception as error:
            self._node.Free()
            raise SetUpError(
                f"The coarse problem could not be factored ({reason(error)}): look at the options "
                f"-{prefix}…"
            ) from error
        if self.inverse is not None:
            largest = np.abs(self.inverse).sum(axis=1).max(initial=0.0)
            condition = largest * N.norm(PETSc.NormType.INFINITY)
            if not comm.allreduce(bool(condition <= CONDITION), op=MPI.LAND):
                self.inverse = None

    def solve(self, b: PETSc.Vec, x: PETSc.Vec, addend: float = 0.0) -> float:
        """Solve N x = b, both in N's own layout; where the solver fails, x is NaN. Collective.

        Returns:
            The sum of the ``addend`` of all processes.
        """
        with event("FETICoarseSolve"):
            gathered = np.empty(len(self._is_b))
            self._world.Allgatherv(np.append(b.array_r, addend), (gathered, self._counts))
            whole = gathered[self._is_b]
            if self.inverse is not None:
                x.array[:] = self.inverse @ whole
            elif len(whole):
                x.array[:] = self._solve(whole)[self._own]
        return float(gathered[~self._is_b].sum())

    def _solve(self, b: Array) -> Array:
        """Return N⁻¹ b, (K,) → (K,). Collective."""
        alone = isinstance(self.factor, FrontFactor)
        x = np.empty_like(b)
        if not alone or self._node.rank == 0:
            x[:] = deferred(lambda: self.factor.solve(b), b.shape)
        if alone:
            self._node.Bcast(x)
        return x

    def memory(self) -> float | None:
        """Return the memory of the factor in MiB; None if the solver has no figure. Collective."""
        used = on_all(self.factor.memory, self._world)
        rows = 0 if self.inverse is None else self.inverse.nbytes
        rows = self._world.allreduce(rows)
        return self._world.bcast(None if used is None else used + rows / 2**20)

    def __str__(self) -> str:
        """Say how it solves."""
        if self.inverse is not None:
            return f"inverse spread over {self._world.size} process(es)"
        group = self.factor.group if isinstance(self.factor, GroupFactor) else self._node
        return f"a factor on every {group.size} process(es)"

    def pivots(self) -> Pivots:
        """Return how many pivots are negative and zero; None if not known. Collective."""
        return self._world.bcast(on_all(lambda: self.factor.pivots, self._world))

    def _rows_of_inverse(self, factor: FrontFactor) -> Array:
        """Return own rows of N⁻¹, (own rows, K)."""
        unit = np.zeros((len(self._is_b) - self._world.size, self._own.stop - self._own.start))
        np.fill_diagonal(unit[self._own], 1.0)
        return np.ascontiguousarray(factor.solve(unit).T)

    def destroy(self) -> None:
        """Free factor and communicator."""
        self.factor.destroy()
        self._node.Free()


def whole_factor(
    N: PETSc.Mat, counts: Numbers, group: MPI.Comm, *, prefix: str, zero: float | None
) -> FrontFactor | None:
    """Factor a symmetric N on the first process of each group; see ``GatheredSolver``. Collective.

    Returns:
        The factor, without entries where another process has them; None if N is not positive
        definite, or too large, or the options name a solver.

    Raises:
        MemoryError: There is not enough memory; on all processes.
    """
    comm, total = N.comm.tompi4py(), N.getSize()[0]
    code = load_fronts_for(prefix, comm)
    if code is None or PETSc.Options(prefix).hasName("ksp_type") or not total:
        return None
    size, ptr, adjacent = _nodes(N, counts)
    rows = np.arange(total, dtype=np.int32)
    graph, none = (ptr, adjacent), np.zeros(len(size), dtype=bool)
    fronts = on_all(lambda: Fronts(code, rows, rows, size, graph, none), comm)
    if fronts.entries > MOST:
        return None
    least = (EPS * total if zero is None else zero) * N.norm(PETSc.NormType.INFINITY)
    first = group.rank == 0

    def factor() -> FrontFactor | None:
        if not first:
            return FrontFactor(fronts, np.zeros(0))
        with suppress(FactorError), rows_of(matrix) as of_N:
            factored = fronts.factor(of_N, np.empty(fronts.work))
            if factored is not None and factored[0].least_pivot() > least:
                return factored[0]
        return None

    with Lifetime() as owned:
        matrix = owned.own(copy_of_rows(N, slice(0, total if first else 0)))
        factored = on_all(factor, comm)
    return factored if comm.allreduce(factored is not None, op=MPI.LAND) else None


def _nodes(N: PETSc.Mat, counts: Numbers) -> tuple[Indices, Indices, Indices]:
    """Return the sizes of all subdomains that have rows, and the graph of those. Collective.

    All rows of a subdomain have the same columns, so that one of them tells its neighbours.
    """
    comm, some = N.comm.tompi4py(), counts > 0
    first = (N.getOwnershipRange()[0] + np.cumsum(counts) - counts)[some]
    starts = join(first, comm)
    near = [np.unique(np.searchsorted(starts, N.getRow(row)[0], side="right") - 1) for row in first]
    own = [there[starts[there] != row] for there, row in zip(near, first, strict=True)]
    ptr = np.cumsum(np.append(0, join([len(there) for there in own], comm)))
    arrays = join(counts[some], comm), ptr, join(joined(own, np.int64), comm)
    size, ptr, adjacent = (array.astype(np.int32) for array in arrays)
    return size, ptr, adjacent
