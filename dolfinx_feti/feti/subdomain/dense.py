# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Dense symmetric blocks, one per subdomain, and the factors of their regularised companions.

The Schur complement S of a subdomain (``matrices``) is dense, and so is

.. math:: S_ρ = S + ρ\, R R^⊤ = U^⊤ U.

A Krylov method needs both in every iteration, and reads either triangle of *one* array: the lower
one holds S, the upper one and the diagonal hold U; the diagonal of S stands apart. Where the
Cholesky factorisation meets a pivot that is not positive, :math:`U Δ U^⊤` with Bunch and Kaufman's
pivots takes its place, and tells the inertia. If that meets a zero, too, all eigenvalues of the
matrix scaled by its diagonal are computed, and the pseudo-inverse stands in the upper triangle.
With W = S R, and without cancellation,

.. math:: E = ρ\, S_ρ^{-1} R = R - S_ρ^{-1} W, \qquad D = ρ\, (I - R^⊤ E) = E^⊤ W.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy.linalg.blas as blas
import scipy.linalg.lapack as lapack

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.direct import Pivots

__all__ = ["DenseFactors"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

#: An eigenvalue of a scaled matrix below this share of the largest one counts as zero.
ZERO = 1e-14


class DenseFactors:
    """Symmetric blocks ``S_i`` on the dofs ``rows_i`` and the factors of ``S_i + ρ R Rᵀ``.

    The methods are those of ``Factors`` (``factors``); :meth:`multiply` and :meth:`multiply_many`
    apply S itself.

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

    def set_block(self, i: int, S: Array, *, keep_factor: bool = False) -> None:
        """Take over a block; its factor is gone, unless that of the last one is to serve on.

        Args:
            i: Number of the block.
            S: The block, (n_i, n_i), of which the lower triangle is read.
            keep_factor: Whether :meth:`solve` goes on with the factor of the last block.

        Raises:
            FactorError: NaN or Inf in the block. Not collective: the caller reduces.
        """
        if keep_factor:
            self._blocks[i].replace(S)
        else:
            self._blocks[i] = _Block(np.asfortranarray(S))

    def update_block(
        self, i: int, R: Array | None = None, rho: float = 1.0, *, shift: Array | None = None
    ) -> None:
        """Factor one regularised block.

        Args:
            i: Number of the block.
            R: Its columns, (n_i, k), orthonormal.
            rho: The stiffness ρ.
            shift: Added to the diagonal, (n_i,).

        Raises:
            FactorError: NaN or Inf in the block. Not collective: the caller reduces.
        """
        block = self._blocks[i]
        block.factor(np.zeros((len(block.S), 0)) if R is None else R, rho, shift)

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

    def solve_many(self, i: int, Y: Array, *, transpose: bool = False) -> Array:
        """Return (S_i + ρ R Rᵀ)⁻¹ Y for dense columns, (n_i, r)."""
        return self._blocks[i].solve_many(Y)

    def solve_border(self, i: int) -> tuple[Array, Array]:
        """Return E/ρ, (n_i, k), and −D/ρ², (k, k): the border's solution in ``factors``."""
        return self._blocks[i].solve_border()

    def pivots(self, i: int) -> Pivots:
        """Count negative and zero eigenvalues of the regularised block i."""
        return self._blocks[i].pivots

    def memory(self) -> float:
        """Return the memory of all blocks in MiB."""
        return sum(block.S.nbytes for block in self._blocks) / 2**20

    def destroy(self) -> None:
        """Free the blocks."""
        self._blocks = []


class _Block:
    """S in the lower triangle, its factor or inverse in the upper one and on the diagonal."""

    def __init__(self, S: Array) -> None:
        self.S = S
        self.diagonal = S.diagonal().copy()
        self.pivots = Pivots(0, 0)
        self._interchanges: npt.NDArray[np.int32] | None = None  # of Bunch and Kaufman
        self._inverted = False
        self._R: Array = np.zeros((len(S), 0))
        self._rho = 1.0
        self._shift: Array | None = None

    def replace(self, S: Array) -> None:
        """Take another S beside the factor that is there."""
        np.copyto(self.S, S, where=np.tri(len(S), k=-1, dtype=bool))
        self.diagonal = S.diagonal().copy()
        self._require_finite()

    def _require_finite(self) -> None:
        if not np.isfinite(self.diagonal).all():
            raise FactorError("a Schur complement has entries that are NaN or Inf")

    def factor(self, R: Array, rho: float, shift: Array | None) -> None:
        self._R, self._rho, self._shift = R, rho, shift
        if len(self.S) == 0:
            return
        self._require_finite()
        self.pivots, self._interchanges, self._inverted = Pivots(0, 0), None, False
        X, failed = lapack.dpotrf(self._regularised(), lower=0, overwrite_a=1, clean=0)  # Uᵀ U
        if failed:
            X = self._factor_indefinite()
        np.copyto(X, self.S, where=np.tri(len(X), k=-1, dtype=bool))
        self.S = X

    def _regularised(self) -> Array:
        """Form S + ρ R Rᵀ, shifted, in the upper triangle of a new array."""
        X: Array = self.S.T.copy(order="F")
        np.fill_diagonal(X, self.diagonal if self._shift is None else self.diagonal + self._shift)
        if self._R.shape[1] == 0:
            return X
        return blas.dsyrk(self._rho, self._R, beta=1.0, c=X, lower=0, overwrite_c=1)

    def _factor_indefinite(self) -> Array:
        """Factor S_ρ = U Δ Uᵀ in the upper triangle; invert it if a block of Δ is zero."""
        work = int(lapack.dsytrf_lwork(len(self.S), lower=0)[0])
        X, interchanges, failed = lapack.dsytrf(
            self._regularised(), lower=0, lwork=work, overwrite_a=1
        )
        if failed:
            return self._invert()
        negative = np.count_nonzero(_pivot_eigenvalues(X, interchanges) < 0.0)
        self.pivots = Pivots(int(negative), 0)
        self._interchanges = interchanges
        return X

    def _invert(self) -> Array:
        X = self._regularised()
        root = np.sqrt(np.abs(X.diagonal()))
        root[root == 0.0] = root.max() or 1.0
        values, V = np.linalg.eigh(X / root[:, None] / root, UPLO="U")
        zero = np.abs(values) <= ZERO * np.abs(values).max()
        negative = np.count_nonzero(values[~zero] < 0.0)
        self.pivots, self._inverted = Pivots(int(negative), int(np.count_nonzero(zero))), True
        values[zero] = np.inf
        V = V / root[:, None]
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
        if self._inverted:
            return blas.dsymv(1.0, self.S, y, lower=0)
        if self._interchanges is not None:
            return lapack.dsytrs(self.S, self._interchanges, y, lower=0)[0]
        x = blas.dtrsv(self.S, y, lower=0, trans=1)
        return blas.dtrsv(self.S, x, lower=0, overwrite_x=1)  # U⁻¹ U⁻ᵀ y

    def solve_many(self, Y: Array) -> Array:
        if Y.size == 0:
            return np.zeros(Y.shape)
        if Y.shape[1] == 1:
            return self.solve(Y[:, 0])[:, None]
        if self._inverted:
            return blas.dsymm(1.0, self.S, np.asfortranarray(Y), lower=0)
        if self._interchanges is not None:
            return lapack.dsytrs(self.S, self._interchanges, Y, lower=0)[0]
        X = blas.dtrsm(1.0, self.S, np.asfortranarray(Y), lower=0, trans_a=1)
        return blas.dtrsm(1.0, self.S, X, lower=0, overwrite_b=1)

    def solve_border(self) -> tuple[Array, Array]:
        W = self.multiply_many(self._R)  # W = S R
        E = self._R - self.solve_many(W)  # E = R − S_ρ⁻¹ W
        D = E.T @ W
        return np.asarray(E / self._rho), np.asarray(-D / self._rho**2)


def _pivot_eigenvalues(X: Array, interchanges: npt.NDArray[np.int32]) -> Array:
    """Return the eigenvalues of the blocks of Δ, of one or two rows, in U Δ Uᵀ."""
    d = X.diagonal().copy()
    second = np.flatnonzero(interchanges < 0)[1::2]  # the blocks of two rows take two entries
    a, b, c = d[second - 1], X[second - 1, second], d[second]
    mean, radius = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    d[second - 1], d[second] = mean - radius, mean + radius
    return d
