# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Interfaces of the factorisations of one subdomain: symbolic factors, and factors.

.. math:: x = (K + ρ\, R R^⊤ + \operatorname{diag} σ)^{-1} y

with columns R, (n_i, k), a stiffness ρ and a shift σ, each of which may be absent. R is orthonormal
if it regularises a subdomain, but not in the search for null vectors (``null_vectors``). A symbolic
factor belongs to the pattern of K, and factors all matrices with this pattern. A factor belongs to
one matrix. It does not refer to the matrix, and does not change with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from dolfinx_feti.feti.subdomain.factors.work_space import WorkSpace
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.petsc_library import CSRMatrix


class FactorInertia(NamedTuple):
    """Counts of pivots, which give the signs of the eigenvalues of a matrix.

    Attributes:
        negative: Number of negative eigenvalues (Sylvester's law of inertia); None if the
            factorisation does not report it.
        zero_pivots: Number of pivots that are exactly zero; a singular matrix may have none. None
            if the factorisation does not report it.
    """

    negative: int | None
    zero_pivots: int | None


class Factor(Protocol):
    """The factor of one matrix, (n_i, n_i)."""

    @property
    def inertia(self) -> FactorInertia:
        """Numbers of negative eigenvalues and of zero pivots, known after ``destroy`` as well."""

    @property
    def is_single_precision(self) -> bool:
        """Whether the factor is in single precision; ``solve`` takes and returns doubles."""

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Solve with the matrix or its transpose.

        Args:
            Y: One right-hand side, (n_i,), or several, (n_i, r), stored by rows or by columns; r
                may be zero. Y does not change.
            transpose: Solve with the transpose; the same for a symmetric matrix.

        Returns:
            The solutions, a new array of the shape of Y.

        Raises:
            RuntimeError: The factor has been destroyed.
        """

    def memory(self) -> float:
        """Return the memory of the factor in MiB; zero if it is unknown, or destroyed."""

    def destroy(self) -> None:
        """Free the memory of the factor; further calls do nothing."""


class Elimination(Protocol):
    """The result of eliminating the interior of one matrix."""

    @property
    def factor(self) -> Factor:
        """The factor of K_II."""

    @property
    def schur(self) -> Array:
        """S in packed format, (n_{Γ,i} (n_{Γ,i} + 1) / 2,); no entries without an interface."""


class SymbolicFactor(Protocol):
    """The symbolic factorisation of one sparse symmetric block, (n_i, n_i); immutable.

    It depends only on the pattern of the block, and is created with the block's rows of K
    (``create.analyse_blocks``). A block with an interface Γ is the matrix of a subdomain, of which
    the interior is eliminated. A block without one is eliminated as a whole: all of its dofs are
    interior ones below, and K_II is the block.

    The rows of K_II, also in ``solve`` of its factor, are the interior dofs in ascending order; the
    rows of S are the dofs of Γ in ascending order.
    """

    @property
    def last_dofs(self) -> Numbers:
        """Interior dofs that are eliminated last, (p,), as indices into the interior.

        They form one dense block of the factor: a dense matrix can be added to K_II on these dofs
        without further entries in the factor (:meth:`factor_sum`). Empty if the factorisation has
        no such block.
        """

    def factor(self, K: CSRMatrix, work: WorkSpace) -> Elimination | None:
        """Factor K_II, and form S, for one matrix with this pattern.

        Args:
            K: Matrix of all subdomains of the process, (n, n).
            work: Work space, shared with other blocks, for a factorisation that needs one. The
                results do not refer to it.

        Returns:
            The factor and S; None if K_II is not positive definite.

        Raises:
            FactorError: K has an entry outside of the pattern.
            MemoryError: Memory ran out.
        """

    def factor_sum(self, K: CSRMatrix, addend: Array, work: WorkSpace) -> Elimination | None:
        """Factor K_II with a dense matrix added on ``last_dofs``, like :meth:`factor`.

        It is called only if ``last_dofs`` is not empty.

        Args:
            K: Matrix of all subdomains of the process, (n, n).
            addend: The dense matrix, symmetric, (p, p).
            work: Work space, as in :meth:`factor`.
        """


@dataclass(frozen=True, slots=True)
class EmptyFactor:
    """The factor of a matrix without rows; methods are those of ``Factor``.

    It has nothing to free: ``solve`` works after ``destroy``, too.
    """

    is_single_precision = False

    @property
    def inertia(self) -> FactorInertia:
        """No negative eigenvalues, and no zero pivots."""
        return FactorInertia(0, 0)

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return no entries, of the shape of Y, (0,) or (0, r)."""
        return np.zeros(Y.shape)

    def memory(self) -> float:
        """Return zero."""
        return 0.0

    def destroy(self) -> None:
        """Do nothing."""


def destroyed_error() -> RuntimeError:
    """Return the error of a solve with a factor that has been destroyed."""
    return RuntimeError("the factor has been destroyed: factor the matrix again")


def sum_counts(counts: Sequence[int | None]) -> int | None:
    """Return the sum of counts; None if one of them is None."""
    known = [count for count in counts if count is not None]
    return sum(known) if len(known) == len(counts) else None
