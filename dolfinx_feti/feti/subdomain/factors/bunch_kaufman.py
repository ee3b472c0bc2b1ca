# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Factors of dense indefinite blocks with pivoting (Bunch and Kaufman, Math. Comp. 31, 1977).

.. math:: S_ρ = S + ρ\, R R^⊤ + \operatorname{diag} σ = L Δ L^⊤

Δ has blocks of one or two rows, and as many negative eigenvalues as S_ρ.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg.lapack as lapack

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.factors.packed import PackedMatrix
from dolfinx_feti.feti.subdomain.factors.protocol import FactorInertia, destroyed_error
from dolfinx_feti.runtime.arrays import Array, Indices


class BunchKaufmanFactor:
    """L Δ Lᵀ of a symmetric matrix, (n, n); methods are those of ``Factor``.

    Attributes:
        inertia: Number of negative eigenvalues; no zero pivots.
        is_single_precision: False.
    """

    is_single_precision = False

    def __init__(self, L_Δ: Array, interchanges: Indices) -> None:
        """Store the results of LAPACK's dsytrf for a matrix of n > 0 rows.

        Args:
            L_Δ: L and Δ in one matrix, (n, n).
            interchanges: Row interchanges, (n,), negative for a block of two rows.
        """
        self._L_Δ: Array | None = L_Δ
        self._interchanges = interchanges
        negative = np.count_nonzero(_eigenvalues_of_pivots(L_Δ, interchanges) < 0.0)
        self.inertia = FactorInertia(int(negative), 0)

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return L⁻ᵀ Δ⁻¹ L⁻¹ Y, (n,) or (n, r)."""
        if self._L_Δ is None:
            raise destroyed_error()
        if Y.size == 0:
            return np.zeros(Y.shape)
        columns = Y if Y.ndim == 2 else Y[:, None]
        return lapack.dsytrs(self._L_Δ, self._interchanges, columns, lower=1)[0].reshape(Y.shape)

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""
        return 0.0 if self._L_Δ is None else self._L_Δ.nbytes / 2**20

    def destroy(self) -> None:
        """Free the factor."""
        self._L_Δ = None


def factor_bunch_kaufman(
    S: PackedMatrix, R: Array, rho: float, shift: Array | None = None
) -> BunchKaufmanFactor:
    """Factor S + ρ R Rᵀ + diag(shift) of at least one row.

    Args:
        S: The block, (n, n).
        R: Columns, (n, k).
        rho: Stiffness ρ.
        shift: Addend of the diagonal, (n,); None for zero.

    Raises:
        FactorError: A pivot is zero.
    """
    A = S.unpack_regularised(R, rho, shift)
    lwork = int(lapack.dsytrf_lwork(len(A), lower=1)[0])
    # Without overwrite_a, dsytrf copies A: the factor outlives the work space of S.
    L_Δ, interchanges, info = lapack.dsytrf(A, lower=1, lwork=lwork)
    if info:
        raise FactorError(
            f"a zero pivot in row {info} of {len(A)} of a dense block: the subdomain has a motion "
            "without stiffness"
        )
    return BunchKaufmanFactor(L_Δ, interchanges)


def _eigenvalues_of_pivots(L_Δ: Array, interchanges: Indices) -> Array:
    """Return the eigenvalues of Δ, (n,).

    Args:
        L_Δ: LAPACK's L and Δ in one matrix, (n, n).
        interchanges: LAPACK's row interchanges, (n,), negative for a block of two rows.
    """
    d = L_Δ.diagonal().copy()
    # Both rows of a block are negative, and blocks follow each other: every second one is a first.
    first = np.flatnonzero(interchanges < 0)[::2]
    a = d[first]
    b = L_Δ[first + 1, first]
    c = d[first + 1]
    mean = 0.5 * (a + c)
    radius = np.hypot(0.5 * (a - c), b)
    d[first] = mean - radius
    d[first + 1] = mean + radius
    return d
