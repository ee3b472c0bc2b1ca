# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The Schur complement of one subdomain.

.. math:: S_i = K_{ΓΓ} - K_{ΓI} K_{II}^{-1} K_{IΓ}

(eq. 51 of the paper). If the interior is kept, :math:`S_i` is *applied*, by a sparse factor of
:math:`K_{II}`. If it is eliminated, :math:`S_i` is *formed*, and replaces :math:`K_i` in the
generalised inverse.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import partial

from petsc4py import PETSc

from dolfinx_feti.feti.subdomain.blocks import multiply_block
from dolfinx_feti.feti.subdomain.factors.create import factor_dense, factor_dense_for_preconditioner
from dolfinx_feti.feti.subdomain.factors.packed import PackedMatrix
from dolfinx_feti.feti.subdomain.factors.protocol import Factor
from dolfinx_feti.feti.subdomain.orthonormal import orthonormal
from dolfinx_feti.feti.subdomain.panels import Panels
from dolfinx_feti.feti.subdomain.subdomain import Subdomain
from dolfinx_feti.runtime.arrays import Array, Indices


class SchurComplement(ABC):
    """S_i of one subdomain, (n_{Γ,i}, n_{Γ,i}).

    It is valid until the entries of the local matrix K change. It owns the factor of K_II.

    Attributes:
        subdomain: The subdomain.
        interior_factor: Factor of K_II; None if it is not factored, and S_i cannot be applied.
    """

    def __init__(self, subdomain: Subdomain, interior_factor: Factor | None) -> None:
        self.subdomain = subdomain
        self.interior_factor = interior_factor

    @abstractmethod
    def multiply(self, X: Array, *, transpose: bool = False) -> Array:
        """Return S_i X, or S_iᵀ X, for columns on the interface, (n_{Γ,i}, r)."""

    def multiply_panels(self, W: Panels, *, transpose: bool = False) -> Array:
        """Return S_i W, or S_iᵀ W, for block-sparse columns on the interface, (n_{Γ,i}, r)."""
        return self.multiply(W.dense(), transpose=transpose)

    def solve_interior(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return K_II⁻¹ Y, or K_II⁻ᵀ Y, (n_{I,i},) or (n_{I,i}, r)."""
        if self.interior_factor is None:
            raise RuntimeError("S cannot be applied: the interior of the subdomain is not factored")
        return self.interior_factor.solve(Y, transpose=transpose)

    def memory(self) -> float:
        """Return the memory of the factor, and of S_i if it is formed, in MiB."""
        return 0.0 if self.interior_factor is None else self.interior_factor.memory()

    def destroy(self) -> None:
        """Free the factor. If S_i is formed, it is freed with this object."""
        if self.interior_factor is not None:
            self.interior_factor.destroy()


class AppliedSchurComplement(SchurComplement):
    """S_i applied by a factor of K_II."""

    def __init__(self, K: PETSc.Mat, subdomain: Subdomain, interior_factor: Factor | None) -> None:
        """Refer to the blocks of the subdomain in K, (n, n), the local matrix of this process."""
        super().__init__(subdomain, interior_factor)
        self._K = K

    def multiply(self, X: Array, *, transpose: bool = False) -> Array:
        """Return K_ΓΓ X − K_ΓI K_II⁻¹ K_IΓ X, or the same with Kᵀ in place of K, (n_{Γ,i}, r)."""
        Γ = self.subdomain.interface
        I = self.subdomain.interior  # noqa: E741
        multiply = partial(multiply_block, self._K, transpose=transpose)
        Y = self.solve_interior(multiply(I, Γ, X), transpose=transpose)  # K_II⁻¹ K_IΓ X
        return multiply(Γ, Γ, X) - multiply(Γ, I, Y)


class FormedSchurComplement(SchurComplement):
    """S_i as a dense symmetric matrix in packed format: a ``matrix.SubdomainMatrix`` as well.

    Attributes:
        matrix: S_i, packed.
        diagonal_of_K: Absolute diagonal of K_i on the interface, (n_{Γ,i},).
    """

    def __init__(
        self,
        subdomain: Subdomain,
        interior_factor: Factor,
        matrix: PackedMatrix,
        diagonal_of_K: Array,
    ) -> None:
        super().__init__(subdomain, interior_factor)
        self.matrix = matrix
        self.diagonal_of_K = diagonal_of_K

    @property
    def dofs(self) -> Indices:
        """Torn dofs of its rows: the interface, (n_{Γ,i},)."""
        return self.subdomain.interface

    def modes_on_dofs(self, R: Array) -> Array:
        """Return an orthonormal basis of modes R, restricted to the interface, (n_{Γ,i}, k).

        Restricted modes are not orthonormal, and may be linearly dependent: k may be smaller.
        """
        return orthonormal(R[self.subdomain.is_on_interface])

    def multiply(self, X: Array, *, transpose: bool = False) -> Array:
        """Return S_i X = S_iᵀ X, (n_{Γ,i}, r): S_i is formed for symmetric matrices only."""
        return self.matrix.multiply_many(X)

    def multiply_panels(self, W: Panels, *, transpose: bool = False) -> Array:
        """Return S_i W = S_iᵀ W for block-sparse columns, (n_{Γ,i}, r)."""
        return self.matrix.multiply_panels(W)

    def factor(
        self, R: Array, rho: float, shift: Array | None = None, *, is_graded: bool = False
    ) -> Factor:
        """Factor S_i + ρ R Rᵀ + diag(shift); R may be graded. See ``matrix.SubdomainMatrix``."""
        return factor_dense(self.matrix, R, rho, shift)

    def factor_for_preconditioner(self, R: Array, rho: float) -> Factor:
        """Factor S_i + ρ R Rᵀ, in single precision if it is positive definite in it."""
        return factor_dense_for_preconditioner(self.matrix, R, rho)

    def memory(self) -> float:
        """Return the memory of the factor and of S_i in MiB."""
        return super().memory() + self.matrix.memory()
