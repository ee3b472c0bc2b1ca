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
from dolfinx_feti.runtime.arrays import Array, concatenate


class AveragedBasis:
    """The coarse basis V.

    Vectors on the assembled interface are given by their copies, (n_Γ,): all copies of a dof have
    its value, in arguments and results.

    Attributes:
        copies: Copies of the interface dofs; their creator destroys them.
        by_subdomain: Columns U_i that each subdomain contributes, and W_i = (T V)_i with those of
            its neighbours.
        dofmap: Owners of the coarse dofs.
        n_c: Number of columns of this process.
        N_c: Number of columns over all processes.
    """

    def __init__(self, copies: Copies, U: Sequence[Array]) -> None:
        """Average the columns. Collective.

        Args:
            copies: Copies of the interface dofs, with the weights δ.
            U: Columns that each subdomain contributes, (n_{Γ,i}, k_i). Dependent columns are
                allowed: ``energy`` drops combinations of zero energy within a subdomain, and the
                coarse solver leaves out zero pivots, which columns of several subdomains cause.
        """
        self.copies = copies
        self.by_subdomain = averaged_columns(copies, [np.asfortranarray(U_i) for U_i in U])
        self.dofmap = CoarseDofMap(self.by_subdomain, copies.comm)
        self.n_c = self.dofmap.n_c
        self.N_c = self.dofmap.N_c

    def restrict(self, r: Array) -> Array:
        """Return Vᵀ r of an assembled residual by its copies, (n_Γ,) → (n_c,)."""
        t = self.copies.delta * r  # δ T r
        return concatenate(
            [columns.U.T @ t[columns.rows] for columns in self.by_subdomain]  # Uᵀ δ T r
        )

    def prolong(self, s: Array) -> Array:
        """Return V s by its copies, (n_c,) → (n_Γ,). Collective."""
        t = np.empty(self.copies.size)
        for columns in self.by_subdomain:
            t[columns.rows] = columns.U @ s[columns.block]  # U_i s_i
        return self.copies.average(t)  # T Tᵀ δ U s

    def destroy(self) -> None:
        """Free the star forest of the dof map."""
        self.dofmap.destroy()
