# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Dense symmetric blocks, one per subdomain, and the factors of their regularised companions.

The Schur complement S of a subdomain (``matrices``) is dense, and so is

.. math:: S_ρ = S + ρ\, R R^⊤ = L L^⊤.

A Krylov method reads both in every iteration, from one end to the other. So S and L stand in
LAPACK's packed format, the lower triangle column by column, which a processor reads faster than
triangles of square arrays. For factorisations and several columns at once they are unpacked into
one work space. Where the Cholesky factorisation meets a pivot that is not positive,
:math:`L Δ L^⊤` with Bunch and Kaufman's pivots takes its place, in a square array, and tells the
inertia. If that meets a zero, too, all eigenvalues of the matrix scaled by its diagonal are
computed, and the pseudo-inverse takes the place of a factor.

Where it only preconditions, L may be stored in single precision, divided by its largest entry on
the diagonal, unless that of the smallest one is lost in rounding beside it.

With W = S R, and without cancellation,

.. math:: E = ρ\, S_ρ^{-1} R = R - S_ρ^{-1} W, \qquad D = ρ\, (I - R^⊤ E) = E^⊤ W.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
import scipy.linalg.blas as blas
import scipy.linalg.lapack as lapack

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.panels import Panels
from dolfinx_feti.feti.subdomain.direct import Pivots
from dolfinx_feti.native import address_of

__all__ = ["DenseFactors", "border", "pack"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

#: An eigenvalue of a scaled matrix below this share of the largest one counts as zero.
ZERO = 1e-14

#: Ratio of the least to the largest diagonal entry of Cholesky's factor below which it stays in
#: double precision. One over its square is a lower bound of the condition number of S_ρ.
LEAST = float(np.sqrt(np.finfo(np.float32).eps))

#: Columns up to which a packed triangle is read once for each, rather than unpacked.
FEW = 6

#: Rows of a tile that is transposed at once: it fits into a fast cache. And what is below its
#: diagonal.
TILE = 96
BELOW = np.tri(TILE, k=-1, dtype=bool)


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
        self._blocks = [_Block(np.zeros(0), 0) for _ in self.rows]
        self._work = np.empty(max((len(block) for block in self.rows), default=0) ** 2)

    def set_block(self, i: int, S: Array, *, keep_factor: bool = False) -> None:
        """Take over a block; its factor is gone, unless that of the last one is to serve on.

        Args:
            i: Number of the block.
            S: The block in packed format, see :func:`pack`.
            keep_factor: Whether :meth:`solve` goes on with the factor of the last block.

        Raises:
            FactorError: NaN or Inf in the block. Not collective: the caller reduces.
        """
        if not np.isfinite(S).all():
            raise FactorError("a Schur complement has entries that are NaN or Inf")
        if keep_factor:
            self._blocks[i].S = S
        else:
            self._blocks[i] = _Block(S, len(self.rows[i]))

    def update_block(
        self, i: int, R: Array | None = None, rho: float = 1.0, *, shift: Array | None = None
    ) -> None:
        """Factor one regularised block; see ``Factors``."""
        R = np.zeros((len(self.rows[i]), 0)) if R is None else R
        self._blocks[i].factor(R, rho, shift, self._work)

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
        return self._blocks[i].multiply_many(X, self._work)

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return S_i W for columns that fall into panels, (n_i, r)."""
        return self._blocks[i].multiply_panels(W, self._work)

    def solve_many(self, i: int, Y: Array, *, transpose: bool = False) -> Array:
        """Return (S_i + ρ R Rᵀ)⁻¹ Y for dense columns, (n_i, r)."""
        return self._blocks[i].solve_many(Y, self._work)

    def solve_border(self, i: int) -> tuple[Array, Array]:
        """Return E/ρ, (n_i, k), and −D/ρ², (k, k): the border's solution in ``factors``."""
        return self._blocks[i].solve_border(self._work)

    def pivots(self, i: int) -> Pivots:
        """Count negative and zero eigenvalues of the regularised block i."""
        return self._blocks[i].pivots

    def to_single(self, i: int) -> None:
        """Store the factor of block i in single precision, if it is conditioned well enough."""
        self._blocks[i].to_single()

    def to_double(self) -> None:
        """Factor anew what is stored in single precision."""
        for block in self._blocks:
            if block.single:
                block.factor_again(self._work)

    def singles(self) -> int:
        """Count the blocks whose factors are stored in single precision."""
        return sum(block.single for block in self._blocks)

    def memory(self) -> float:
        """Return the memory of all blocks in MiB."""
        return sum(block.S.nbytes + block.X.nbytes for block in self._blocks) / 2**20

    def destroy(self) -> None:
        """Free the blocks."""
        self._blocks = []


class _Block:
    """S, packed, and what applies the inverse of S_ρ: a Cholesky factor, packed, or another one.

    Methods that take ``work`` overwrite it, (at least n²,).

    Attributes:
        S: The block.
        X: Cholesky's factor, packed; that of Bunch and Kaufman, (n, n), or the inverse, (n, n).
        pivots: Numbers of negative and zero eigenvalues of S_ρ.
        size: What Cholesky's factor is divided by in single precision.
    """

    def __init__(self, S: Array, n: int) -> None:
        self.S = S
        self.X: Array = np.zeros(0)
        self.pivots = Pivots(0, 0)
        self.size = 1.0
        self._n = n
        self._interchanges: npt.NDArray[np.int32] | None = None  # of Bunch and Kaufman
        self._R: Array = np.zeros((n, 0))
        self._rho = 1.0

    def factor(self, R: Array, rho: float, shift: Array | None, work: Array) -> None:
        self._R, self._rho = R, rho
        if self._n == 0:
            return
        self.pivots, self._interchanges = Pivots(0, 0), None
        S_ρ = self._regularised(shift, work)
        X, failed = lapack.dpotrf(S_ρ, lower=1, overwrite_a=1, clean=0)
        self.X = self._factor_indefinite(shift, work) if failed else pack(X)  # L Lᵀ

    @property
    def single(self) -> bool:
        """Whether the factor is stored in single precision."""
        return self.X.dtype == np.float32

    def to_single(self) -> None:
        """Store Cholesky's factor in single precision, unless rounding would spoil it."""
        if self._n == 0 or self.X.ndim == 2:
            return
        diagonal = self.X[_diagonal(self._n)]
        size = float(diagonal.max())
        if diagonal.min() > LEAST * size:
            self.X, self.size = (self.X / size).astype(np.float32), size

    def factor_again(self, work: Array) -> None:
        """Factor S_ρ of the present S in double precision."""
        self.factor(self._R, self._rho, None, work)

    def _regularised(self, shift: Array | None, work: Array) -> Array:
        """Return S + ρ R Rᵀ, shifted, in the lower triangle of the work space."""
        X = _unpack(self.S, self._n, work)
        if shift is not None:
            X[np.diag_indices(self._n)] += shift
        if self._R.shape[1] == 0:
            return X
        return blas.dsyrk(self._rho, self._R, beta=1.0, c=X, lower=1, overwrite_c=1)

    def _factor_indefinite(self, shift: Array | None, work: Array) -> Array:
        """Factor S_ρ = L Δ Lᵀ; invert it if a block of Δ is zero."""
        S_ρ = self._regularised(shift, work).copy(order="F")
        size = int(lapack.dsytrf_lwork(self._n, lower=1)[0])
        X, interchanges, failed = lapack.dsytrf(S_ρ, lower=1, lwork=size, overwrite_a=1)
        if failed:
            return self._invert(shift, work)
        negative = np.count_nonzero(_pivot_eigenvalues(X, interchanges) < 0.0)
        self.pivots = Pivots(int(negative), 0)
        self._interchanges = interchanges
        return X

    def _invert(self, shift: Array | None, work: Array) -> Array:
        X = np.tril(self._regularised(shift, work))
        root = np.sqrt(np.abs(X.diagonal()))
        root[root == 0.0] = root.max() or 1.0
        values, V = np.linalg.eigh(X / root[:, None] / root, UPLO="L")
        zero = np.abs(values) <= ZERO * np.abs(values).max()
        negative = np.count_nonzero(values[~zero] < 0.0)
        self.pivots = Pivots(int(negative), int(np.count_nonzero(zero)))
        values[zero] = np.inf
        V = V / root[:, None]
        return np.asfortranarray((V / values) @ V.T)

    def multiply(self, t: Array) -> Array:
        return blas.dspmv(self._n, 1.0, self.S, t, lower=1) if self._n else t  # S t

    def multiply_many(self, X: Array, work: Array) -> Array:
        if X.size == 0:
            return np.zeros(X.shape)
        if X.shape[1] <= FEW:
            return np.column_stack([self.multiply(x) for x in X.T])
        S = _unpack(self.S, self._n, work)
        return blas.dsymm(1.0, S, np.asfortranarray(X), lower=1)  # S X

    def multiply_panels(self, W: Panels, work: Array) -> Array:
        if self._n == 0:
            return W.dense()
        return W.product(_mirrored(_unpack(self.S, self._n, work)))  # S W

    def solve(self, y: Array) -> Array:
        if self._n == 0:
            return y
        if self.X.ndim == 2:
            return self.solve_many(y[:, None], np.zeros(0))[:, 0]  # neither unpacks anything
        if self.single:
            return self._solve_in_single(y)
        x = blas.dtpsv(self._n, self.X, y, lower=1)
        return blas.dtpsv(self._n, self.X, x, lower=1, trans=1, overwrite_x=1)  # L⁻ᵀ L⁻¹ y

    def _solve_in_single(self, y: Array) -> Array:
        size = float(np.abs(y).max())
        if not 0.0 < size < np.inf:
            return y * size  # zero, or NaN where y has no numbers
        x = blas.stpsv(self._n, self.X, (y / size).astype(np.float32), lower=1)
        x = blas.stpsv(self._n, self.X, x, lower=1, trans=1, overwrite_x=1)
        return x.astype(np.float64) * (size / self.size**2)  # L⁻ᵀ L⁻¹ y

    def solve_many(self, Y: Array, work: Array) -> Array:
        if Y.size == 0:
            return np.zeros(Y.shape)
        if self._interchanges is not None:
            return lapack.dsytrs(self.X, self._interchanges, Y, lower=1)[0]
        if self.X.ndim == 2:
            return np.asarray(self.X @ Y)
        if Y.shape[1] <= FEW:
            return np.column_stack([self.solve(y) for y in Y.T])
        L = _unpack(self.X, self._n, work)
        if self.single:
            size = np.abs(Y).max(axis=0)
            size[size == 0.0] = 1.0
            X = blas.strsm(1.0, L, np.asfortranarray(Y / size, dtype=np.float32), lower=1)
            X = blas.strsm(1.0, L, X, lower=1, trans_a=1, overwrite_b=1)
            return np.asarray(X * (size / self.size**2))  # L⁻ᵀ L⁻¹ Y
        X = blas.dtrsm(1.0, L, np.asfortranarray(Y), lower=1)
        return blas.dtrsm(1.0, L, X, lower=1, trans_a=1, overwrite_b=1)

    def solve_border(self, work: Array) -> tuple[Array, Array]:
        W = self.multiply_many(self._R, work)  # W = S R
        return border(self._R, W, self.solve_many(W, work), self._rho)


def border(R: Array, W: Array, X: Array, rho: float) -> tuple[Array, Array]:
    """Return E/ρ, (n, k), and −D/ρ², (k, k), the border's solution in ``factors``.

    Args:
        R: Orthonormal modes, (n, k).
        W: Their forces K R, or S R.
        X: The solution of the regularised block for W.
        rho: The stiffness ρ.
    """
    E = R - X  # E = R − K_ρ⁻¹ W
    D = E.T @ W  # D = Eᵀ W
    return np.asarray(E / rho), np.asarray(-D / rho**2)


def pack(S: Array) -> Array:
    """Return the lower triangle of S, (n, n), column by column, (n (n + 1) / 2,)."""
    return lapack.dtrttp(S, uplo="L")[0] if len(S) else np.zeros(0)


def _unpack(S: Array, n: int, work: Array) -> Array:
    """Unpack a matrix into the work space: (n, n) in Fortran's order, below the diagonal.

    SciPy's own dtpttr makes a new array, and fills it with zeros, which takes ten times as long.
    """
    size, info = ctypes.c_int(n), ctypes.c_int(0)
    to_size, to_info = ctypes.addressof(size), ctypes.addressof(info)
    unpack = _lapack("stpttr" if S.dtype == np.float32 else "dtpttr")
    unpack(b"L", to_size, S.ctypes.data, work.ctypes.data, to_size, to_info)
    return work.view(S.dtype)[: n * n].reshape((n, n), order="F")


def _mirrored(L: Array) -> Array:
    """Copy the lower triangle of a matrix in Fortran's order to the upper one."""
    n, A = len(L), L.T
    for first in range(0, n, TILE):
        last = min(first + TILE, n)
        A[last:, first:last] = A[first:last, last:].T
        tile, size = A[first:last, first:last], last - first
        np.copyto(tile, tile.T.copy(), where=BELOW[:size, :size])
    return A


@functools.cache
def _lapack(name: str) -> Callable[..., None]:
    return ctypes.CFUNCTYPE(None, ctypes.c_char_p, *[ctypes.c_void_p] * 5)(address_of(name))


def _diagonal(n: int) -> npt.NDArray[np.int64]:
    """Return where the diagonal stands in a packed matrix, (n,)."""
    columns = np.arange(n, 0, -1)
    return np.cumsum(columns) - columns


def _pivot_eigenvalues(X: Array, interchanges: npt.NDArray[np.int32]) -> Array:
    """Return the eigenvalues of the blocks of Δ, of one or two rows, in L Δ Lᵀ."""
    d = X.diagonal().copy()
    first = np.flatnonzero(interchanges < 0)[::2]  # the blocks of two rows take two entries
    a, b, c = d[first], X[first + 1, first], d[first + 1]
    mean, radius = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    d[first], d[first + 1] = mean - radius, mean + radius
    return d
