# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The copies of the interface dofs: their sum, their average, scalar products.

The primal method keeps an assembled vector x of the interface as its copies T x, (n,). It needs

.. math:: T T^⊤ t, \qquad T T^⊤ δ\, t, \qquad x^⊤ y = (T x)^⊤ δ\, (T y),

the sum and the weighted average of all copies, and the scalar product, with :math:`T^⊤ δ\, T = I`.
A dof with a prescribed value is not among the assembled ones: its copies sum to zero.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.arrays import Array, Indices, Integers, Numbers
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.torn.matrix import Torn


class Copies:
    """The torn interface of this process and where the copies of its dofs are.

    Attributes:
        comm: Communicator of the assembled problem.
        dofs: Torn dofs of the interface, subdomain by subdomain, (n,).
        blocks: Rows of each subdomain in an interface vector.
        n: Length of an interface vector.
        delta: Weight δ of each copy, zero with a prescribed value, (n,).
        row: The rows once for each of their copies, themselves included, ascending, (pairs,).
            Rows with a prescribed value do not occur.
        copy: These copies, by their rows numbered on over all processes, (pairs,).
    """

    def __init__(self, torn: Torn, interface: Sequence[Indices], delta: Array) -> None:
        """Find the copies of each subdomain's interface, for weights δ, (torn.n,). Collective."""
        self.comm = torn.comm
        self.dofs = np.concatenate([*interface, np.zeros(0, dtype=np.int32)])
        self.blocks = consecutive([len(dofs) for dofs in interface])
        self.n = len(self.dofs)
        self.delta = np.where(torn.dirichlet, 0.0, delta)[self.dofs]
        self.row, self.copy = _pairs(torn, self.dofs)
        self._forest = star_forest(self.copy, self.n, self.comm)

    def values(self, t: Array) -> Array:
        """Return t, (n,), at each copy of each row, (pairs,). Collective."""
        copies, own = np.zeros(len(self.row)), np.ascontiguousarray(t)
        self._forest.bcastBegin(MPI.DOUBLE, own, copies, MPI.REPLACE)
        self._forest.bcastEnd(MPI.DOUBLE, own, copies, MPI.REPLACE)
        return copies

    def sum(self, t: Array) -> Array:
        """Sum the copies, T Tᵀ t, (n,), in the same order for each of them. Collective."""
        total = np.bincount(self.row, self.values(t), minlength=self.n)
        return total.astype(np.float64, copy=False)

    def average(self, t: Array) -> Array:
        """Average the copies, T Tᵀ δ t, (n,). Collective."""
        return self.sum(self.delta * t)

    def dots(self, *pairs: tuple[Array, Array]) -> list[float]:
        """Return xᵀ y of pairs of assembled vectors, by their copies, (n,) each. Collective."""
        own = [x @ (self.delta * y) for x, y in pairs]
        return [float(sum_) for sum_ in total_of(np.array(own), self.comm)]

    def destroy(self) -> None:
        """Free the star forest."""
        self._forest.destroy()


def consecutive(sizes: Sequence[int]) -> list[slice]:
    """Return slices of the given sizes, one after the other."""
    end = np.cumsum([0, *sizes]).tolist()
    return [slice(*pair) for pair in itertools.pairwise(end)]


def star_forest(numbers: Numbers, n: int, comm: MPI.Comm) -> PETSc.SF:
    """Build a star forest whose leaves are entries of a distributed vector, n on this process.

    ``numbers`` are those of the leaves over all processes, (leaves,). Collective.
    """
    first = np.concatenate(([0], np.cumsum(comm.allgather(n))))
    rank = np.searchsorted(first, numbers, side="right") - 1
    remote = np.column_stack([rank, numbers - first[rank]]).astype(PETSc.IntType)
    forest = PETSc.SF().create(comm)
    forest.setGraph(n, None, remote)
    return forest


def _pairs(torn: Torn, dofs: Indices) -> tuple[Indices, Numbers]:
    """Return the rows of the interface and, numbered over all processes, their copies."""
    n = len(dofs)
    number = np.full(torn.n, -1.0)
    number[dofs] = torn.comm.scan(n) - n + np.arange(n)
    number[torn.dirichlet] = -1.0
    gathered, degree = torn.gather(number), torn.multiplicity()
    first = np.cumsum(degree) - degree
    rows: list[Integers] = [np.zeros(0, dtype=np.int64)]
    copies: list[Integers] = [np.zeros(0, dtype=np.int64)]
    for c in range(torn.comm.allreduce(int(degree.max(initial=0)), op=MPI.MAX)):
        has = degree > c
        root = np.full(torn.owned, -1.0)
        root[has] = gathered[first[has] + c]
        copy = torn.tear(root)[dofs]  # copy c of each dof
        rows.append(np.flatnonzero((copy >= 0.0) & (number[dofs] >= 0.0)))
        copies.append(copy[rows[-1]].astype(np.int64))
    row = np.concatenate(rows)
    order = np.argsort(row, kind="stable")
    return row[order].astype(np.int32), np.concatenate(copies)[order].astype(np.int64)
