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

from dolfinx_feti.feti.coarse.basis import SubdomainColumns
from dolfinx_feti.runtime.arrays import Array, Integers, Numbers, concatenate
from dolfinx_feti.runtime.star_forest import broadcast, create_star_forest, sum_leaves


class CoarseDofMap:
    """The coarse dofs of each subdomain of this process, owned ones and ghosts.

    A *torn* coarse vector, (c,), has the dofs of all subdomains of this process, one subdomain
    after the other, c = Σ c_i. A *distributed* one, (n_c,), has each dof once, at its owner.

    Attributes:
        comm: Communicator of the columns.
        c: Length of a torn vector.
        n_c: Number of dofs that this process owns.
        N_c: Number of dofs over all processes.
    """

    def __init__(self, by_subdomain: Sequence[SubdomainColumns], comm: MPI.Comm) -> None:
        """Find the owners of all dofs. Collective.

        Args:
            by_subdomain: The columns of each subdomain of this process. Those that a subdomain
                without interface contributes have dofs, too, but no panel.
            comm: Communicator of the columns.
        """
        self.comm = comm
        self.n_c = sum(columns.U.shape[1] for columns in by_subdomain)  # Σ k_i
        self.N_c = comm.allreduce(self.n_c)
        self.c = sum(columns.W.shape[1] for columns in by_subdomain)  # Σ c_i
        first_dofs = concatenate([columns.first_dofs for columns in by_subdomain], np.int64)
        widths = concatenate([columns.W.widths for columns in by_subdomain], np.int32)
        dofs = consecutive_numbers(first_dofs, widths)  # of a torn vector, (c,)
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
