# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""M G as dense blocks, one for each subdomain, for Q = M.

.. math:: W_i = (B_D^⊤ G)_i, \quad Y_i = (S_i + Y_Z Y_Z^⊤)\, W_i, \qquad
          M G\, s = B_D\, Y s, \quad G^⊤ M\, r = Y^⊤ B_D^⊤ r, \quad
          G^⊤ M\, G = \sum_i W_i^⊤ Y_i

with the columns near each subdomain (``near``). As a sparse matrix M G has in each row the columns
of two subdomains and all of their neighbours: many times as many entries as the blocks.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.coarse.fields import jump_fields
from dolfinx_feti.feti.coarse.near import NearColumns, joined
from dolfinx_feti.feti.copies import Copies
from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.preconditioner.base import Preconditioner
from dolfinx_feti.feti.subdomain.pseudoinverse import Modes

__all__ = ["WeightedColumns"]

Array = npt.NDArray[np.float64]


class WeightedColumns:
    """M G for G = B E.

    Attributes:
        blocks: For each subdomain :math:`Y_i`, (n_i, c_i).
    """

    def __init__(self, gluing: Gluing, modes: Modes, preconditioner: Preconditioner) -> None:
        """Form the blocks.

        Args:
            gluing: The weights δ.
            modes: E of every subdomain.
            preconditioner: M.

        Note:
            Collective.
        """
        self._M = preconditioner
        self._copies = Copies(preconditioner.torn, preconditioner.interface, gluing.delta)
        on_interface = preconditioner.on_interface
        self._E = [E[on] for E, on in zip(modes.E, on_interface, strict=True)]
        self._E_left = self._E
        if not modes.symmetric:
            self._E_left = [E[on] for E, on in zip(modes.E_left, on_interface, strict=True)]
        self.blocks, numbers = [], []
        for i, W in enumerate(jump_fields(self._copies, self._E)):
            self.blocks.append(preconditioner.image(i, W.values))  # Y = (S + Y_Z Y_Zᵀ) W
            numbers.append(W.numbers)
        counts = [E.shape[1] for E in self._E]
        self._near = NearColumns(numbers, counts, preconditioner.torn.comm)

    def galerkin_matrix(self) -> PETSc.Mat:
        """Form Gᵀ M G, (K, K), with G from Kᵀ on the left; the caller destroys it. Collective."""
        fields = zip(jump_fields(self._copies, self._E_left), self.blocks, strict=True)
        return self._near.sum(W.values.T @ Y for W, Y in fields)

    def multiply(self, s: Array) -> Array:
        """Return M G s, (K,) → (m,) or (K, r) → (m, r). Collective."""
        if s.ndim == 2:
            columns = [self.multiply(s[:, j]) for j in range(s.shape[1])]
            return np.stack(columns, axis=1) if columns else self._M.B_D @ s
        near, copies = self._near.from_owners(s), self._copies
        t = np.zeros(self._M.torn.n)
        blocks = zip(self.blocks, self._near.blocks, strict=True)
        t[copies.dofs] = joined([Y @ near[columns] for Y, columns in blocks])
        return self._M.B_D @ t  # B_D Y s

    def restrict(self, r: Array) -> Array:
        """Return Gᵀ M r for a symmetric M, (m,) → (K,). Collective."""
        w = (self._M.B_D.T @ r)[self._copies.dofs]  # w = B_Dᵀ r
        blocks = zip(self.blocks, self._copies.blocks, strict=True)
        return self._near.to_owners(joined([Y.T @ w[rows] for Y, rows in blocks]))

    def destroy(self) -> None:
        """Free the star forests."""
        self._near.destroy()
        self._copies.destroy()
