# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Dense symmetric blocks, one a subdomain, and the factors of their regularised companions.

The Schur complement S of a subdomain (``interior``) is dense, and so is

.. math:: S_ρ = S + ρ\, R R^⊤ = U^⊤ U.

A Krylov method needs both in every iteration, and reads either triangle of *one* array: the lower
one holds S, the upper one and the diagonal hold U; the diagonal of S stands apart. Where the
Cholesky factorisation meets a pivot that is not positive, all eigenvalues tell the inertia, and
:math:`S_ρ^{-1}` itself takes the place of U. With W = S R, and without cancellation,

.. math:: E = ρ\, S_ρ^{-1} R = R - S_ρ^{-1} W, \qquad D = ρ\, (I - R^⊤ E) = E^⊤ W.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy.linalg.blas as blas
import scipy.linalg.lapack as lapack

from dolfinx_feti.errors import FactorError

__all__ = ["DenseFactors"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

#: An eigenvalue, or a squared pivot, below this share of the largest one counts as zero.
ZERO = 1e-14


class DenseFactors:
    """Symmetric blocks ``S_i`` on the dofs ``rows_i`` and the factors of ``S_i + ρ R Rᵀ``.

    The methods are those of ``BlockFactors`` (``factors``), with R in the place of its border;
    :meth:`multiply` and :meth:`multiply_many` apply S itself.

    Attributes:
        rows: Dofs of each block.
    """

    def __init__(self, rows: Sequence[Indices]) -> None:
        """Prepare empty blocks.

        Args:
            rows: Dofs of each block.
        """
        self.rows = list(rows)
        self._blocks = [_Block(np.zeros((0, 0), order="F")) for _ in self.rows]

    def set_block(self, i: int, S: Array) -> None:
        """Take over the block S, (n_i, n_i), of which the lower triangle is read."""
        self._blocks[i] = _Block(np.asfortranarray(S))

    def update(self, R: Sequence[Array], rho: Array) -> None:
        """Factor every regularised block.

        Args:
            R: For each block its columns R, (n_i, k), orthonormal.
            rho: For each block the stiffness ρ.

        Raises:
            FactorError: NaN or Inf in a block. Not collective: the caller reduces.
        """
        for i, R_i in enumerate(R):
            self.update_block(i, R_i, float(rho[i]))

    def update_block(self, i: int, R: Array, rho: float) -> None:
        """Factor block i with the columns R, see :meth:`update`."""
        self._blocks[i].factor(R, rho)

    def multiply(self, t: Array, y: Array) -> None:
        """Apply every block: ``y[rows_i] = S_i t[rows_i]``, other entries untouched."""
        for rows, block in zip(self.rows, self._blocks, strict=True):
            y[rows] = block.multiply(t[rows])

    def solve(self, y: Array, x: Array) -> None:
        """Apply every inverse: ``x[rows_i] = (S_i + ρ R Rᵀ)⁻¹ y[rows_i]``."""
        for rows, block in zip(self.rows, self._blocks, strict=True):
            x[rows] = block.solve(y[rows])

    def multiply_many(self, i: int, X: Array) -> Array:
        """Return S_i X for dense columns, (n_i, r)."""
        return self._blocks[i].multiply_many(X)

    def solve_many(self, i: int, Y: Array) -> Array:
        """Return (S_i + ρ R Rᵀ)⁻¹ Y for dense columns, (n_i, r)."""
        return self._blocks[i].solve_many(Y)

    def solve_border(self, i: int, *, transpose: bool = False) -> tuple[Array, Array]:
        """Return E/ρ, (n_i, k), and −D/ρ², (k, k): the border's solution in ``factors``."""
        return self._blocks[i].solve_border()

    def inertia(self) -> npt.NDArray[np.int64]:
        """Count negative and zero eigenvalues of each regularised block, (blocks, 2)."""
        known = [block.inertia for block in self._blocks]
        return np.array(known, dtype=np.int64).reshape(-1, 2)

    def inertia_of(self, i: int) -> tuple[int, int]:
        """Count negative and zero eigenvalues of the regularised block i."""
        return self._blocks[i].inertia

    def memory(self) -> float:
        """Return the memory of all blocks in MiB."""
        return sum(block.S.nbytes for block in self._blocks) / 2**20

    def destroy(self) -> None:
        """Free the blocks."""
        self._blocks = []


class _Block:
    """S in the lower triangle, U or the inverse in the upper one and on the diagonal."""

    def __init__(self, S: Array) -> None:
        self.S = S
        self.diagonal = S.diagonal().copy()
        self.inertia = (0, 0)
        self._definite = False
        self._R: Array = np.zeros((len(S), 0))
        self._rho = 1.0

    def factor(self, R: Array, rho: float) -> None:
        self._R, self._rho = R, rho
        if len(self.S) == 0:
            return
        if not np.isfinite(self.diagonal).all():
            raise FactorError("a Schur complement has entries that are NaN or Inf")
        X = self._regularised()
        X, failed = lapack.dpotrf(X, lower=0, overwrite_a=1, clean=0)  # Uᵀ U = S + ρ R Rᵀ
        pivots = X.diagonal() ** 2
        self._definite = not failed and pivots.min() > ZERO * pivots.max()
        self.inertia = (0, 0)
        if not self._definite:
            X = self._invert_indefinite()
        np.copyto(X, self.S, where=np.tri(len(X), k=-1, dtype=bool))
        self.S = X

    def _regularised(self) -> Array:
        """Form S + ρ R Rᵀ in the upper triangle of a new array."""
        X: Array = self.S.T.copy(order="F")
        np.fill_diagonal(X, self.diagonal)
        if self._R.shape[1] == 0:
            return X
        return blas.dsyrk(self._rho, self._R, beta=1.0, c=X, lower=0, overwrite_c=1)

    def _invert_indefinite(self) -> Array:
        X = self._regularised()
        values, V = np.linalg.eigh(X, UPLO="U")
        zero = np.abs(values) <= ZERO * np.abs(values).max()
        self.inertia = (int(np.count_nonzero(values[~zero] < 0.0)), int(np.count_nonzero(zero)))
        values[zero] = np.inf
        return np.asfortranarray((V / values) @ V.T)

    def multiply(self, t: Array) -> Array:
        if len(t) == 0:
            return t
        y = blas.dsymv(1.0, self.S, t, lower=1)
        y += (self.diagonal - self.S.diagonal()) * t
        return y  # S t

    def multiply_many(self, X: Array) -> Array:
        if X.size == 0:
            return np.zeros(X.shape)
        Y = blas.dsymm(1.0, self.S, np.asfortranarray(X), lower=1)
        Y += (self.diagonal - self.S.diagonal())[:, None] * X
        return Y  # S X

    def solve(self, y: Array) -> Array:
        if len(y) == 0:
            return y
        if not self._definite:
            return blas.dsymv(1.0, self.S, y, lower=0)
        x = blas.dtrsv(self.S, y, lower=0, trans=1)
        return blas.dtrsv(self.S, x, lower=0, overwrite_x=1)  # U⁻¹ U⁻ᵀ y

    def solve_many(self, Y: Array) -> Array:
        if Y.size == 0:
            return np.zeros(Y.shape)
        if Y.shape[1] == 1:
            return self.solve(Y[:, 0])[:, None]
        if not self._definite:
            return blas.dsymm(1.0, self.S, np.asfortranarray(Y), lower=0)
        X = blas.dtrsm(1.0, self.S, np.asfortranarray(Y), lower=0, trans_a=1)
        return blas.dtrsm(1.0, self.S, X, lower=0, overwrite_b=1)

    def solve_border(self) -> tuple[Array, Array]:
        W = self.multiply_many(self._R)  # W = S R
        E = self._R - self.solve_many(W)  # E = R − S_ρ⁻¹ W
        D = E.T @ W
        return np.asarray(E / self._rho), np.asarray(-D / self._rho**2)
