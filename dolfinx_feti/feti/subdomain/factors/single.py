# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Cholesky factors of dense blocks in single precision, for a preconditioner.

.. math:: \tfrac1ρ S + R R^⊤ = L L^⊤ + O(ε), \qquad ε = 2^{-24}.

They take half the memory, and half the time to form and to apply. A direction in which the block is
softer than its diagonal by a factor g is off by a share of about ε g: what asks for such a factor
looks at g (``pseudoinverse``). :math:`L L^⊤` is positive definite whatever has been rounded.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import scipy.linalg.blas as blas
import scipy.linalg.lapack as lapack

from dolfinx_feti.feti.subdomain.factors.dense import PackedMatrix, unpack
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots, require_alive

__all__ = ["ROUNDING", "SingleFactor", "factor_in_single"]

Array = npt.NDArray[np.float64]
Single = npt.NDArray[np.float32]

#: The unit ε of rounding.
ROUNDING = float(np.finfo(np.float32).eps) / 2.0


class SingleFactor:
    """What applies the inverse of S + ρ R Rᵀ, up to rounding in single precision: see ``protocol``.

    Attributes:
        pivots: None is negative or zero.
    """

    pivots = Pivots(0, 0)

    def __init__(self, L: Single, n: int, rho: float, work: Array) -> None:
        """Take over L, in packed format, (n (n + 1) / 2,), ρ, and a work space, (at least n²,)."""
        self._L, self._n, self._rho, self._work = L, n, rho, work

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return S_ρ⁻¹ Y, (n,) or (n, r)."""
        require_alive(self._n >= 0)
        if Y.ndim == 2:
            return self.solver()(Y)
        y, size = _scaled(Y)
        x = blas.stpsv(self._n, self._L, y, lower=1, overwrite_x=1)
        x = blas.stpsv(self._n, self._L, x, lower=1, trans=1, overwrite_x=1)  # L⁻ᵀ L⁻¹ y
        return x.astype(np.float64) * (size / self._rho)

    def solver(self) -> Callable[[Array], Array]:
        """Return what applies S_ρ⁻¹ to columns, (n, r), until the work space serves another one."""
        require_alive(self._n >= 0)
        L = unpack(self._L, self._n, self._work.view(np.float32))

        def solve(Y: Array) -> Array:
            X, size = _scaled(Y)
            X = blas.strsm(1.0, L, X, lower=1, overwrite_b=1)
            X = blas.strsm(1.0, L, X, lower=1, trans_a=1, overwrite_b=1)  # L⁻ᵀ L⁻¹ Y
            return X.astype(np.float64) * (size / self._rho)

        return solve

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""
        return self._L.nbytes / 2**20

    def destroy(self) -> None:
        """Free the factor."""
        self._L, self._n = np.zeros(0, dtype=np.float32), -1


def factor_in_single(S: PackedMatrix, R: Array, rho: float) -> SingleFactor | None:
    """Factor S + ρ R Rᵀ with orthonormal R, (n, k); None if L Lᵀ meets a pivot that is not > 0."""
    if S.n == 0:
        return None
    packed = (S.values / rho).astype(np.float32)
    X = unpack(packed, S.n, S.work.view(np.float32))
    if R.shape[1]:
        X = blas.ssyrk(1.0, R.astype(np.float32), beta=1.0, c=X, lower=1, overwrite_c=1)
    X, failed = lapack.spotrf(X, lower=1, overwrite_a=1, clean=0)
    return None if failed else SingleFactor(lapack.strttp(X, uplo="L")[0], S.n, rho, S.work)


def _scaled(Y: Array) -> tuple[Single, float]:
    """Return Y by its largest entry, in single precision and Fortran's order, and that entry."""
    size = float(np.abs(Y).max(initial=0.0)) or 1.0
    return np.asfortranarray(Y / size, dtype=np.float32), size
