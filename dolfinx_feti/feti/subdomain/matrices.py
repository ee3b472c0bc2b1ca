# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The interior of the subdomains: kept, or eliminated once and for all iterations.

Gluing and multipliers touch the interface Γ only. With the Schur complement

.. math:: S = K_{ΓΓ} - K_{ΓI} K_{II}^{-1} K_{IΓ}, \qquad
          \hat f_Γ = f_Γ - K_{ΓI} K_{II}^{-1} f_I, \qquad
          u_I = K_{II}^{-1}(f_I - K_{IΓ} u_Γ)

(eq. 50, Augustin_eq:DirichletVK) the whole method can be written for :math:`S, \hat f_Γ, u_Γ` in
the place of K, f, u: the generalised inverse is that of S, and the Dirichlet preconditioner applies
S itself.

- *Kept*: the sparse K on all free dofs, factored; S is applied with another factor, of
  :math:`K_{II}`. An iteration runs through both factors, forth and back.
- *Eliminated*: S is formed, a dense block of the size of Γ (``schur``), and one factor of
  :math:`K_{II}` is kept for :math:`\hat f_Γ` and :math:`u_I`. An iteration reads triangles of
  a dense block: several times less than the factors of a piece of a thin wall, or of a small one.

``auto`` eliminates if S takes about the memory of the factors; see :data:`DENSITY`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.subdomain.blocks import sparse_block
from dolfinx_feti.feti.subdomain.dense import DenseFactors
from dolfinx_feti.feti.subdomain.factors import BlockFactors, Choice
from dolfinx_feti.feti.subdomain.kernel import orthonormal
from dolfinx_feti.feti.subdomain.schur import partial_factorisation_is_there, schur_complement
from dolfinx_feti.torn import Torn

__all__ = ["Interior", "create_interior", "worth_eliminating"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

#: Entries of S for each :math:`n^{4/3}`, which is how a sparse factor in three dimensions grows.
DENSITY = 30.0

#: Largest interface of a subdomain that is eliminated: 32 MiB.
LARGEST = 2048

#: Right-hand sides of K_II that MUMPS treats at once.
BLOCK = 256

#: Interior of a subdomain up to which K_II is dense, too. An instance of MUMPS costs a millisecond,
#: and a communicator; thousands of them slow down whatever MPI does.
SMALL = 150


class Interior(ABC):
    """The matrix of each subdomain as the dual method sees it: K on all free dofs, or S on Γ.

    Attributes:
        torn: The torn matrix.
        dofs: Torn dofs on which that matrix lives, a subdomain each.
        factors: Its regularised inverse.
        eliminated: Factors of K_II, if the interior is eliminated.
    """

    torn: Torn
    dofs: list[Indices]
    factors: BlockFactors | DenseFactors
    eliminated: BlockFactors | DenseFactors | None = None

    @abstractmethod
    def update(self) -> None:
        """Take over the current K.

        Raises:
            FactorError: A factorisation failed. Not collective: the caller reduces.
        """

    @abstractmethod
    def restrict(self, i: int, R: Array) -> Array:
        """Restrict orthonormal columns on the free dofs of subdomain i to its ``dofs``."""

    @abstractmethod
    def multiply(self, t: Array) -> Array:
        """Apply the matrix of every subdomain, (n,) → (n,)."""

    @abstractmethod
    def multiply_many(self, i: int, X: Array) -> Array:
        """Apply the matrix of subdomain i to columns on its ``dofs``, (n_i, r) → (n_i, r)."""

    @abstractmethod
    def condense(self, f: Array) -> Array:
        """Move the load of the interior to the interface, (n,) → (n,) or (n, r) → (n, r)."""

    @abstractmethod
    def extend(self, u: Array, f: Array) -> Array:
        """Complete u, (n,), on the interior, where the load is f."""

    def zero_inside(self) -> int:
        """Count zero eigenvalues of K_II: motions of the body that the interface does not feel."""
        if self.eliminated is None:
            return 0
        return int(self.eliminated.inertia()[:, 1].clip(min=0).sum())

    def norms(self) -> Array:
        """Return the mean of the absolute diagonal of K on the ``dofs`` of each subdomain."""
        diagonal = np.abs(self.torn.K.getDiagonal().array_r)
        return np.array([diagonal[dofs].mean() if len(dofs) else 1.0 for dofs in self.dofs])

    def memory(self) -> float:
        """Return the memory of all factors of this process in MiB."""
        return self.factors.memory() + (self.eliminated.memory() if self.eliminated else 0.0)

    def destroy(self) -> None:
        """Free the factors."""
        self.factors.destroy()
        if self.eliminated is not None:
            self.eliminated.destroy()


class Kept(Interior):
    """K on all free dofs."""

    factors: BlockFactors

    def __init__(self, torn: Torn, free: list[Indices], *, symmetric: bool, prefix: str) -> None:
        """Prepare the factorisations of K.

        Args:
            torn: The torn matrix.
            free: Free torn dofs of each subdomain.
            symmetric: Whether K is symmetric.
            prefix: Options prefix of the factorisations.
        """
        self.torn = torn
        self.dofs = free
        self.factors = BlockFactors(torn.K, free, prefix=prefix, symmetric=symmetric)

    def update(self) -> None:
        """Nothing to do before the kernels are known."""

    def restrict(self, i: int, R: Array) -> Array:
        return R

    def multiply(self, t: Array) -> Array:
        return self.torn.multiply(t)  # K t

    def multiply_many(self, i: int, X: Array) -> Array:
        return sparse_block(self.torn.K, self.dofs[i], self.dofs[i]) @ X

    def condense(self, f: Array) -> Array:
        return f

    def extend(self, u: Array, f: Array) -> Array:
        return u


class Eliminated(Interior):
    """S on the interface."""

    factors: DenseFactors
    eliminated: BlockFactors | DenseFactors

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
        self.torn = torn
        self._free = free
        self._choice = Choice(prefix, symmetric=True, right_hand_sides=BLOCK)
        self._on_interface = [np.flatnonzero(glued[rows]).astype(np.int32) for rows in free]
        self.dofs = [rows[glued[rows]] for rows in free]
        self._interior = [rows[~glued[rows]] for rows in free]
        self._glued = np.zeros(torn.n, dtype=bool)
        self._glued[np.concatenate([*self.dofs, np.zeros(0, dtype=np.int32)])] = True
        small = max(map(len, self._interior), default=0) <= SMALL
        self._partial = not small and partial_factorisation_is_there(self._choice)
        if small:
            self.eliminated = DenseFactors(self._interior)
        else:
            self.eliminated = BlockFactors(
                torn.K, self._interior, prefix=prefix, symmetric=True, right_hand_sides=BLOCK
            )
        self.factors = DenseFactors(self.dofs)

    def update(self) -> None:
        if isinstance(self.eliminated, BlockFactors):
            self.eliminated.update()
        if self._partial:
            for i in range(len(self.dofs)):
                self.factors.set_block(i, self._schur_complement(i))
            return
        for i, K in enumerate(self.torn.blocks(self._free)):
            self.factors.set_block(i, self._eliminate(i, K.toarray()))

    def _eliminate(self, i: int, K: Array) -> Array:
        """Return S, (n_Γ, n_Γ), for the dense K of subdomain i; factor K_II if it is dense, too."""
        Γ = self._on_interface[i]
        I = np.setdiff1d(np.arange(len(K)), Γ, assume_unique=True)  # noqa: E741
        if isinstance(self.eliminated, DenseFactors):
            self.eliminated.set_block(i, K[np.ix_(I, I)])
            self.eliminated.update_block(i, np.zeros((len(I), 0)), 1.0)
        X = self.eliminated.solve_many(i, K[np.ix_(I, Γ)])  # X = K_II⁻¹ K_IΓ
        return np.asarray(K[np.ix_(Γ, Γ)] - K[np.ix_(Γ, I)] @ X)  # S = K_ΓΓ − K_ΓI X

    def restrict(self, i: int, R: Array) -> Array:
        return orthonormal(R[self._on_interface[i]])

    def multiply(self, t: Array) -> Array:
        y = np.zeros_like(t)
        self.factors.multiply(t, y)
        return y  # S t

    def multiply_many(self, i: int, X: Array) -> Array:
        return self.factors.multiply_many(i, X)

    def condense(self, f: Array) -> Array:
        x = np.zeros_like(f)
        if f.ndim == 1:
            self.eliminated.solve(f, x)
            Kx = self.torn.multiply(x)
        else:
            for i, rows in enumerate(self._interior):
                x[rows] = self.eliminated.solve_many(i, f[rows])
            Kx = np.stack([self.torn.multiply(column) for column in x.T], axis=1)
        return ((f - Kx).T * self._glued).T  # f_Γ − K_ΓI K_II⁻¹ f_I

    def extend(self, u: Array, f: Array) -> Array:
        u = np.where(self._glued, u, 0.0)
        self.eliminated.solve(f - self.torn.multiply(u), u)  # u_I = K_II⁻¹ (f_I − K_IΓ u_Γ)
        return u

    def _schur_complement(self, i: int) -> Array:
        """Return S, (n_Γ, n_Γ), of subdomain i by a factorisation that stops at the interface."""
        Γ = self._on_interface[i]
        if len(Γ) in (0, len(self._free[i])):
            return sparse_block(self.torn.K, self.dofs[i], self.dofs[i]).toarray(order="F")
        rows = PETSc.IS().createGeneral(self._free[i].astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        K = self.torn.K.createSubMatrix(rows, rows)
        K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        S = schur_complement(K, Γ, self._choice)
        K.destroy()
        rows.destroy()
        return S


def create_interior(
    choice: str,
    torn: Torn,
    free: list[Indices],
    glued: Indices,
    *,
    symmetric: bool,
    prefix: str,
) -> Interior:
    """Keep or eliminate the interior dofs.

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
        worth = symmetric and worth_eliminating(torn, free, on_interface)
        choice = "eliminate" if worth else "keep"
    if choice == "eliminate":
        return Eliminated(torn, free, on_interface, prefix=prefix + "dirichlet_")
    return Kept(torn, free, symmetric=symmetric, prefix=prefix + "local_")


def worth_eliminating(torn: Torn, free: Sequence[Indices], glued: npt.NDArray[np.bool_]) -> bool:
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
