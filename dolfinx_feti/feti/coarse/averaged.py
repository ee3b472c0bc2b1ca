# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The averaged coarse basis of the primal formulation, and its transpose.

.. math:: V = T^⊤ δ\, U

with the columns :math:`U_i` that each subdomain contributes, (n_{Γ,i}, k_i). V depends on a matrix
only by δ and U. In Newton's method it serves later matrices with the same interface.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_feti.feti.coarse.basis import averaged_columns
from dolfinx_feti.feti.coarse.dofmap import CoarseDofMap
from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.runtime.arrays import Array, concatenate, consecutive_slices


class AveragedBasis:
    """The coarse basis V.

    Vectors on the assembled interface are given by their copies, (n_Γ,): all copies of a dof have
    its value, in arguments and results.

    Attributes:
        copies: Copies of the interface dofs; their creator destroys them.
        U: Columns that each subdomain contributes, (n_{Γ,i}, k_i).
        blocks: Block of each subdomain, as a slice of a coarse vector, (n_c,).
        n_c: Number of columns of this process.
        N_c: Number of columns over all processes.
        W: (T V)_i of each subdomain, with the columns of its neighbours, (n_{Γ,i}, c_i).
        dofmap: Coarse dofs of each subdomain.
    """

    def __init__(self, copies: Copies, U: Sequence[Array]) -> None:
        """Average the columns. Collective.

        Args:
            copies: Copies of the interface dofs, with the weights δ.
            U: Columns that each subdomain contributes, (n_{Γ,i}, k_i). Dependent columns are
                allowed: ``energy`` drops combinations of zero energy within a subdomain, and the
                coarse solver leaves out zero pivots, which columns of several subdomains cause.
        """
        widths = [U_i.shape[1] for U_i in U]
        basis = averaged_columns(copies, U)
        self.copies = copies
        self.U = [np.asfortranarray(U_i) for U_i in U]
        self.blocks = consecutive_slices(widths)
        self.W = basis.W
        self.dofmap = CoarseDofMap(basis, widths, copies.comm)
        self.n_c = self.dofmap.n_c
        self.N_c = self.dofmap.N_c

    def restrict(self, r: Array) -> Array:
        """Return Vᵀ r of an assembled residual by its copies, (n_Γ,) → (n_c,)."""
        t = self.copies.delta * r  # δ T r
        subdomains = zip(self.U, self.copies.rows, strict=True)
        return concatenate([U_i.T @ t[rows] for U_i, rows in subdomains])  # Uᵀ δ T r

    def prolong(self, s: Array) -> Array:
        """Return V s by its copies, (n_c,) → (n_Γ,). Collective."""
        t = np.empty(self.copies.size)
        subdomains = zip(self.U, self.copies.rows, self.blocks, strict=True)
        for U_i, rows, block in subdomains:
            t[rows] = U_i @ s[block]
        return self.copies.average(t)  # T Tᵀ δ U s

    def destroy(self) -> None:
        """Free the star forest of the dof map."""
        self.dofmap.destroy()
