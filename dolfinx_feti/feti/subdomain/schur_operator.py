# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The Schur complements of all subdomains of a process, and the solves with their interiors.

.. math:: S = \operatorname{diag}(S_i), \qquad
          \hat f_Γ = f_Γ - K_{ΓI} K_{II}^{-1} f_I, \qquad
          u_I = K_{II}^{-1}(f_I - K_{IΓ} u_Γ)

(eq. 50 and eq. 51 of the paper). Torn vectors are (n,). Interface vectors are (n_Γ,): the values on
Γ of all subdomains, one after the other.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.subdomain.analysis import Analysis, SubdomainAnalysis
from dolfinx_feti.feti.subdomain.blocks import index_set, sparse_block
from dolfinx_feti.feti.subdomain.factors.create import SparseBlock, factor_interior
from dolfinx_feti.feti.subdomain.factors.packed import PackedMatrix
from dolfinx_feti.feti.subdomain.factors.protocol import Factor, sum_counts
from dolfinx_feti.feti.subdomain.factors.work_space import WorkSpace, pack
from dolfinx_feti.feti.subdomain.failures import NumberedErrors
from dolfinx_feti.feti.subdomain.schur import (
    AppliedSchurComplement,
    FormedSchurComplement,
    SchurComplement,
)
from dolfinx_feti.feti.subdomain.subdomain import Subdomain, interface_dofs
from dolfinx_feti.runtime.arrays import Array, ArrayOrNaN, Indices
from dolfinx_feti.runtime.collective import DeferredErrors
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_library import product
from dolfinx_feti.torn.matrix import Torn


class SchurOperator(ABC):
    """S of all subdomains of this process, block-diagonal, and the solves with K_II.

    It is valid until the entries of ``torn.K`` change. The methods for iterations, which return an
    ``ArrayOrNaN``, put their errors into ``errors``; the others raise them.

    Attributes:
        torn: The torn matrix.
        errors: Store for the errors of the methods for iterations.
    """

    def __init__(self, torn: Torn, subdomains: list[Subdomain], errors: DeferredErrors) -> None:
        self.torn = torn
        self.errors = errors
        self._interface = interface_dofs(subdomains)
        self._is_on_interface = np.zeros(torn.n, dtype=bool)
        self._is_on_interface[self._interface] = True

    @property
    @abstractmethod
    def is_interior_eliminated(self) -> bool:
        """Whether the interior is eliminated, and S formed."""

    @property
    @abstractmethod
    def by_subdomain(self) -> Sequence[SchurComplement]:
        """S_i of each subdomain; none after :meth:`destroy`."""

    @property
    def interfaces(self) -> list[Indices]:
        """Γ of each subdomain, (n_{Γ,i},) each."""
        return [S_i.subdomain.interface for S_i in self.by_subdomain]

    def multiply(self, t: Array) -> ArrayOrNaN:
        """Return S t, (n,) → (n,), for a t that is zero off the interface."""

        def product_on_torn_dofs() -> Array:
            St = np.zeros_like(t)
            St[self._interface] = self._multiply_on_interface(t[self._interface])
            return St

        with event("FETISchurProduct"):
            return self.errors.guard(product_on_torn_dofs, t.shape)

    def multiply_on_interface(self, t: Array) -> ArrayOrNaN:
        """Return S t for an interface vector, (n_Γ,) → (n_Γ,)."""
        with event("FETISchurProduct"):
            return self.errors.guard(lambda: self._multiply_on_interface(t), t.shape)

    @abstractmethod
    def _multiply_on_interface(self, t: Array) -> Array:
        """Return S t for an interface vector, (n_Γ,) → (n_Γ,); raise an error if it fails."""

    def multiply_columns(self, X: Array, *, transpose: bool = False) -> Array:
        """Return S X, or Sᵀ X, for interface vectors, (n_Γ, r)."""
        SX = np.empty_like(X)
        for S_i in self.by_subdomain:
            rows = S_i.subdomain.interface_rows
            SX[rows] = S_i.multiply(X[rows], transpose=transpose)  # S_i X_i
        return SX

    def interface_load(self, f: Array) -> ArrayOrNaN:
        """Return the load of the interface with the interior eliminated, (n,).

        It is f̂_Γ = f_Γ − K_ΓI K_II⁻¹ f_I for a load f, (n,), and zero off the interface.
        """

        def condensed_load() -> Array:
            load = f - self.torn.multiply(self._solve_interior(f))  # f − K (0, K_II⁻¹ f_I)
            return np.where(self._is_on_interface, load, 0.0)

        return self.errors.guard(condensed_load, f.shape)

    def extend(self, u: Array, f: Array) -> ArrayOrNaN:
        """Extend a displacement of the interface to the interior, u_I = K_II⁻¹ (f_I − K_IΓ u_Γ).

        Args:
            u: Displacement, (n,), of which only the values u_Γ are read.
            f: Load, (n,), of which only the values f_I are read.

        Returns:
            u_Γ on the interface, u_I in the interior, and zero on fixed dofs, (n,).
        """
        on_interface = np.where(self._is_on_interface, u, 0.0)

        def extension() -> Array:
            return on_interface + self._solve_interior(f - self.torn.multiply(on_interface))

        return self.errors.guard(extension, u.shape)

    def _solve_interior(self, y: Array) -> Array:
        """Return K_II⁻¹ y_I of every subdomain, zero elsewhere, (n,)."""
        x = np.zeros_like(y)
        for S_i in self.by_subdomain:
            I = S_i.subdomain.interior  # noqa: E741
            x[I] = S_i.solve_interior(y[I])
        return x

    def count_negative_interior_eigenvalues(self) -> int | None:
        """Return the number of negative eigenvalues of all K_II of this process.

        Returns:
            The number; None if a K_II is not factored, or its factor does not count them.
        """
        factors = [S_i.interior_factor for S_i in self.by_subdomain]
        return sum_counts([None if f is None else f.inertia.negative for f in factors])

    def memory(self) -> float:
        """Return the memory of all factors, and of S if it is formed, of this process in MiB."""
        return sum(S_i.memory() for S_i in self.by_subdomain)

    @abstractmethod
    def destroy(self) -> None:
        """Free factors and matrices before the next matrix is factored.

        The dofs remain, because an old formulation may still refer to this object.
        """


class FormedSchurOperator(SchurOperator):
    """S with all S_i formed: the interior is eliminated."""

    is_interior_eliminated = True

    def __init__(
        self, torn: Torn, by_subdomain: list[FormedSchurComplement], errors: DeferredErrors
    ) -> None:
        """Store S_i of all subdomains of this process.

        Args:
            torn: The torn matrix.
            by_subdomain: S_i of each subdomain.
            errors: Store for the errors of the methods for iterations.
        """
        super().__init__(torn, [S_i.subdomain for S_i in by_subdomain], errors)
        self._by_subdomain = by_subdomain

    @property
    def by_subdomain(self) -> Sequence[FormedSchurComplement]:
        """S_i of each subdomain; none after :meth:`destroy`."""
        return self._by_subdomain

    def _multiply_on_interface(self, t: Array) -> Array:
        """Return S t for an interface vector, (n_Γ,) → (n_Γ,); raise an error if it fails."""
        if len(t) and not self._by_subdomain:
            raise RuntimeError("S has been destroyed")
        St = np.empty_like(t)
        for S_i in self._by_subdomain:
            rows = S_i.subdomain.interface_rows
            St[rows] = S_i.matrix.multiply(t[rows])  # S_i t_i
        return St

    def destroy(self) -> None:
        """Free factors and matrices; see :meth:`SchurOperator.destroy`."""
        for S_i in self._by_subdomain:
            S_i.destroy()
        self._by_subdomain = []


class AppliedSchurOperator(SchurOperator):
    """S applied by factors of K_II: the interior is kept."""

    is_interior_eliminated = False

    def __init__(
        self,
        torn: Torn,
        by_subdomain: list[AppliedSchurComplement],
        rows: InterfaceRows | None,
        errors: DeferredErrors,
    ) -> None:
        """Store S_i of all subdomains of this process, and the rows of K.

        Args:
            torn: The torn matrix.
            by_subdomain: S_i of each subdomain.
            rows: Rows of K on the interface; None if no K_II is factored, and S is not applied.
            errors: Store for the errors of the methods for iterations.
        """
        super().__init__(torn, [S_i.subdomain for S_i in by_subdomain], errors)
        self._by_subdomain = by_subdomain
        self._rows = rows

    @property
    def by_subdomain(self) -> Sequence[AppliedSchurComplement]:
        """S_i of each subdomain; none after :meth:`destroy`."""
        return self._by_subdomain

    def _multiply_on_interface(self, t: Array) -> Array:
        """Return S t for an interface vector, (n_Γ,) → (n_Γ,); raise an error if it fails."""
        if self._rows is None:
            raise RuntimeError("the interiors are not factored, or S has been destroyed")
        y = self._rows.multiply_extended(t)  # y = K t
        x = self._solve_interior(y)  # x_I = K_II⁻¹ y_I
        return np.asarray(y[self._interface] - self._rows.multiply(x))  # S t = y_Γ − K_ΓI x_I

    def destroy(self) -> None:
        """Free factors and matrices; see :meth:`SchurOperator.destroy`."""
        for S_i in self._by_subdomain:
            S_i.destroy()
        self._by_subdomain = []
        if self._rows is not None:
            self._rows.destroy()
            self._rows = None


class InterfaceRows:
    """Rows of K on the interfaces of all subdomains: S t takes two products with them.

    With rows of each subdomain, S t would take four products for each subdomain.
    """

    def __init__(self, K: PETSc.Mat, interface: Indices, *, is_symmetric: bool) -> None:
        """Copy the rows of K on Γ, (n_Γ, n), and, if K is not symmetric, its columns, (n, n_Γ).

        Args:
            K: Local matrix of this process, (n, n).
            interface: Γ of all subdomains, one after the other, (n_Γ,).
            is_symmetric: Whether K is symmetric.
        """
        interface_set = index_set(interface)
        all_dofs = index_set(np.arange(K.getSize()[0], dtype=np.int32))
        self._K_Γ = K.createSubMatrix(interface_set, all_dofs)
        self._columns: PETSc.Mat | None = None
        if not is_symmetric:
            self._columns = K.createSubMatrix(all_dofs, interface_set)
        interface_set.destroy()
        all_dofs.destroy()

    def multiply_extended(self, t: Array) -> Array:
        """Return K t for t on the interface, extended by zero, (n_Γ,) → (n,)."""
        if self._columns is None:
            return product(self._K_Γ, t, transpose=True)
        return product(self._columns, t)

    def multiply(self, u: Array) -> Array:
        """Return (K u)_Γ, (n,) → (n_Γ,)."""
        return product(self._K_Γ, u)

    def destroy(self) -> None:
        """Free the matrices."""
        self._K_Γ.destroy()
        if self._columns is not None:
            self._columns.destroy()


def create_schur_operator(torn: Torn, analysis: Analysis, errors: DeferredErrors) -> SchurOperator:
    """Factor all K_II of the current K, and form S if the interior is eliminated.

    Call it inside of ``on_subdomains``: it may fail on a single process.

    Args:
        torn: The torn matrix.
        analysis: The subdomains, and how they are factored.
        errors: Store for the errors of products and solves in iterations.

    Returns:
        S; the caller destroys it.

    Raises:
        FactorError: The work on a subdomain of this process failed.
    """
    with Lifetime() as factors:  # destroyed if a later subdomain fails
        S: SchurOperator
        if analysis.is_interior_eliminated:
            S = FormedSchurOperator(torn, _form_all(torn, analysis, factors), errors)
        else:
            by_subdomain = _factor_interiors(torn, analysis, factors)
            rows = _interface_rows(torn, analysis)
            S = AppliedSchurOperator(torn, by_subdomain, rows, errors)
        factors.release()  # S owns them
    return S


def _factor_interiors(
    torn: Torn, analysis: Analysis, factors: Lifetime
) -> list[AppliedSchurComplement]:
    """Return the S_i with the interior kept; ``factors`` owns the factors of K_II."""
    by_subdomain = []
    work = WorkSpace()
    for analysed in analysis.by_subdomain:
        factor: Factor | None = None
        if analysis.has_interior_factors:
            factor = factors.own(_factor_interior(torn, analysis, analysed, work)[0])
        by_subdomain.append(AppliedSchurComplement(torn.K, analysed.subdomain, factor))
    return by_subdomain


def _interface_rows(torn: Torn, analysis: Analysis) -> InterfaceRows | None:
    """Return the rows of K on the interface; None if no K_II is factored."""
    if not analysis.has_interior_factors:
        return None
    interface = interface_dofs(analysis.subdomains)
    is_symmetric = analysis.interior_options.is_symmetric
    return InterfaceRows(torn.K, interface, is_symmetric=is_symmetric)


def _form_all(torn: Torn, analysis: Analysis, factors: Lifetime) -> list[FormedSchurComplement]:
    """Return the S_i with the interior eliminated; ``factors`` owns the factors of K_II."""
    diagonal = np.abs(torn.diagonal())
    dense_work = WorkSpace()  # all S_i refer to it
    work = WorkSpace()  # of the factorisations of K_II; freed when this function returns
    by_subdomain = []
    for analysed in analysis.by_subdomain:
        s = analysed.subdomain
        factor, entries = _factor_interior(torn, analysis, analysed, work)
        factors.own(factor)
        with NumberedErrors(s.number):
            if entries is None:
                entries = _schur_complement_by_solves(torn.K, s, factor)
            S_i = PackedMatrix(entries, len(s.interface), dense_work)
        by_subdomain.append(FormedSchurComplement(s, factor, S_i, diagonal[s.interface]))
    return by_subdomain


def _factor_interior(
    torn: Torn, analysis: Analysis, analysed: SubdomainAnalysis, work: WorkSpace
) -> tuple[Factor, Array | None]:
    """Factor K_II of one subdomain.

    Args:
        torn: The torn matrix.
        analysis: How K_II is factored.
        analysed: The subdomain, and its symbolic factor.
        work: Work space.

    Returns:
        The factor; and S_i, packed, (n_{Γ,i} (n_{Γ,i} + 1) / 2,), or None if it is not a by-product
        of the factorisation.
    """
    with NumberedErrors(analysed.subdomain.number):
        K_II = SparseBlock(
            torn.K,
            analysed.subdomain.interior,
            analysis.interior_options,
            analysed.interior_symbolic,
            work,
        )
        return factor_interior(K_II)


def _schur_complement_by_solves(K: PETSc.Mat, subdomain: Subdomain, factor: Factor) -> Array:
    """Return S_i, packed, (n_{Γ,i} (n_{Γ,i} + 1) / 2,), by solves with a factor of K_II."""
    Γ = subdomain.interface
    I = subdomain.interior  # noqa: E741
    X = factor.solve(sparse_block(K, I, Γ).toarray(order="F"))  # K_II⁻¹ K_IΓ
    K_ΓΓ = sparse_block(K, Γ, Γ).toarray(order="F")
    return pack(K_ΓΓ - sparse_block(K, Γ, I) @ X)  # K_ΓΓ − K_ΓI X
