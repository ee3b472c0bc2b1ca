# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The matrix of one subdomain that :math:`K^+` inverts.

It is :math:`K_i` on the free dofs of the subdomain, or, if the interior is eliminated, :math:`S_i`
on its interface (``schur.FormedSchurComplement``).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dolfinx_feti.feti.subdomain.analysis import Analysis
from dolfinx_feti.feti.subdomain.blocks import multiply_block
from dolfinx_feti.feti.subdomain.factors.create import SparseBlock, factor_sparse
from dolfinx_feti.feti.subdomain.factors.protocol import Factor
from dolfinx_feti.feti.subdomain.factors.work_space import WorkSpace
from dolfinx_feti.feti.subdomain.subdomain import Subdomain
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.torn.matrix import Torn


class SubdomainMatrix(Protocol):
    """K_i of one subdomain, (n_i, n_i), or S_i, (n_{Γ,i}, n_{Γ,i}).

    Below it is called K, and the number of its rows n_i. It is valid until the entries of
    ``torn.K`` change.
    """

    @property
    def subdomain(self) -> Subdomain:
        """The subdomain."""

    @property
    def dofs(self) -> Indices:
        """Torn dofs of its rows, (n_i,): the free ones of the subdomain, or Γ."""

    @property
    def diagonal_of_K(self) -> Array:
        """Absolute diagonal of K_i on ``dofs``, even if the matrix is S_i, (n_i,).

        It is the scale on which a stiffness counts as zero. The diagonal of S_i cannot be that
        scale: an entry of it is zero if a mode without energy moves its dof, but no other dof of Γ.
        """

    def modes_on_dofs(self, R: Array) -> Array:
        """Return an orthonormal basis of modes on ``dofs``, (n_i, k).

        Args:
            R: Orthonormal modes on the free dofs of the subdomain.
        """

    def multiply(self, X: Array) -> Array:
        """Return K X, (n_i, r)."""

    def factor(
        self, R: Array, rho: float, shift: Array | None = None, *, is_graded: bool = False
    ) -> Factor:
        """Factor K + ρ R Rᵀ + diag(shift), in double precision.

        Args:
            R: Columns, (n_i, k); orthonormal unless they are graded or there is a shift.
            rho: The stiffness ρ.
            shift: Addend of the diagonal, (n_i,); None for zero.
            is_graded: Whether the norms of the rows of R span many orders of magnitude. Some
                factorisations cannot handle that (``factors.create``).

        Raises:
            FactorError: The matrix cannot be factored.
        """

    def factor_for_preconditioner(self, R: Array, rho: float) -> Factor:
        """Factor K + ρ R Rᵀ as a preconditioner, in single precision if possible.

        This requires that K is an S_i, and that the matrix is positive definite in single
        precision. Otherwise the factor is the same as that of :meth:`factor`.
        """


class SparseSubdomainMatrix:
    """K_i of one subdomain, sparse: a :class:`SubdomainMatrix`.

    Attributes:
        subdomain: The subdomain.
        diagonal_of_K: Its absolute diagonal, (n_i,).
    """

    def __init__(self, subdomain: Subdomain, block: SparseBlock, diagonal_of_K: Array) -> None:
        """Refer to the block of one subdomain in K.

        Args:
            subdomain: The subdomain.
            block: Its block K_i, of which the rows are its free dofs.
            diagonal_of_K: Absolute diagonal of K_i, (n_i,).
        """
        self.subdomain = subdomain
        self.diagonal_of_K = diagonal_of_K
        self._block = block

    @property
    def dofs(self) -> Indices:
        """Torn dofs of its rows, (n_i,)."""
        return self.subdomain.free_dofs

    def modes_on_dofs(self, R: Array) -> Array:
        """Return R, (n_i, k): the rows are all free dofs."""
        return R

    def multiply(self, X: Array) -> Array:
        """Return K_i X, (n_i, r)."""
        return multiply_block(self._block.K, self.dofs, self.dofs, X)

    def factor(
        self, R: Array, rho: float, shift: Array | None = None, *, is_graded: bool = False
    ) -> Factor:
        """Factor K_i + ρ R Rᵀ + diag(shift); see :class:`SubdomainMatrix`."""
        return factor_sparse(self._block, R, rho, shift, is_graded=is_graded)

    def factor_for_preconditioner(self, R: Array, rho: float) -> Factor:
        """Factor K_i + ρ R Rᵀ in double precision: there are no sparse factors in single."""
        return self.factor(R, rho)


def create_sparse_matrices(torn: Torn, analysis: Analysis) -> list[SparseSubdomainMatrix]:
    """Create K_i of each subdomain of this process.

    Args:
        torn: The torn matrix. The results refer to it, and are valid until its entries change.
        analysis: The subdomains with symbolic factors of K_i, if the interior is kept.
    """
    diagonal = np.abs(torn.diagonal())
    work = WorkSpace()
    matrices = []
    for analysed in analysis.by_subdomain:
        s = analysed.subdomain
        K_i = SparseBlock(
            torn.K, s.free_dofs, analysis.local_options, analysed.local_symbolic, work
        )
        matrices.append(SparseSubdomainMatrix(s, K_i, diagonal[s.free_dofs]))
    return matrices
