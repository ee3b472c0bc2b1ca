# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""M G as dense blocks, one for each subdomain, for Q = M.

.. math:: W_i = (B_D^⊤ G)_i, \quad Y_i = (S_i + Y_Z Y_Z^⊤)\, W_i, \qquad
          M G\, s = B_D\, Y s, \quad G^⊤ M\, r = Y^⊤ B_D^⊤ r, \quad
          G^⊤ M\, G = \sum_i W_i^⊤ Y_i

with the columns near each subdomain (``near``): far fewer entries than M G as a sparse matrix.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.coarse.fields import jump_fields
from dolfinx_feti.feti.coarse.near import NearColumns, joined
from dolfinx_feti.feti.dual.preconditioner import Preconditioner
from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.subdomain.modes import SubdomainModes
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.lifetime import Lifetime

__all__ = ["WeightedColumns"]


class WeightedColumns:
    """M G for G = B E.

    Attributes:
        blocks: For each subdomain :math:`Y_i`, (n_i, c_i).
        galerkin_matrix: Gᵀ M G, (K, K).
        complete: Whether all columns are near some subdomain, and no row of it is empty.
    """

    def __init__(
        self, delta: Array, modes: Sequence[SubdomainModes], preconditioner: Preconditioner
    ) -> None:
        """Form the blocks, for weights δ, (n,), and E of every subdomain. Collective."""
        operator = preconditioner.operator
        self._M, self._torn = preconditioner, operator.torn
        on_interface = operator.on_interface
        with Lifetime() as owned:
            self._copies = owned.own(Copies(operator.torn, operator.interface, delta))
            E = [m.E[on] for m, on in zip(modes, on_interface, strict=True)]
            W = jump_fields(self._copies, E)
            counts = [E_i.shape[1] for E_i in E]
            self._near = owned.own(NearColumns(W, counts, operator.torn.comm))
            self.blocks: list[Array] = []

            def elements() -> Iterator[Array]:
                for i in range(len(W)):
                    W_i = W[i]
                    self.blocks.append(preconditioner.image(i, W_i))  # Y = (S + Y_Z Y_Zᵀ) W
                    yield W_i.overlap(self.blocks[i])

            self.galerkin_matrix = owned.own(self._near.sum(elements()))
            reached = self._near.to_owners(np.ones(int(W.count.sum())))
            self.complete = operator.torn.comm.allreduce(bool(np.all(reached > 0.0)), op=MPI.LAND)
            self._owned = owned.pop_all()

    def multiply(self, s: Array) -> Array:
        """Return M G s, (K,) → (m,). Collective."""
        near, copies = self._near.from_owners(s), self._copies
        t = np.zeros(self._torn.n)
        blocks = zip(self.blocks, self._near.blocks, strict=True)
        t[copies.dofs] = joined([Y @ near[columns] for Y, columns in blocks])
        return self._M.B_D @ t  # B_D Y s

    def restrict(self, r: Array) -> Array:
        """Return Gᵀ M r, (m,) → (K,). Collective."""
        w = (self._M.B_D.T @ r)[self._copies.dofs]  # w = B_Dᵀ r
        blocks = zip(self.blocks, self._copies.blocks, strict=True)
        return self._near.to_owners(joined([Y.T @ w[rows] for Y, rows in blocks]))

    def destroy(self) -> None:
        """Free star forests and matrix."""
        self._owned.close()
