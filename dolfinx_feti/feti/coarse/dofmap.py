# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The coarse dofs of each subdomain, their owners, and the exchange of coarse vectors.

.. math:: e = \sum_i C_i^⊤ e_i, \qquad s_i = C_i\, s

A coarse dof belongs to the subdomain that contributes its column, and to the neighbours on whose
interface the column is nonzero: to the c_i columns of :math:`W_i` (``basis``). Its owner is the
process of the contributor; processes of neighbours have it as a ghost. The boolean :math:`C_i`,
(c_i, N_c), restricts a coarse vector to subdomain i, as the dof map of a finite element does to a
cell.
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.coarse.basis import LocalCoarseBasis
from dolfinx_feti.runtime.arrays import Array, Integers, Numbers, concatenate, consecutive_slices
from dolfinx_feti.runtime.star_forest import broadcast, create_star_forest, sum_leaves


class CoarseDofMap:
    """The coarse dofs of each subdomain of this process, owned ones and ghosts.

    A *torn* coarse vector, (c,), has the dofs of all subdomains of this process, one subdomain
    after the other, c = Σ c_i. A *distributed* one, (n_c,), has each dof once, at its owner.

    Attributes:
        comm: Communicator of the columns.
        rows: Rows of each subdomain in a torn vector, c_i of them.
        c: Length of a torn vector.
        n_c: Number of dofs that this process owns.
        N_c: Number of dofs over all processes.
        panels: Panels of each subdomain, among all of this process.
        first_dofs: First coarse dof of each panel over all processes, (panels,).
        widths: Number of dofs of each panel, (panels,).
    """

    def __init__(
        self, basis: LocalCoarseBasis, block_widths: Sequence[int], comm: MPI.Comm
    ) -> None:
        """Find the owners of all dofs. Collective.

        Args:
            basis: The columns on the interface of each subdomain.
            block_widths: Number k_i of columns that each subdomain contributes. Those of a
                subdomain without interface count, too; the basis has no panel for them.
            comm: Communicator of the columns.
        """
        self.comm = comm
        self.n_c = sum(block_widths)
        self.N_c = comm.allreduce(self.n_c)
        columns = [W_i.shape[1] for W_i in basis.W]  # c_i
        self.rows = consecutive_slices(columns)
        self.c = sum(columns)
        self.panels = consecutive_slices([len(first) for first in basis.first_dofs])
        self.first_dofs = concatenate(basis.first_dofs, np.int64)
        self.widths = concatenate([W_i.widths for W_i in basis.W], np.int32)
        dofs = consecutive_numbers(self.first_dofs, self.widths)  # of a torn vector, (c,)
        self._forest = create_star_forest(dofs, self.n_c, comm)

    def scatter_reverse(self, torn_e: Array) -> Array:
        """Return the sums Σ C_iᵀ e_i of a torn vector at the owners, (c,) → (n_c,). Collective."""
        return sum_leaves(self._forest, torn_e, self.n_c)

    def scatter_forward(self, s: Array) -> Array:
        """Return the torn vector of C_i s of a distributed one, (n_c,) → (c,). Collective."""
        return broadcast(self._forest, s, self.c)

    def destroy(self) -> None:
        """Free the star forest."""
        self._forest.destroy()


def consecutive_numbers(first: Integers, count: Integers) -> Numbers:
    """Return the numbers ``first[i], …, first[i] + count[i] − 1`` for each i, concatenated."""
    end = np.cumsum(count)
    return np.arange(count.sum()) + np.repeat(first - end + count, count)
