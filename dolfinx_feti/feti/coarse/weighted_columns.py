# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""M G of the dual formulation, stored as a dense matrix for each subdomain.

.. math:: W_i = (B_D^⊤ G)_i, \quad X_i = (Y_i + Y_{Z,i} Y_{Z,i}^⊤)\, W_i, \qquad
          M G\, s = B_D\, X s, \quad G^⊤ M\, r = X^⊤ B_D^⊤ r, \quad
          G^⊤ M\, G = \sum_i C_i^⊤ (W_i^⊤ X_i)\, C_i

on the interface of each subdomain, (n_{Γ,i}, c_i), with its own columns and those of its neighbours
(``basis``). :math:`Y_i` is that of the preconditioner, θI, K_i or S_i, and
:math:`Y_{Z,i} Y_{Z,i}^⊤` its stabilisation (``preconditioners.base``). As a sparse matrix, M G
would have more entries than all X_i together: a multiplier couples two subdomains and all their
neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.coarse.assembly import CoarseAssembler
from dolfinx_feti.feti.coarse.basis import jump_columns
from dolfinx_feti.feti.coarse.dofmap import CoarseDofMap
from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.preconditioners.base import Preconditioner
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.generalized_inverse import GeneralizedInverse
from dolfinx_feti.runtime.arrays import Array, concatenate
from dolfinx_feti.runtime.lifetime import Lifetime


@dataclass(frozen=True, slots=True)
class SubdomainWeightedColumns:
    """X_i of one subdomain.

    Attributes:
        rows: Rows of the subdomain in an interface vector, (n_Γ,).
        dofs: Its coarse dofs, as a slice of a torn coarse vector, (c,).
        X: :math:`X_i`, (n_{Γ,i}, c_i).
    """

    rows: slice
    dofs: slice
    X: Array


class WeightedColumns:
    """M G; created by :func:`compute_weighted_columns`.

    Attributes:
        by_subdomain: :math:`X_i` of each subdomain.
    """

    def __init__(
        self,
        preconditioner: Preconditioner,
        copies: Copies,
        dofmap: CoarseDofMap,
        by_subdomain: Sequence[SubdomainWeightedColumns],
    ) -> None:
        """Own copies and dof map: :meth:`destroy` frees them.

        Args:
            preconditioner: M, with B_D; it outlives this object.
            copies: Copies of the interface dofs.
            dofmap: Owners of the coarse dofs.
            by_subdomain: X_i of each subdomain.
        """
        self.by_subdomain = by_subdomain
        self._M = preconditioner
        self._copies = copies
        self._dofmap = dofmap

    def multiply(self, s: Array) -> Array:
        """Return M G s, (n_c,) → (m,). Collective."""
        torn_s = self._dofmap.scatter_forward(s)
        t = np.zeros(self._M.operator.torn.n)
        t[self._copies.dofs] = concatenate(
            [columns.X @ torn_s[columns.dofs] for columns in self.by_subdomain]  # X s
        )
        return self._M.B_D @ t  # B_D X s

    def multiply_transposed(self, r: Array) -> Array:
        """Return Gᵀ M r, (m,) → (n_c,). Collective."""
        w = (self._M.B_D.T @ r)[self._copies.dofs]  # w = B_Dᵀ r
        torn_e = concatenate(
            [columns.X.T @ w[columns.rows] for columns in self.by_subdomain]  # Xᵀ w
        )
        return self._dofmap.scatter_reverse(torn_e)  # Σ C_iᵀ X_iᵀ w_i

    def destroy(self) -> None:
        """Free copies and dof map."""
        self._dofmap.destroy()
        self._copies.destroy()


def compute_weighted_columns(
    preconditioner: Preconditioner, delta: Array, inverse: GeneralizedInverse
) -> tuple[WeightedColumns, PETSc.Mat]:
    """Compute M G and Gᵀ M G, in one pass over the subdomains. Collective.

    Args:
        preconditioner: M, with B_D.
        delta: Weight δ of every torn dof, (n,).
        inverse: K⁺, with E of each subdomain.

    Returns:
        M G, and Gᵀ M G, (N_c, N_c); the caller destroys both.

    Raises:
        SetUpError: A product failed on some subdomain; on all processes.
    """
    operator = preconditioner.operator
    comm = operator.torn.comm
    with Lifetime() as owned:
        copies = owned.own(Copies(operator.torn, operator.interfaces, delta, operator.errors))
        E = inverse.E_on_interface(comm)
        jumps = jump_columns(copies, E)
        dofmap = owned.own(CoarseDofMap(jumps, comm))
        assembler = CoarseAssembler(jumps, dofmap)
        by_subdomain: list[SubdomainWeightedColumns] = []

        def compute() -> None:
            for i, columns in enumerate(jumps):
                W_i = columns.W
                X_i = preconditioner.multiply_stabilised(i, W_i)  # (Y_i + Y_Z Y_Zᵀ) W_i
                by_subdomain.append(SubdomainWeightedColumns(columns.rows, columns.dofs, X_i))
                assembler.add(i, W_i.multiply_transposed(X_i))  # W_iᵀ X_i

        on_subdomains(compute, comm)
        galerkin_matrix = assembler.assemble()  # Gᵀ M G
        owned.release()  # WeightedColumns takes over copies and dof map
    return WeightedColumns(preconditioner, copies, dofmap, by_subdomain), galerkin_matrix
