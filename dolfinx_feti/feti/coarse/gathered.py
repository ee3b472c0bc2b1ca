# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A small distributed system N x = b: a factor, or the inverse, spread over all processes.

A solve gives b to all in one collective call, with a number that each process adds to a sum. Each
process takes its x from a factor of N: that of its node (``whole``), or that of its group of
processes (``group``) where N may be indefinite or is too large, or the options name a solver. The
first process of a node solves for all of it, since they share one memory bus: the entries of the
factor are read twice, whatever the number of processes. Up to :data:`SPREAD` rows of N for each
process, its rows of the inverse solve, which it makes with a factor of its own: it reads K²/P
numbers in a solve.
"""

from __future__ import annotations

from functools import partial

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.coarse.group import GroupFactor, processes_of_node
from dolfinx_feti.feti.coarse.whole import whole_factor
from dolfinx_feti.feti.subdomain.factors.multifrontal import FrontFactor
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.collective import deferred, on_all, reason
from dolfinx_feti.runtime.events import event

__all__ = ["GatheredSolver"]


#: Rows of the inverse for each process, on average, up to which they are formed: in blocks, six of
#: them take as long as one solve with the factor, and a matrix serves some thirty solves.
SPREAD = 128

#: Condition number, of the norm of the largest row, above which the factor solves, and better.
CONDITION = 1e10


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
            counts: Rows of each subdomain of this process, which N couples in blocks; None for a
                matrix without such blocks, or one that is known to be indefinite.

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
        whole, rows, spread = None, None, total <= SPREAD * comm.size
        self._node = MPI.COMM_SELF.Dup() if spread else processes_of_node(comm)
        try:
            if symmetric and counts is not None:
                whole = whole_factor(N, counts, self._node, prefix=prefix, zero=zero)
            if whole is not None and spread:
                rows = on_all(partial(self._rows_of_inverse, whole), comm)
            self.factor = whole or GroupFactor(N, prefix=prefix, symmetric=symmetric, zero=zero)
        except Exception as error:
            self._node.Free()
            raise SetUpError(
                f"The coarse problem could not be factored ({reason(error)}): look at the options "
                f"-{prefix}…"
            ) from error
        if rows is not None and self._is_accurate(N, rows):
            self.inverse = rows

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
        spread = self._world.allreduce(rows) / 2**20
        return self._world.bcast(None if used is None else used + spread)

    def __str__(self) -> str:
        """Say how it solves."""
        if self.inverse is not None:
            return f"inverse spread over {self._world.size} process(es)"
        if isinstance(self.factor, GroupFactor):
            return str(self.factor)
        return f"a factor on every {self._node.size} process(es)"

    def pivots(self) -> Pivots:
        """Return how many pivots are negative and zero; None if not known. Collective."""
        return self._world.bcast(on_all(lambda: self.factor.pivots, self._world))

    def _rows_of_inverse(self, factor: FrontFactor) -> Array:
        """Return own rows of N⁻¹, (own rows, K)."""
        unit = np.zeros((len(self._is_b) - self._world.size, self._own.stop - self._own.start))
        np.fill_diagonal(unit[self._own], 1.0)
        return np.ascontiguousarray(factor.solve(unit).T)

    def _is_accurate(self, N: PETSc.Mat, rows: Array) -> bool:
        """Tell whether rounding leaves a solve with the inverse some digits. Collective."""
        largest = np.abs(rows).sum(axis=1).max(initial=0.0)
        condition = largest * N.norm(PETSc.NormType.INFINITY)
        return bool(self._world.allreduce(bool(condition <= CONDITION), op=MPI.LAND))

    def destroy(self) -> None:
        """Free factor and communicator."""
        self.factor.destroy()
        self._node.Free()
