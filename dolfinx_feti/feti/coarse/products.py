# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Vᵀ A, stored on each subdomain in single or double precision, and the matrix Vᵀ A V.

.. math:: Y_i = S_i^⊤ W_i, \qquad V^⊤ A\, z = \sum_i C_i^⊤ Y_i^⊤ (T z)_i, \qquad
          V^⊤ A\, V = \sum_i C_i^⊤ (Y_i^⊤ W_i)\, C_i

Each iteration reads all :math:`Y_i^⊤`, (c_i, n_{Γ,i}), to project its correction z: in single
precision that takes half the time and memory. The solution is as accurate, because the residuals
and A₀ are in double precision. Single precision is used on a subdomain if

1. the caller allows it, because V and K_ρ⁻¹ belong to the present matrix;
2. the forces of its softest interface dof are above the rounding errors of those of the stiffest
   one (:data:`MIN_SINGLE_PRECISION_RATIO`);
3. A₀⁻¹ does not amplify the rounding errors, for all subdomains together
   (:func:`amplifies_rounding`). This is known only when A₀ has been factored; otherwise
   :meth:`StoredProducts.store_in_double_precision` replaces the products.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.coarse.assembly import CoarseAssembler
from dolfinx_feti.feti.coarse.averaged import AveragedBasis
from dolfinx_feti.feti.coarse.basis import SubdomainColumns
from dolfinx_feti.feti.coarse.solver import CoarseSolver
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.panels import rows_product
from dolfinx_feti.feti.subdomain.schur import SchurComplement
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
from dolfinx_feti.runtime.arrays import Array, concatenate
from dolfinx_feti.runtime.lifetime import Lifetime

#: A matrix in single or double precision.
EitherPrecision = npt.NDArray[np.floating]

#: Rounding unit of single precision.
SINGLE_EPS = float(np.finfo(np.float32).eps)

#: Smallest stiffness of the interface dofs of a subdomain over the largest one, from which on
#: single precision is used: the force of the softest dof then has at least one correct digit. With
#: jumps of 1e8 across subdomains, single precision takes 400 to 3000 iterations instead of 33 to
#: 86.
MIN_SINGLE_PRECISION_RATIO = 10.0 * SINGLE_EPS

#: Growth of a vector by A₀⁻¹, in a basis of unit energy, up to which single precision is used. The
#: rounding errors of the product grow likewise: with 1/SINGLE_EPS they are as large as the vector.
#: Bodies with a growth of 1e7 take as many iterations in either precision; a plate of t/L = 1/1000,
#: with 2e8, takes 1280 in single precision instead of 21. The factor of 2 is a choice in between.
MAX_GROWTH = 2.0 / SINGLE_EPS

#: Solves with A₀ that measure the growth, by power iteration. The first one from a random vector
#: yields a vector of soft combinations, the second one their growth.
GROWTH_SOLVES = 2


@dataclass(slots=True)
class SubdomainProduct:
    """Y_i = S_iᵀ W_i of one subdomain.

    Attributes:
        columns: The columns, with W_i.
        Y_transposed: Y_iᵀ, (c_i, n_{Γ,i}), of type float32 or float64.
    """

    columns: SubdomainColumns
    Y_transposed: EitherPrecision

    @property
    def is_single_precision(self) -> bool:
        """Whether Y_iᵀ is stored in single precision."""
        return self.Y_transposed.dtype != np.float64

    def multiply(self, z: Array) -> Array:
        """Return Y_iᵀ (T z)_i, (n_Γ,) → (c_i,)."""
        columns = self.columns
        return rows_product(columns.W.code, self.Y_transposed, z[columns.rows])


class StoredProducts:
    """Vᵀ A, subdomain by subdomain; created by :func:`compute_products`.

    Attributes:
        by_subdomain: The product of each subdomain.
    """

    def __init__(
        self,
        V: AveragedBasis,
        S: SchurOperator,
        by_subdomain: list[SubdomainProduct],
        *,
        is_symmetric: bool,
    ) -> None:
        """Refer to V and S, which outlive this object, and keep the products.

        Args:
            V: The coarse basis.
            S: Schur complements of the present matrix.
            by_subdomain: The product of each subdomain.
            is_symmetric: Whether the S_i are symmetric.
        """
        self.by_subdomain = by_subdomain
        self._V = V
        self._S = S
        self._is_symmetric = is_symmetric

    def multiply(self, z: Array) -> Array:
        """Return Vᵀ A z of an assembled z by its copies, (n_Γ,) → (n_c,). Collective."""
        V = self._V

        def multiply_locally() -> Array:
            return concatenate([product.multiply(z) for product in self.by_subdomain])

        torn_e = V.copies.errors.guard(multiply_locally, V.dofmap.c)  # Y_iᵀ (T z)_i
        return V.dofmap.scatter_reverse(torn_e)

    def has_single_precision(self) -> bool:
        """Return True if the products of any subdomain are in single precision. Collective."""
        is_single = any(product.is_single_precision for product in self.by_subdomain)
        return bool(self._V.copies.comm.allreduce(is_single, op=MPI.LOR))

    def store_in_double_precision(self) -> None:
        """Compute the products that are in single precision again, in double precision. Collective.

        Raises:
            SetUpError: A product failed on some subdomain; on all processes.
        """

        def compute() -> None:
            for S_i, product in zip(self._S.by_subdomain, self.by_subdomain, strict=True):
                if product.is_single_precision:
                    Y_i = _multiply(S_i, product.columns, is_symmetric=self._is_symmetric)
                    product.Y_transposed = np.ascontiguousarray(Y_i.T)

        on_subdomains(compute, self._V.copies.comm)

    def destroy(self) -> None:
        """Free the products."""
        self.by_subdomain.clear()


def compute_products(
    V: AveragedBasis,
    S: SchurOperator,
    stiffness: Array,
    *,
    is_symmetric: bool,
    allow_single_precision: bool,
) -> tuple[StoredProducts, PETSc.Mat]:
    """Compute Vᵀ A and Vᵀ A V, in one pass over the subdomains. Collective.

    Args:
        V: The coarse basis.
        S: Schur complements of the present matrix.
        stiffness: Stiffness of each interface dof, not negative, (n_Γ,).
        is_symmetric: Whether the S_i are symmetric.
        allow_single_precision: Whether V and K_ρ⁻¹ belong to the present matrix. After subdomains
            were scaled by 1e-2 to 1e3, a solve with the old preconditioner takes 25 iterations more
            in double precision, and 148 more in single precision.

    Returns:
        Vᵀ A, and Vᵀ A V, (N_c, N_c); the caller destroys both.

    Raises:
        SetUpError: A product failed on some subdomain; on all processes.
    """
    comm = V.copies.comm
    assembler = CoarseAssembler(V.by_subdomain, V.dofmap)
    by_subdomain: list[SubdomainProduct] = []

    def compute() -> None:
        for i, (S_i, columns) in enumerate(zip(S.by_subdomain, V.by_subdomain, strict=True)):
            is_single = allow_single_precision and _fits_single_precision(stiffness[columns.rows])
            Y_i = _multiply(S_i, columns, is_symmetric=is_symmetric)
            Y_transposed: EitherPrecision = np.ascontiguousarray(
                Y_i.T, np.float32 if is_single else np.float64
            )
            by_subdomain.append(SubdomainProduct(columns, Y_transposed))
            # The product W_iᵀ Y_i is the transpose of the element matrix W_iᵀ S_i W_i.
            element = columns.W.multiply_transposed(Y_i, is_symmetric=is_symmetric)
            assembler.add(i, element if is_symmetric else element.T)

    on_subdomains(compute, comm)
    products = StoredProducts(V, S, by_subdomain, is_symmetric=is_symmetric)
    return products, assembler.assemble()


def _multiply(S_i: SchurComplement, columns: SubdomainColumns, *, is_symmetric: bool) -> Array:
    """Return Y_i = S_iᵀ W_i, (n_{Γ,i}, c_i)."""
    return S_i.multiply_panels(columns.W, transpose=not is_symmetric)


def _fits_single_precision(stiffness: Array) -> bool:
    """Return True if single precision keeps the forces of dofs of these stiffnesses, (n_{Γ,i},)."""
    smallest = stiffness.min(initial=np.inf)
    return bool(smallest >= MIN_SINGLE_PRECISION_RATIO * stiffness.max(initial=0.0))


def amplifies_rounding(A_0: PETSc.Mat, solver: CoarseSolver) -> bool:
    """Return True if A₀⁻¹ amplifies rounding errors too much for single precision. Collective.

    Args:
        A_0: Coarse matrix of columns of unit energy, whose diagonal is ±1, (N_0, N_0).
        solver: Its solver.
    """
    growth = 1.0
    with Lifetime() as owned:
        x, y = map(owned.own, A_0.createVecs())
        first_row = A_0.getOwnershipRange()[0]  # as the seed: the same vector in each run
        x.array[:] = np.random.default_rng(first_row).standard_normal(x.getLocalSize())
        for _ in range(GROWTH_SOLVES):
            norm = x.norm()
            if not norm > 0.0:
                return False
            x.copy(y)
            y.scale(1.0 / norm)
            solver.solve(y, x)
            growth = x.norm()
    return not growth <= MAX_GROWTH  # also if it is NaN
