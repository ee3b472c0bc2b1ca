# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The copies of the interface dofs: their sum, their weighted average, scalar products.

A vector x on the assembled interface is represented by its copies :math:`t = T x`. The formulas are

.. math:: T T^⊤ t, \qquad T T^⊤ δ\, t, \qquad x^⊤ y = (T x)^⊤ δ\, (T y),

the sum and the weighted average of all copies, and the scalar product, with :math:`T^⊤ δ\, T = I`.
The copies of a process form an *interface vector*, :math:`(n_Γ,)`: a row for each interface dof of
each subdomain, one subdomain after the other, :math:`n_Γ = \sum_i n_{Γ,i}`.

In all-floating FETI the interface contains dofs with a prescribed value. They have rows, but are no
unknowns of the assembled interface: sums and averages are zero in these rows.
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.arrays import (
    Array,
    Indices,
    Integers,
    Numbers,
    concatenate,
    consecutive_slices,
)
from dolfinx_feti.runtime.collective import DeferredErrors, total_of
from dolfinx_feti.runtime.star_forest import Value, broadcast, create_star_forest
from dolfinx_feti.torn.matrix import Torn


class Copies:
    """The rows of interface vectors, and for each row all copies of its dof on any process.

    A *pair* is a row of this process with one copy of its dof: a term in the sum of the copies. The
    row of a dof with d copies has d pairs, one of them with itself. For example, a dof with copies
    in the rows 3 and 8 has the pairs (3, 3), (3, 8), (8, 3) and (8, 8).

    Attributes:
        comm: Communicator of the assembled problem.
        errors: Store for the errors of local work in iterations on interface vectors.
        dofs: Torn dof of each row, (n_Γ,).
        rows: Rows of each subdomain, a slice for each.
        size: Number n_Γ of rows.
        delta: Weight δ of each row, zero if its dof has a prescribed value, (n_Γ,).
        pair_rows: Row of each pair, ascending, (pairs,). Rows with a prescribed value have no pair.
        pair_copies: Copy of each pair, as a row numbered over all processes, (pairs,).
    """

    def __init__(
        self, torn: Torn, interfaces: Sequence[Indices], delta: Array, errors: DeferredErrors
    ) -> None:
        """Find the copies of the interface dofs. Collective.

        Args:
            torn: The torn matrix.
            interfaces: Interface dofs of each subdomain, torn dofs of this process, (n_{Γ,i},)
                each.
            delta: Weight δ of every torn dof, (n,).
            errors: Store for the errors of local work in iterations.
        """
        self.comm = torn.comm
        self.errors = errors
        self.dofs = concatenate(interfaces, np.int32)
        self.rows = consecutive_slices([len(dofs) for dofs in interfaces])
        self.size = len(self.dofs)
        self.delta = np.where(torn.is_dirichlet_copy, 0.0, delta)[self.dofs]
        self.pair_rows, self.pair_copies = _find_pairs(torn, self.dofs)
        self._forest = create_star_forest(self.pair_copies, self.size, self.comm)

    def fetch(self, t: npt.NDArray[Value]) -> npt.NDArray[Value]:
        """Return the entry of an interface vector in the copy of each pair. Collective.

        Args:
            t: Floating-point numbers or 64-bit integers, (n_Γ,).

        Returns:
            Entries of the same type, (pairs,), in the order of ``pair_copies``.
        """
        return broadcast(self._forest, t, len(self.pair_rows))

    def sum(self, t: Array) -> Array:
        """Return the sum of the copies, T Tᵀ t, (n_Γ,) → (n_Γ,). Collective.

        All copies of the result are equal to the last bit, because each row adds the same entries
        in the same order.
        """
        sums = np.bincount(self.pair_rows, self.fetch(t), minlength=self.size)  # T Tᵀ t
        return sums.astype(np.float64, copy=False)

    def average(self, t: Array) -> Array:
        """Return the weighted average of the copies, T Tᵀ δ t, (n_Γ,) → (n_Γ,). Collective."""
        return self.sum(self.delta * t)

    def dots(self, *factors: tuple[Array, Array]) -> list[float]:
        """Return xᵀ y for each (x, y) of vectors given by their copies, (n_Γ,). Collective."""
        return self.dots_and_sums(factors, np.zeros(0))[0]

    def dots_and_sums(
        self, factors: Sequence[tuple[Array, Array]], addends: Array
    ) -> tuple[list[float], Array]:
        """Return scalar products and further sums over all processes, in one reduction. Collective.

        Args:
            factors: Vectors (x, y) of each scalar product, given by their copies, (n_Γ,).
            addends: Terms of this process in the further sums, (k,).

        Returns:
            xᵀ y of each (x, y), and the sums, (k,).
        """
        products = [x @ (self.delta * y) for x, y in factors]  # (T x)ᵀ δ (T y)
        sums = total_of(np.concatenate([products, addends]), self.comm)
        return [float(product) for product in sums[: len(products)]], sums[len(products) :]

    def destroy(self) -> None:
        """Free the star forest."""
        self._forest.destroy()


def _find_pairs(torn: Torn, dofs: Indices) -> tuple[Indices, Numbers]:
    """Find all pairs of a row and a copy of its dof. Collective.

    Only the owner of a dof has the list of its copies, and ``Torn.tear`` sends one number of each
    dof to all its copies. The lists are therefore sent entry by entry: in pass c, each copy
    receives the c-th copy of its dof. A dof with copies in the rows 3 and 8 thus forms the pairs
    (3, 3) and (8, 3) in the first pass, and (3, 8) and (8, 8) in the second one.

    Args:
        torn: The torn matrix.
        dofs: Torn dof of each row, (n_Γ,).

    Returns:
        ``Copies.pair_rows`` and ``Copies.pair_copies``, (pairs,) each.
    """
    size = len(dofs)
    # Row of each torn dof, numbered over all processes; −1 if it has none, or a prescribed value.
    row_number = np.full(torn.n, -1, dtype=np.int64)
    row_number[dofs] = torn.comm.scan(size) - size + np.arange(size)
    row_number[torn.is_dirichlet_copy] = -1
    has_row = row_number[dofs] >= 0

    # The lists of the owned dofs, one after the other.
    copies = torn.gather(row_number)
    multiplicity = torn.multiplicity()
    list_start = np.cumsum(multiplicity) - multiplicity

    pair_rows: list[Integers] = []
    pair_copies: list[Integers] = []
    passes = torn.comm.allreduce(int(multiplicity.max(initial=0)), op=MPI.MAX)
    for c in range(passes):
        has_entry = multiplicity > c
        entry = np.full(torn.N, -1, dtype=np.int64)
        entry[has_entry] = copies[list_start[has_entry] + c]
        copy_of_row = torn.tear(entry)[dofs]
        is_pair = has_row & (copy_of_row >= 0)
        pair_rows.append(np.flatnonzero(is_pair))
        pair_copies.append(copy_of_row[is_pair])
    rows = concatenate(pair_rows, np.int64)
    order = np.argsort(rows, kind="stable")
    return rows[order].astype(np.int32), concatenate(pair_copies, np.int64)[order]
