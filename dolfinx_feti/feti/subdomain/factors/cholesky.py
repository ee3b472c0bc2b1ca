# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Cholesky factors of dense regularised blocks, in double and in single precision.

.. math:: S_ρ = S + ρ\, R R^⊤ + \operatorname{diag} σ = L L^⊤, \qquad
          S/ρ + R R^⊤ = L L^⊤ + O(2^{-24}),

with L in packed format. The factor in single precision is a preconditioner. It takes half the
memory, and half the time of a solve (docs/theory.md).
"""

from __future__ import annotations

import numpy as np
import scipy.linalg.blas as blas
import scipy.linalg.lapack as lapack

from dolfinx_feti.feti.subdomain.factors.packed import MAX_PACKED_COLUMNS, PackedMatrix
from dolfinx_feti.feti.subdomain.factors.protocol import FactorInertia, destroyed_error
from dolfinx_feti.feti.subdomain.factors.work_space import (
    PackedTriangle,
    WorkSpace,
    pack,
    pack_single,
)
from dolfinx_feti.runtime.arrays import Array

#: Largest relative error of rounding to single precision, 2⁻²⁴: half the distance between 1 and the
#: next float.
SINGLE_ROUNDING = float(np.finfo(np.float32).eps) / 2.0


class CholeskyFactor:
    """L Lᵀ of a positive definite matrix, (n, n); methods are those of ``Factor``.

    Attributes:
        inertia: No negative eigenvalues, and no zero pivots.
        is_single_precision: False.
    """

    inertia = FactorInertia(0, 0)
    is_single_precision = False

    def __init__(self, L: PackedTriangle[np.float64], work: WorkSpace) -> None:
        """Store L, (n, n), n > 0; a shared work space is used to unpack it."""
        self._L: PackedTriangle[np.float64] | None = L
        self._work = work

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return L⁻ᵀ L⁻¹ Y, (n,) or (n, r)."""
        if self._L is None:
            raise destroyed_error()
        if Y.ndim == 1:
            return _solve_packed(self._L, Y)
        if Y.shape[1] == 0:
            return np.zeros(Y.shape)
        if Y.shape[1] <= MAX_PACKED_COLUMNS:
            return np.column_stack([_solve_packed(self._L, y) for y in Y.T])
        L = self._work.unpack(self._L)
        X = blas.dtrsm(1.0, L, np.asfortranarray(Y), lower=1)
        return blas.dtrsm(1.0, L, X, lower=1, trans_a=1, overwrite_b=1)  # L⁻ᵀ L⁻¹ Y

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""
        return 0.0 if self._L is None else self._L.memory()

    def destroy(self) -> None:
        """Free the factor."""
        self._L = None


def _solve_packed(L: PackedTriangle[np.float64], y: Array) -> Array:
    """Return L⁻ᵀ L⁻¹ y, (n,)."""
    x = blas.dtpsv(L.n, L.entries, np.asfortranarray(y), lower=1)
    return blas.dtpsv(L.n, L.entries, x, lower=1, trans=1, overwrite_x=1)


class SingleCholeskyFactor:
    """L Lᵀ ≈ S/ρ + R Rᵀ in single precision, (n, n); methods are those of ``Factor``.

    The right-hand sides are divided by their largest entry, and the solutions multiplied by it: in
    any physical unit the numbers are within the range of floats.

    Attributes:
        inertia: No negative eigenvalues, and no zero pivots.
        is_single_precision: True.
    """

    inertia = FactorInertia(0, 0)
    is_single_precision = True

    def __init__(self, L: PackedTriangle[np.float32], rho: float, work: WorkSpace) -> None:
        """Store L, (n, n), n > 0, a factor of S/ρ + R Rᵀ.

        Args:
            L: The factor.
            rho: The stiffness ρ.
            work: Shared work space, in which L is unpacked.
        """
        self._L: PackedTriangle[np.float32] | None = L
        self._rho = rho
        self._work = work

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return S_ρ⁻¹ Y, (n,) or (n, r), with the accuracy of single precision."""
        if self._L is None:
            raise destroyed_error()
        if Y.size == 0:
            return np.zeros(Y.shape)
        scale = float(np.abs(Y).max()) or 1.0
        X = np.asfortranarray(Y / scale, dtype=np.float32)
        if Y.ndim == 1:
            X = blas.stpsv(self._L.n, self._L.entries, X, lower=1)
            X = blas.stpsv(self._L.n, self._L.entries, X, lower=1, trans=1, overwrite_x=1)
        else:
            L = self._work.unpack(self._L)
            X = blas.strsm(1.0, L, X, lower=1)
            X = blas.strsm(1.0, L, X, lower=1, trans_a=1, overwrite_b=1)  # L⁻ᵀ L⁻¹ Y
        return np.asarray(X, dtype=np.float64) * (scale / self._rho)

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""
        return 0.0 if self._L is None else self._L.memory()

    def destroy(self) -> None:
        """Free the factor."""
        self._L = None


def factor_cholesky(
    S: PackedMatrix, R: Array, rho: float, shift: Array | None = None
) -> CholeskyFactor | None:
    """Factor S + ρ R Rᵀ + diag(shift) of at least one row.

    Args:
        S: The block, (n, n).
        R: Columns, (n, k).
        rho: Stiffness ρ.
        shift: Addend of the diagonal, (n,); None for zero.

    Returns:
        The factor; None if the matrix is not positive definite.
    """
    X = S.unpack_regularised(R, rho, shift)
    # clean=0: the entries above the diagonal remain arbitrary, and ``pack`` does not read them.
    X, info = lapack.dpotrf(X, lower=1, overwrite_a=1, clean=0)
    if info:
        return None
    return CholeskyFactor(PackedTriangle(pack(X), S.n), S.work)


def factor_cholesky_in_single_precision(
    S: PackedMatrix, R: Array, rho: float
) -> SingleCholeskyFactor | None:
    """Factor S + ρ R Rᵀ of at least one row in single precision.

    Args:
        S: The block, (n, n).
        R: Columns, (n, k).
        rho: Stiffness ρ, a mean stiffness of the block.

    Returns:
        The factor; None if the matrix is not positive definite in single precision.
    """
    X = S.unpack_regularised_in_single_precision(R, rho)
    X, info = lapack.spotrf(X, lower=1, overwrite_a=1, clean=0)
    if info:
        return None
    return SingleCholeskyFactor(PackedTriangle(pack_single(X), S.n), rho, S.work)
