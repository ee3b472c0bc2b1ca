# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The operator S of one matrix: the Schur complements of all subdomains of a process.

.. math:: S = K_{ΓΓ} - K_{ΓI} K_{II}^{-1} K_{IΓ}, \qquad
          \hat f_Γ = f_Γ - K_{ΓI} K_{II}^{-1} f_I, \qquad
          u_I = K_{II}^{-1}(f_I - K_{IΓ} u_Γ)

(eq. 50, Augustin_eq:DirichletVK; eq. 51), applied with a sparse factor of :math:`K_{II}`, where the
generalised inverse is that of K, or formed, and the inverse is that of S.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from functools import partial

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.gluing.jump import Dofs
from dolfinx_feti.feti.subdomain.analysis import Analysis
from dolfinx_feti.feti.subdomain.blocks import index_set, named, product_many, sparse_block
from dolfinx_feti.feti.subdomain.factors.dense import DenseFactor, PackedMatrix, pack
from dolfinx_feti.feti.subdomain.factors.direct import Choice
from dolfinx_feti.feti.subdomain.factors.multifrontal import Fronts
from dolfinx_feti.feti.subdomain.factors.pivoted import factor_with_pivots
from dolfinx_feti.feti.subdomain.factors.protocol import Factor, sum_known
from dolfinx_feti.feti.subdomain.factors.regularised import factor_by_fronts
from dolfinx_feti.feti.subdomain.panels import Panels
from dolfinx_feti.runtime.arrays import Array, Indices, Mask, Single
from dolfinx_feti.runtime.collective import deferred
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.petsc_library import product, rows_of
from dolfinx_feti.torn.matrix import Torn


class Operator(ABC):
    """S of every subdomain of this process, (n_Γ, n_Γ) each.

    Attributes:
        torn: The torn matrix.
        eliminated: Whether the interior is eliminated.
        dofs: Torn dofs of the matrix of each subdomain that is inverted: all free ones, or Γ.
        on_interface: Mask of Γ among them.
        interface: Γ of each subdomain.
        interior: I of each subdomain.
        interior_factors: Factors of K_II; none where S is not applied, and the interior kept.
    """

    eliminated: bool
    dofs: list[Indices]
    on_interface: list[Mask]

    def __init__(self, torn: Torn, dofs: Dofs, interior_factors: Sequence[Factor]) -> None:
        """Take what both ways have in common."""
        self.torn = torn
        self.interface, self.interior = dofs.interface, dofs.interior
        self.interior_factors = interior_factors
        self._glued = dofs.glued & ~dofs.fixed
        self._diagonal = np.abs(torn.diagonal())

    @abstractmethod
    def _multiply(self, t: Array) -> Array:
        """Do the work of :meth:`multiply`."""

    @abstractmethod
    def multiply_many(self, i: int, X: Array, *, transpose: bool = False) -> Array:
        """Return S_i X, or S_iᵀ X, for columns on the interface, (n_Γ, r)."""

    def multiply_panels(self, i: int, W: Panels, *, transpose: bool = False) -> Array:
        """Return S_i W, or S_iᵀ W, for block-sparse columns on the interface, (n_Γ, r)."""
        return self.multiply_many(i, W.dense(), transpose=transpose)

    def local_product(self, i: int, X: Array) -> Array:
        """Return the product of the matrix that is inverted, K_i or S_i, with columns, (n_i, r)."""
        return self.multiply_many(i, X)

    @abstractmethod
    def factor(self, i: int, R: Array, rho: float, shift: Array | None = None) -> Factor:
        """Factor the matrix that is inverted, K_i or S_i, plus ρ R Rᵀ and a shifted diagonal."""

    def factor_roughly(self, i: int, R: Array, rho: float) -> Factor | None:
        """Factor it plus ρ R Rᵀ for a preconditioner, at less cost; None where that does not do."""
        return None

    def multiply(self, t: Array) -> Array:
        """Return S t, (n,) → (n,), for a t that is zero off the interface."""
        with event("FETISchurProduct"):
            return deferred(lambda: self._multiply(t), t.shape)

    def condense(self, f: Array) -> Array:
        """Return f_Γ − K_ΓI K_II⁻¹ f_I, (n,), zero inside."""

        def condense() -> Array:
            return np.where(self._glued, f - self.torn.multiply(self._solve_inside(f)), 0.0)

        return deferred(condense, f.shape)

    def extend(self, u: Array, f: Array) -> Array:
        """Return u with u_I = K_II⁻¹ (f_I − K_IΓ u_Γ) inside, (n,)."""
        on_interface = np.where(self._glued, u, 0.0)

        def extend() -> Array:
            return on_interface + self._solve_inside(f - self.torn.multiply(on_interface))

        return deferred(extend, u.shape)

    def load(self, f: Array) -> Array:
        """Return the load on ``dofs``: f itself, (n,), or condensed to the interface."""
        return self.condense(f) if self.eliminated else f

    def complete(self, u: Array, f: Array) -> Array:
        """Complete u, (n,), known on ``dofs``, where the load is f."""
        return self.extend(u, f) if self.eliminated else u

    def diagonal(self, i: int) -> Array:
        """Return the absolute diagonal of K on ``dofs`` of subdomain i, (n_i,)."""
        return self._diagonal[self.dofs[i]]

    def negative_interior(self) -> int | None:
        """Count the negative eigenvalues of all K_II of this process; None if not known."""
        if len(self.interior_factors) < len(self.interior):
            return None
        return sum_known([factor.pivots.negative for factor in self.interior_factors])

    def _solve_inside(self, y: Array) -> Array:
        """Return K_II⁻¹ y_I of every subdomain, zero elsewhere, (n,)."""
        x = np.zeros_like(y)
        for I, factor in zip(self.interior, self.interior_factors, strict=True):  # noqa: E741
            x[I] = factor.solve(y[I])
        return x

    def memory(self) -> float:
        """Return the memory of all factors of this process in MiB."""
        return sum(factor.memory() for factor in self.interior_factors)

    def destroy(self) -> None:
        """Free the factors."""
        for factor in self.interior_factors:
            factor.destroy()


class KeptInterior(Operator):
    """S applied with a factor of K_II."""

    eliminated = False

    def __init__(
        self, torn: Torn, dofs: Dofs, analysis: Analysis, interior_factors: Sequence[Factor]
    ) -> None:
        """Keep the interface rows of K, (n_Γ, n), where S is applied."""
        super().__init__(torn, dofs, interior_factors)
        self.dofs, self.on_interface = dofs.free, dofs.on_interface
        self._analysis = analysis
        fronts = analysis.local_fronts or []
        self._work = np.empty(max((front.work for front in fronts), default=0))
        self._Γ = np.concatenate([*dofs.interface, np.zeros(0, dtype=np.int32)])
        self._rows: PETSc.Mat | None = None
        self._columns: PETSc.Mat | None = None
        if analysis.interior is not None:
            on, everywhere = index_set(self._Γ), index_set(np.arange(torn.n, dtype=np.int32))
            self._rows = torn.K.createSubMatrix(on, everywhere)  # K_Γ
            if not analysis.interior.symmetric:
                self._columns = torn.K.createSubMatrix(everywhere, on)
            on.destroy()
            everywhere.destroy()

    def _multiply(self, t: Array) -> Array:
        Γ, St = self._Γ, np.zeros_like(t)
        if self._columns is None:
            y = product(self._rows, t[Γ], transpose=True)  # y = K t
        else:
            y = product(self._columns, t[Γ])
        St[Γ] = y[Γ] - product(self._rows, self._solve_inside(y))  # K_ΓΓ t − K_ΓI K_II⁻¹ y_I
        return St

    def multiply_many(self, i: int, X: Array, *, transpose: bool = False) -> Array:
        Γ, I = self.interface[i], self.interior[i]  # noqa: E741
        K = partial(product_many, self.torn.K, transpose=transpose)
        Y = self.interior_factors[i].solve(K(I, Γ, X), transpose=transpose)  # K_II⁻¹ K_IΓ X
        return K(Γ, Γ, X) - K(Γ, I, Y)

    def local_product(self, i: int, X: Array) -> Array:
        return product_many(self.torn.K, self.dofs[i], self.dofs[i], X)  # K_i X

    def factor(self, i: int, R: Array, rho: float, shift: Array | None = None) -> Factor:
        fronts = self._analysis.local_fronts
        if fronts is not None and shift is None and len(R):
            with rows_of(self.torn.K) as K:
                factored = factor_by_fronts(fronts[i], K, self._work, R, rho)
            if factored is not None:
                return factored
        return factor_with_pivots(self.torn.K, self.dofs[i], self._analysis.local, R, rho, shift)

    def destroy(self) -> None:
        super().destroy()
        for owned in (self._rows, self._columns):
            if owned is not None:
                owned.destroy()


class EliminatedInterior(Operator):
    """S formed, in packed format; it is symmetric."""

    eliminated = True

    def __init__(
        self, torn: Torn, dofs: Dofs, interior_factors: Sequence[Factor], S: Sequence[PackedMatrix]
    ) -> None:
        """Take the Schur complements."""
        super().__init__(torn, dofs, interior_factors)
        self.dofs = dofs.interface
        self.on_interface = [np.ones(len(rows), dtype=bool) for rows in self.dofs]
        self._S = S

    def _multiply(self, t: Array) -> Array:
        St = np.zeros_like(t)
        for rows, S in zip(self.dofs, self._S, strict=True):
            St[rows] = S.multiply(t[rows])
        return St

    def multiply_many(self, i: int, X: Array, *, transpose: bool = False) -> Array:
        return self._S[i].multiply_many(X)

    def multiply_panels(self, i: int, W: Panels, *, transpose: bool = False) -> Array:
        return self._S[i].multiply_panels(W)

    def packed(self, i: int) -> Array:
        """Return S_i in packed format, (n_Γ (n_Γ + 1) / 2,)."""
        return self._S[i].values

    def unpacked(self, i: int, work: Single) -> Single:
        """Return S_i in single precision, (n_Γ, n_Γ) in Fortran's order, below its diagonal."""
        return self._S[i].unpacked(work)

    def factor(self, i: int, R: Array, rho: float, shift: Array | None = None) -> Factor:
        return DenseFactor(self._S[i], R, rho, shift)

    def factor_roughly(self, i: int, R: Array, rho: float) -> Factor | None:
        return DenseFactor.roughly(self._S[i], R, rho)

    def memory(self) -> float:
        return super().memory() + sum(S.memory() for S in self._S)

    def destroy(self) -> None:
        super().destroy()
        self.interior_factors, self._S = (), ()  # a form may still name the operator


def create_operator(torn: Torn, dofs: Dofs, analysis: Analysis) -> Operator:
    """Factor K_II of the present matrix, and form S where the interior is eliminated."""
    pairs = _factor_interior(torn, dofs, analysis.interior, analysis.interior_fronts)
    if not analysis.eliminated:
        return KeptInterior(torn, dofs, analysis, [factor for factor, _ in pairs])
    largest = max((len(rows) for rows in dofs.interface), default=0)
    work, S, factors = np.empty(largest**2), [], []
    for i, (factor, packed) in enumerate(pairs):
        with named(torn.first + i):
            entries = _schur_complement(torn, dofs, i, factor) if packed is None else packed
            S.append(PackedMatrix(entries, len(dofs.interface[i]), work))
        factors.append(factor)
    return EliminatedInterior(torn, dofs, factors, S)


def _factor_interior(
    torn: Torn, dofs: Dofs, choice: Choice | None, fronts: Sequence[Fronts] | None
) -> Iterator[tuple[Factor, Array | None]]:
    """Yield the factor of each K_II, and what its fronts leave: S, packed; None with pivots.

    Pivots serve where K_II is not positive definite, or the options name a solver.
    """
    work = np.empty(max((front.work for front in fronts or []), default=0))
    for i, I in enumerate(dofs.interior if choice else []):  # noqa: E741
        assert choice is not None
        with named(torn.first + i):
            factored = None
            if fronts is not None:
                with rows_of(torn.K) as K:
                    factored = fronts[i].factor(K, work)
            pair = factored or (factor_with_pivots(torn.K, I, choice), None)
        yield pair


def _schur_complement(torn: Torn, dofs: Dofs, i: int, factor: Factor) -> Array:
    """Return S_i, packed, by solves with a factor of K_II."""
    Γ, I = dofs.interface[i], dofs.interior[i]  # noqa: E741
    X = factor.solve(sparse_block(torn.K, I, Γ).toarray(order="F"))  # K_II⁻¹ K_IΓ
    K_ΓΓ = sparse_block(torn.K, Γ, Γ).toarray(order="F")
    return pack(K_ΓΓ - sparse_block(torn.K, Γ, I) @ X)  # K_ΓΓ − K_ΓI X
