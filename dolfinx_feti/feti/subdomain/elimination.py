# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Elimination of the interior: four ways to the Schur complement, and the choice among them.

.. math:: S = K_{ΓΓ} - K_{ΓI} K_{II}^{-1} K_{IΓ}

(eq. 50, Augustin_eq:DirichletVK). All of them also leave factors of :math:`K_{II}`, with which
loads are condensed and displacements extended.

- :class:`DenseElimination`: K and :math:`K_{II}` are dense; for small interiors.
- :class:`FrontElimination`: Cholesky's factorisation, stopped at the interface (``fronts``), gives
  both; where :math:`K_{II}` is not positive definite, one of the next two.
- :class:`PartialElimination`: a factorisation with pivots that stops at the interface (``schur``),
  and one of :math:`K_{II}`.
- :class:`ColumnElimination`: :math:`K_{II}^{-1} K_{IΓ}` column by column, with any solver.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.subdomain.blocks import index_set, named, sparse_block
from dolfinx_feti.feti.subdomain.dense import DenseFactors, pack
from dolfinx_feti.feti.subdomain.direct import Choice
from dolfinx_feti.feti.subdomain.sparse.factors import BlockFactors
from dolfinx_feti.feti.subdomain.sparse.fronts import FrontCode, load_fronts_for
from dolfinx_feti.feti.subdomain.sparse.interior import InteriorFactors
from dolfinx_feti.feti.subdomain.sparse.schur import (
    partial_factorisation_is_there,
    schur_complement,
)
from dolfinx_feti.petsc_library import rows_of
from dolfinx_feti.torn import Torn

__all__ = ["Elimination", "create_elimination"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

#: Interior of a subdomain up to which K_II is dense, too. An instance of MUMPS costs a millisecond,
#: and a communicator; thousands of them slow down whatever MPI does.
SMALL = 150

#: Right-hand sides of K_II that MUMPS treats at once.
RIGHT_HAND_SIDES = 256


class Elimination(ABC):
    """S and the factors of K_II of every subdomain of the process.

    Attributes:
        interior: Interior dofs I of each subdomain, torn.
        interface: Interface dofs Γ of each subdomain, torn.
        factors: Factors of K_II.
    """

    factors: BlockFactors | DenseFactors | InteriorFactors

    def __init__(
        self, torn: Torn, free: list[Indices], glued: npt.NDArray[np.bool_], choice: Choice
    ) -> None:
        """Prepare the factorisations.

        Args:
            torn: The torn matrix, symmetric.
            free: Free torn dofs of each subdomain.
            glued: Mask of the interface, (n,).
            choice: How to factor.
        """
        self._torn = torn
        self._free = free
        self._choice = choice
        self.interface = [rows[glued[rows]] for rows in free]
        self.interior = [rows[~glued[rows]] for rows in free]
        self.on_interface = [np.flatnonzero(glued[rows]).astype(np.int32) for rows in free]

    @abstractmethod
    def schur_complements(self) -> Iterator[Array]:
        """Factor K_II of the current K and yield S, in packed format, of each subdomain.

        Raises:
            FactorError: A factorisation failed. Not collective: the caller reduces.
        """

    def _eliminate(self, i: int, K: Array) -> Array:
        """Return S, packed, for the dense K of subdomain i, with the factor of its K_II."""
        Γ = self.on_interface[i]
        I = _others(len(K), Γ)  # noqa: E741
        X = self.factors.solve_many(i, K[np.ix_(I, Γ)])  # X = K_II⁻¹ K_IΓ
        return pack(K[np.ix_(Γ, Γ)] - K[np.ix_(Γ, I)] @ X)  # S = K_ΓΓ − K_ΓI X


class DenseElimination(Elimination):
    """K and K_II are dense."""

    factors: DenseFactors

    def __init__(
        self, torn: Torn, free: list[Indices], glued: npt.NDArray[np.bool_], choice: Choice
    ) -> None:
        super().__init__(torn, free, glued, choice)
        self.factors = DenseFactors(self.interior)

    def schur_complements(self) -> Iterator[Array]:
        for i, block in enumerate(self._torn.blocks(self._free)):
            with named(self._torn.first + i):
                K = block.toarray()
                I = _others(len(K), self.on_interface[i])  # noqa: E741
                self.factors.set_block(i, pack(K[np.ix_(I, I)]))
                self.factors.update_block(i)
                S = self._eliminate(i, K)
            yield S


class ColumnElimination(Elimination):
    """K is dense for a while, K_II sparse: n_Γ right-hand sides."""

    factors: BlockFactors

    def __init__(
        self, torn: Torn, free: list[Indices], glued: npt.NDArray[np.bool_], choice: Choice
    ) -> None:
        super().__init__(torn, free, glued, choice)
        self.factors = BlockFactors(
            torn.K,
            self.interior,
            prefix=choice.prefix,
            symmetric=True,
            right_hand_sides=choice.right_hand_sides,
        )

    def schur_complements(self) -> Iterator[Array]:
        for i in range(len(self._free)):
            with named(self._torn.first + i):
                S = self.schur_complement(i)
            yield S

    def schur_complement(self, i: int) -> Array:
        """Factor K_II of subdomain i and return S, packed."""
        self.factors.update_block(i)
        return self._eliminate(i, sparse_block(self._torn.K, *[self._free[i]] * 2).toarray())


class PartialElimination(ColumnElimination):
    """A factorisation of K that stops at the interface gives S."""

    def schur_complement(self, i: int) -> Array:
        self.factors.update_block(i)
        Γ = self.on_interface[i]
        if len(Γ) in (0, len(self._free[i])):
            return pack(sparse_block(self._torn.K, *[self.interface[i]] * 2).toarray("F"))
        rows = index_set(self._free[i])
        K = self._torn.K.createSubMatrix(rows, rows)
        definite = self.factors.pivots(i) == (0, 0)  # then the interior needs no pivots
        K.setOption(PETSc.Mat.Option.SPD if definite else PETSc.Mat.Option.SYMMETRIC, True)
        S = schur_complement(K, Γ, self._choice)
        K.destroy()
        rows.destroy()
        return S


class FrontElimination(Elimination):
    """One factorisation without pivots gives S and the factor of K_II."""

    factors: InteriorFactors

    def __init__(
        self, torn: Torn, free: list[Indices], pivoted: ColumnElimination, code: FrontCode
    ) -> None:
        """Prepare the fronts.

        Args:
            torn: The torn matrix, symmetric.
            free: Free torn dofs of each subdomain.
            pivoted: What eliminates a K_II that is not positive definite; destroyed with this.
            code: What ``load_fronts`` returns.
        """
        self.interface, self.interior = pivoted.interface, pivoted.interior
        self.on_interface = pivoted.on_interface
        self.factors = InteriorFactors(torn, free, pivoted.factors)
        self._torn = torn
        self._pivoted = pivoted
        self._code = code

    def schur_complements(self) -> Iterator[Array]:
        work: Array = np.zeros(0)
        with rows_of(self._torn.K) as K:
            for i, Γ in enumerate(self.on_interface):
                with named(self._torn.first + i):
                    S, work = self.factors.schur_complement(i, K, Γ, self._code, work)
                    if S is None:
                        S = self._pivoted.schur_complement(i)
                yield S


def create_elimination(
    torn: Torn, free: list[Indices], glued: npt.NDArray[np.bool_], *, prefix: str
) -> Elimination:
    """Choose the way to S.

    Args:
        torn: The torn matrix, symmetric.
        free: Free torn dofs of each subdomain.
        glued: Mask of the interface, (n,).
        prefix: Options prefix of the factorisations.

    Note:
        Collective.
    """
    choice = Choice(prefix, symmetric=True, right_hand_sides=RIGHT_HAND_SIDES)
    largest = max((np.count_nonzero(~glued[rows]) for rows in free), default=0)
    if torn.comm.allreduce(largest, op=MPI.MAX) <= SMALL:
        return DenseElimination(torn, free, glued, choice)
    partial = partial_factorisation_is_there(choice)
    pivoted = (PartialElimination if partial else ColumnElimination)(torn, free, glued, choice)
    code = load_fronts_for(choice.prefix, torn.comm)
    return pivoted if code is None else FrontElimination(torn, free, pivoted, code)


def _others(n: int, chosen: Indices) -> Indices:
    """Return the indices below n that are not among the chosen ones."""
    return np.setdiff1d(np.arange(n, dtype=np.int32), chosen, assume_unique=True)
