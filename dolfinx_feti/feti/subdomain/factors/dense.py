# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Dense symmetric blocks in packed format, and the factors of their regularised companions.

.. math:: S_ρ = S + ρ\, R R^⊤ = L L^⊤, \qquad S/ρ + R R^⊤ = L L^⊤ + O(2^{-24})

in LAPACK's packed format, the second one in single precision, for a preconditioner
(docs/theory.md). Where Cholesky's factorisation fails, :math:`L Δ L^⊤` (Bunch and Kaufman) takes
its place.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import scipy.linalg.blas as blas
import scipy.linalg.lapack as lapack

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots, require_alive
from dolfinx_feti.feti.subdomain.panels import Panels
from dolfinx_feti.runtime.arrays import Array, Indices, Single
from dolfinx_feti.runtime.native import address_of

Real = TypeVar("Real", np.float32, np.float64)

#: The unit ε of rounding in single precision.
SINGLE = float(np.finfo(np.float32).eps) / 2.0

#: Columns up to which a packed triangle is read once for each, rather than unpacked.
FEW = 6

#: Rows of a tile that is transposed at once: it fits into a fast cache. And what is below its
#: diagonal.
TILE = 96
BELOW = np.tri(TILE, k=-1, dtype=bool)


class PackedMatrix:
    """A symmetric matrix S, (n, n), in packed format.

    Attributes:
        values: The lower triangle, column by column, (n (n + 1) / 2,).
        n: Its size.
        work: Work space that products overwrite, (at least n²,).
    """

    def __init__(self, values: Array, n: int, work: Array) -> None:
        """Take over the entries; NaN or Inf is a FactorError."""
        if not np.isfinite(values).all():
            raise FactorError("a Schur complement has entries that are NaN or Inf")
        self.values, self.n, self.work = values, n, work

    def multiply(self, t: Array) -> Array:
        """Return S t, (n,)."""
        return blas.dspmv(self.n, 1.0, self.values, t, lower=1) if self.n else t

    def multiply_many(self, X: Array) -> Array:
        """Return S X for dense columns, (n, r)."""
        if X.size == 0:
            return np.zeros(X.shape)
        if X.shape[1] <= FEW:
            return np.column_stack([self.multiply(x) for x in X.T])
        S = unpack(self.values, self.n, self.work)
        return blas.dsymm(1.0, S, np.asfortranarray(X), lower=1)

    def multiply_panels(self, W: Panels) -> Array:
        """Return S W for block-sparse columns, (n, r)."""
        if self.n == 0:
            return W.dense()
        return W.product(_mirrored(unpack(self.values, self.n, self.work)))

    def unpacked(self, work: Single) -> Single:
        """Return S in single precision, (n, n) in Fortran's order, in another work space."""
        return unpack(self.values.astype(np.float32), self.n, work)

    def memory(self) -> float:
        """Return the memory of the entries in MiB."""
        return self.values.nbytes / 2**20


class DenseFactor:
    """What applies the inverse of S + ρ R Rᵀ: see ``protocol``.

    Attributes:
        single: Whether it is in single precision.
        pivots: Numbers of negative and zero eigenvalues.
    """

    def __init__(
        self, S: PackedMatrix, R: Array | None = None, rho: float = 1.0, shift: Array | None = None
    ) -> None:
        """Factor S + ρ R Rᵀ + diag(shift), with orthonormal R, (n, k), and a shift, (n,).

        A FactorError tells of a zero pivot.
        """
        self._n, self._work, self.single = S.n, S.work, False
        self._interchanges: Indices | None = None  # of Bunch and Kaufman
        self._scale = 1.0  # of what is factored
        self._X: npt.NDArray[np.floating] = np.zeros(0)  # L, or that of L Δ Lᵀ
        self.pivots = Pivots(0, 0)
        if S.n == 0:
            return
        regularised = functools.partial(_regularised, S.values, S, R, rho, shift)
        X, failed = lapack.dpotrf(regularised(), lower=1, overwrite_a=1, clean=0)
        if failed:
            self._factor_indefinite(regularised())
        else:
            self._X = pack(X)  # L Lᵀ

    def _factor_indefinite(self, X: Array) -> None:
        """Factor a matrix, (n, n), that need not be definite, given by its lower triangle."""
        size = int(lapack.dsytrf_lwork(len(X), lower=1)[0])
        X = X.copy(order="F")
        X, interchanges, failed = lapack.dsytrf(X, lower=1, lwork=size, overwrite_a=1)
        if failed:
            raise FactorError("a zero pivot")
        negative = np.count_nonzero(_pivot_eigenvalues(X, interchanges) < 0.0)
        self._X, self._interchanges = X, interchanges  # L Δ Lᵀ
        self.pivots = Pivots(int(negative), 0)

    @classmethod
    def roughly(cls, S: PackedMatrix, R: Array, rho: float) -> DenseFactor | None:
        """Factor S + ρ R Rᵀ in single precision, or as L Δ Lᵀ where it has negative eigenvalues.

        None if S is empty, or definite in double precision alone. A FactorError tells of a zero
        pivot.
        """
        if S.n == 0:
            return None
        factor = cls(PackedMatrix(np.zeros(0), 0, S.work))
        factor._n = S.n
        values = (S.values / rho).astype(np.float32)
        X, failed = lapack.spotrf(_regularised(values, S, R, 1.0), lower=1, overwrite_a=1, clean=0)
        if failed:
            factor._factor_indefinite(_regularised(S.values, S, R, rho))
            return factor if factor.pivots.negative else None
        factor.single, factor._scale = True, rho
        factor._X = lapack.strttp(X, uplo="L")[0]  # L Lᵀ = S/ρ + R Rᵀ
        return factor

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return S_ρ⁻¹ Y, (n,) or (n, r)."""
        require_alive(self._n >= 0)
        if Y.size == 0:
            return np.zeros(Y.shape)
        if self._interchanges is not None:
            rhs = Y if Y.ndim == 2 else Y[:, None]
            return lapack.dsytrs(self._X, self._interchanges, rhs, lower=1)[0].reshape(Y.shape)
        if Y.ndim == 2 and (self.single or Y.shape[1] > FEW):
            return self.solver()(Y)
        if Y.ndim == 2:
            return np.column_stack([self.solve(y) for y in Y.T])
        tpsv = blas.stpsv if self.single else blas.dtpsv
        y, size = self._scaled(Y)
        x = tpsv(self._n, self._X, y, lower=1)
        x = tpsv(self._n, self._X, x, lower=1, trans=1, overwrite_x=1)  # L⁻ᵀ L⁻¹ y
        return np.asarray(x, dtype=np.float64) * size

    def solver(self) -> Callable[[Array], Array]:
        """Return what applies S_ρ⁻¹ to columns, (n, r), until the work space serves another one."""
        require_alive(self._n >= 0)
        if self._interchanges is not None or self._n == 0:
            return self.solve
        L = unpack(self._X, self._n, self._work.view(self._X.dtype))
        trsm = blas.strsm if self.single else blas.dtrsm

        def solve(Y: Array) -> Array:
            X, size = self._scaled(Y)
            X = trsm(1.0, L, X, lower=1)
            X = trsm(1.0, L, X, lower=1, trans_a=1, overwrite_b=1)  # L⁻ᵀ L⁻¹ Y
            return np.asarray(X, dtype=np.float64) * size

        return solve

    def _scaled(self, Y: Array) -> tuple[npt.NDArray[np.floating], float]:
        """Return Y as the factor takes it, in single precision scaled, and the scale."""
        if not self.single:
            return np.asfortranarray(Y), 1.0
        size = float(np.abs(Y).max(initial=0.0)) or 1.0
        return np.asfortranarray(Y / size, dtype=np.float32), size / self._scale

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""
        return self._X.nbytes / 2**20

    def destroy(self) -> None:
        """Free the factor."""
        self._X, self._n = np.zeros(0), -1


def pack(S: Array) -> Array:
    """Return the lower triangle of S, (n, n), column by column, (n (n + 1) / 2,)."""
    return lapack.dtrttp(S, uplo="L")[0] if len(S) else np.zeros(0)


def _regularised(
    values: npt.NDArray[Real],
    S: PackedMatrix,
    R: Array | None,
    rho: float,
    shift: Array | None = None,
) -> npt.NDArray[Real]:
    """Return S + ρ R Rᵀ, shifted, in the lower triangle of the work space, in given precision."""
    X = unpack(values, S.n, S.work.view(values.dtype))
    if shift is not None:
        X[np.diag_indices(S.n)] += shift
    if R is None or R.shape[1] == 0:
        return X
    syrk = blas.dsyrk if values.dtype == np.float64 else blas.ssyrk
    return syrk(rho, R.astype(values.dtype), beta=1.0, c=X, lower=1, overwrite_c=1)


def unpack(S: npt.NDArray[Real], n: int, work: npt.NDArray[Real]) -> npt.NDArray[Real]:
    """Unpack a matrix into a work space: (n, n) in Fortran's order, below the diagonal.

    Both are in double or in single precision. SciPy's own dtpttr makes a new array, and fills it
    with zeros, which takes ten times as long.
    """
    size, info = ctypes.c_int(n), ctypes.c_int(0)
    to_size, to_info = ctypes.addressof(size), ctypes.addressof(info)
    _tpttr(S.dtype.char)(b"L", to_size, S.ctypes.data, work.ctypes.data, to_size, to_info)
    return work[: n * n].reshape((n, n), order="F")


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
def _tpttr(precision: str) -> Callable[..., None]:
    kind = ctypes.CFUNCTYPE(None, ctypes.c_char_p, *[ctypes.c_void_p] * 5)
    return kind(address_of({"d": "dtpttr", "f": "stpttr"}[precision]))


def _pivot_eigenvalues(X: Array, interchanges: Indices) -> Array:
    """Return the eigenvalues of the blocks of Δ, of one or two rows, in L Δ Lᵀ."""
    d = X.diagonal().copy()
    first = np.flatnonzero(interchanges < 0)[::2]  # the blocks of two rows take two entries
    a, b, c = d[first], X[first + 1, first], d[first + 1]
    mean, radius = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    d[first], d[first + 1] = mean - radius, mean + radius
    return d
