# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The matrices of the subdomains as the dual method sees them: sparse K, or S on the interface.

Gluing and multipliers touch the interface Γ only. With the Schur complement

.. math:: S = K_{ΓΓ} - K_{ΓI} K_{II}^{-1} K_{IΓ}, \qquad
          \hat f_Γ = f_Γ - K_{ΓI} K_{II}^{-1} f_I, \qquad
          u_I = K_{II}^{-1}(f_I - K_{IΓ} u_Γ)

(eq. 50, Augustin_eq:DirichletVK) the whole method can be written for :math:`S, \hat f_Γ, u_Γ` in
the place of K, f, u: the generalised inverse is that of S, and the Dirichlet preconditioner applies
S itself.

- :class:`SparseMatrices`: K on all free dofs, factored; S is applied with another factor, of
  :math:`K_{II}`. An iteration runs through both factors, forward and backward.
- :class:`CondensedMatrices`: S is formed (``elimination``), a dense block of the size of Γ, and one
  factor of :math:`K_{II}` is kept for :math:`\hat f_Γ` and :math:`u_I`. An iteration reads
  packed triangles: several times less than the factors of a piece of a thin wall, or of
  a small one.

``auto`` condenses if S takes about the memory of the factors; see :data:`DENSITY`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.panels import Panels
from dolfinx_feti.feti.subdomain.blocks import named, product_many, sparse_block
from dolfinx_feti.feti.subdomain.dense import DenseFactors
from dolfinx_feti.feti.subdomain.direct import sum_pivots
from dolfinx_feti.feti.subdomain.elimination import create_elimination
from dolfinx_feti.feti.subdomain.kernel import orthonormal
from dolfinx_feti.feti.subdomain.nullspace import factor_tells_singular, null_space
from dolfinx_feti.feti.subdomain.sparse.factors import Factors
from dolfinx_feti.feti.subdomain.sparse.regularised import create_factors
from dolfinx_feti.torn import Torn

__all__ = ["SubdomainMatrices", "create_matrices", "worth_condensing"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

#: Entries of S for each :math:`n^{4/3}`, which is how a sparse factor in three dimensions grows.
DENSITY = 30.0

#: Largest interface of a subdomain that is condensed: 32 MiB.
LARGEST = 2048

#: Share of the stiffness above which the interface feels a motion of the interior without energy:
#: none of a positive semi-definite matrix.
FELT = 1e-5


class SubdomainMatrices(ABC):
    """The matrix of each subdomain of this process, K on its free dofs or S on its interface.

    Attributes:
        dofs: Torn dofs on which each matrix lives.
        condensed: Whether the interior is eliminated, and the matrices are S.
        factors: Factors of the regularised matrices, see ``pseudoinverse``.
    """

    dofs: list[Indices]
    condensed: bool
    factors: Factors

    def __init__(self, torn: Torn) -> None:
        """Take the torn matrix; :meth:`update` takes its values."""
        self._torn = torn
        self._diagonal: Array = np.ones(torn.n)

    def update(self, *, keep_factors: bool = False) -> None:
        """Take over the current K.

        Args:
            keep_factors: Whether ``factors`` stay those of an earlier K.

        Raises:
            FactorError: A factorisation failed. Not collective: the caller reduces.
        """
        self._diagonal = np.abs(self._torn.diagonal())

    @abstractmethod
    def restrict(self, i: int, R: Array) -> Array:
        """Restrict orthonormal columns on the free dofs of subdomain i to its ``dofs``."""

    @abstractmethod
    def multiply(self, t: Array) -> Array:
        """Apply the matrix of every subdomain, (n,) → (n,)."""

    @abstractmethod
    def multiply_many(self, i: int, X: Array) -> Array:
        """Apply the matrix of subdomain i to columns on its ``dofs``, (n_i, r) → (n_i, r)."""

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return what :meth:`multiply_many` does for columns that fall into panels."""
        return self.multiply_many(i, W.dense())

    @abstractmethod
    def condense(self, f: Array) -> Array:
        """Move the load of the interior to the interface, (n,) or (n, r); f itself if K is kept."""

    @abstractmethod
    def extend(self, u: Array, f: Array) -> Array:
        """Complete u, (n,), on an interior that is eliminated, where the load is f."""

    @abstractmethod
    def interior_inertia(self) -> tuple[int, int] | None:
        """Count negative and zero eigenvalues of all K_II of this process.

        Returns:
            Both numbers; None if no K_II is factored here, or the solver does not tell.
        """

    @abstractmethod
    def interior_kernel(self) -> Array:
        """Return motions of the interior without energy that the interface does not feel.

        Returns:
            Columns on the torn dofs, (n, r), as of the last :meth:`update`; with r > 0 the
            assembled matrix is singular.
        """

    def diagonal(self, i: int) -> Array:
        """Return the absolute diagonal of K on the ``dofs`` of subdomain i, (n_i,)."""
        return self._diagonal[self.dofs[i]]

    def to_single(self, i: int) -> None:  # noqa: B027
        """Store the factor of K_ρ of subdomain i in single precision, if it is dense."""

    def to_double(self) -> None:  # noqa: B027
        """Have all factors of K_ρ in double precision again."""

    def singles(self) -> int:
        """Count the subdomains of this process whose factors are stored in single precision."""
        return 0

    @abstractmethod
    def memory(self) -> float:
        """Return the memory of all factors of this process in MiB."""

    @abstractmethod
    def destroy(self) -> None:
        """Free the factors."""


class SparseMatrices(SubdomainMatrices):
    """K on all free dofs."""

    condensed = False

    def __init__(self, torn: Torn, free: list[Indices], *, symmetric: bool, prefix: str) -> None:
        """Prepare the factorisations of K.

        Args:
            torn: The torn matrix.
            free: Free torn dofs of each subdomain.
            symmetric: Whether K is symmetric.
            prefix: Options prefix of the factorisations.
        """
        super().__init__(torn)
        self.dofs = free
        self.factors = create_factors(torn, free, prefix=prefix, symmetric=symmetric)

    def restrict(self, i: int, R: Array) -> Array:
        return R

    def multiply(self, t: Array) -> Array:
        return self._torn.multiply(t)  # K t

    def multiply_many(self, i: int, X: Array) -> Array:
        return sparse_block(self._torn.K, self.dofs[i], self.dofs[i]) @ X  # K_i X

    def condense(self, f: Array) -> Array:
        return f

    def extend(self, u: Array, f: Array) -> Array:
        return u

    def interior_inertia(self) -> None:
        return None

    def interior_kernel(self) -> Array:
        return np.zeros((self._torn.n, 0))

    def memory(self) -> float:
        return self.factors.memory()

    def destroy(self) -> None:
        self.factors.destroy()


class CondensedMatrices(SubdomainMatrices):
    """S on the interface."""

    condensed = True
    factors: DenseFactors

    def __init__(
        self, torn: Torn, free: list[Indices], glued: npt.NDArray[np.bool_], *, prefix: str
    ) -> None:
        """Prepare the factorisations of K_II.

        Args:
            torn: The torn matrix, symmetric.
            free: Free torn dofs of each subdomain.
            glued: Mask of the interface, (n,).
            prefix: Options prefix of the factorisations.
        """
        super().__init__(torn)
        self._elimination = create_elimination(torn, free, glued, prefix=prefix)
        self.dofs = self._elimination.interface
        self._Γ = np.zeros(torn.n, dtype=bool)
        self._Γ[np.concatenate([*self.dofs, np.zeros(0, dtype=np.int32)])] = True
        self.factors = DenseFactors(self.dofs)
        self._interior_kernel = np.zeros((torn.n, 0))

    def update(self, *, keep_factors: bool = False) -> None:
        super().update()
        for i, S in enumerate(self._elimination.schur_complements()):
            with named(self._torn.first + i):
                self.factors.set_block(i, S, keep_factor=keep_factors)
        columns = [self._kernel_inside(i) for i in range(len(self.dofs))]
        self._interior_kernel = np.hstack([np.zeros((self._torn.n, 0)), *columns])

    def _kernel_inside(self, i: int) -> Array:
        """Return motions of the interior of subdomain i without energy, (n, r)."""
        I, factors = self._elimination.interior[i], self._elimination.factors  # noqa: E741
        if not factor_tells_singular(factors, i, self._diagonal[I]):
            return np.zeros((self._torn.n, 0))
        with named(self._torn.first + i):
            K_II = sparse_block(self._torn.K, I, I)
            Y = null_space(factors, i, lambda X: K_II @ X, self._diagonal[I])
            force = product_many(self._torn.K, self.dofs[i], I, Y)  # K_ΓI Y
            if np.abs(force).max(initial=0.0) > FELT * np.abs(K_II.data).max() * np.abs(Y).max():
                raise FactorError(
                    "the matrix of its interior is singular, though the assembled one need not "
                    "be: take other subdomains, or the options feti_interior keep and "
                    "feti_pc_type lumped"
                )
        motions = np.zeros((self._torn.n, Y.shape[1]))
        motions[I] = Y
        return motions

    def restrict(self, i: int, R: Array) -> Array:
        return orthonormal(R[self._elimination.on_interface[i]])

    def multiply(self, t: Array) -> Array:
        y = np.zeros_like(t)
        self.factors.multiply(t, y)
        return y  # S t

    def multiply_many(self, i: int, X: Array) -> Array:
        return self.factors.multiply_many(i, X)

    def multiply_panels(self, i: int, W: Panels) -> Array:
        return self.factors.multiply_panels(i, W)

    def condense(self, f: Array) -> Array:
        x = np.zeros_like(f)
        if f.ndim == 1:
            self._elimination.factors.solve(f, x)
        else:
            for i, rows in enumerate(self._elimination.interior):
                x[rows] = self._elimination.factors.solve_many(i, f[rows])
        Kx = self._torn.multiply(x)
        return ((f - Kx).T * self._Γ).T  # f_Γ − K_ΓI K_II⁻¹ f_I

    def extend(self, u: Array, f: Array) -> Array:
        u = np.where(self._Γ, u, 0.0)
        self._elimination.factors.solve(f - self._torn.multiply(u), u)
        return u  # u_I = K_II⁻¹ (f_I − K_IΓ u_Γ)

    def interior_inertia(self) -> tuple[int, int] | None:
        factors = self._elimination.factors
        negative, zero = sum_pivots(factors.pivots(i) for i in range(len(self.dofs)))
        return None if negative is None or zero is None else (negative, zero)

    def interior_kernel(self) -> Array:
        return self._interior_kernel

    def to_single(self, i: int) -> None:
        self.factors.to_single(i)

    def to_double(self) -> None:
        self.factors.to_double()

    def singles(self) -> int:
        return self.factors.singles()

    def memory(self) -> float:
        return self.factors.memory() + self._elimination.factors.memory()

    def destroy(self) -> None:
        self.factors.destroy()
        self._elimination.factors.destroy()


def create_matrices(
    choice: str,
    torn: Torn,
    free: list[Indices],
    glued: Indices,
    *,
    symmetric: bool,
    prefix: str,
) -> SubdomainMatrices:
    """Keep the interior dofs, or condense them.

    Args:
        choice: ``keep``, ``eliminate`` or ``auto``.
        torn: The torn matrix.
        free: Free torn dofs of each subdomain.
        glued: Torn dofs of the interface.
        symmetric: Whether K is symmetric; otherwise ``auto`` keeps.
        prefix: Options prefix, to which ``local_`` (K) or ``dirichlet_`` (K_II) is added.

    Note:
        Collective.
    """
    on_interface = np.zeros(torn.n, dtype=bool)
    on_interface[glued] = True
    if choice == "auto":
        worth = symmetric and worth_condensing(torn, free, on_interface)
        choice = "eliminate" if worth else "keep"
    if choice == "eliminate":
        return CondensedMatrices(torn, free, on_interface, prefix=prefix + "dirichlet_")
    return SparseMatrices(torn, free, symmetric=symmetric, prefix=prefix + "local_")


def worth_condensing(torn: Torn, free: Sequence[Indices], glued: npt.NDArray[np.bool_]) -> bool:
    """Decide whether dense Schur complements take no more memory than sparse factors.

    Args:
        torn: The torn matrix.
        free: Free torn dofs of each subdomain.
        glued: Mask of the interface, (n,).

    Note:
        Collective.
    """
    n = np.array([len(rows) for rows in free], dtype=np.float64)
    glued_n = np.array([np.count_nonzero(glued[rows]) for rows in free], dtype=np.float64)
    dense, sparse = torn.comm.allreduce(np.array([(glued_n**2).sum(), (n ** (4 / 3)).sum()]))
    largest = torn.comm.allreduce(glued_n.max(initial=0.0), op=MPI.MAX)
    return bool(dense <= DENSITY * sparse and largest <= LARGEST)
