# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Orthonormal bases of columns that may be linearly dependent.

For columns X, (p, k), in the Euclidean scalar product,

.. math:: X = U Σ V^⊤, \qquad X B = U, \quad B = V Σ^{-1};

for a symmetric H, (k, k), that is scaled to a unit diagonal first,

.. math:: B^⊤ H B = Θ.

The columns of B are the coefficients of *combinations* X B. If the rows are distributed over
processes, see ``regularity.tsqr``.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from dolfinx_feti.runtime.arrays import Array

#: Largest singular value, relative to the largest of all, that counts as zero: the square root of
#: the machine epsilon. Translations and rotations of a subdomain far from the origin agree in up to
#: half of their digits, and still count as independent.
RANK_RTOL = 1e-8

#: A column counts as dependent on others if the sine of its angle to their span is at most this.
#: The part of a unit column that is orthogonal to the span has rounding errors of 1e-16. At this
#: angle they are 1e-10 of that part.
MIN_SINE = 1e-6


def orthonormal(X: Array) -> Array:
    """Return an orthonormal basis of columns, (p, k) → (p, up to k)."""
    if X.size == 0:
        return X[:, :0]
    U, sigma, _ = scipy.linalg.svd(X, full_matrices=False)
    return np.ascontiguousarray(U[:, sigma > RANK_RTOL * sigma[0]])


def append_orthonormal(R: Array, Y: Array) -> Array:
    """Orthonormalise columns and append them to others.

    Args:
        R: Orthonormal columns, (p, k).
        Y: Columns of any norm, (p, r).

    Returns:
        R, and an orthonormal basis of the part of Y that is orthogonal to R, (p, up to k + r).
    """
    norms = np.linalg.norm(Y, axis=0)
    Y = Y / np.where(norms > 0.0, norms, 1.0)
    for _ in range(2):  # twice is enough: rounding of the first time is removed by the second
        Y = Y - R @ (R.T @ Y)
    U, sigma, _ = np.linalg.svd(Y, full_matrices=False)
    return np.hstack([R, U[:, sigma > MIN_SINE]])


def orthonormal_combinations(X: Array) -> Array:
    """Return combinations B with (X B)ᵀ X B = I, (p, k) → (k, up to k)."""
    _, sigma, Vt = np.linalg.svd(X, full_matrices=False)
    is_independent = sigma > RANK_RTOL * sigma.max(initial=0.0)
    return np.asarray(Vt[is_independent].T / sigma[is_independent])


def null_combinations(X: Array, tolerance: float) -> Array:
    """Return orthonormal combinations C that X maps to almost nothing.

    Args:
        X: Columns, (p, k).
        tolerance: Largest ‖X c‖ of a unit combination c; absolute, unlike :data:`RANK_RTOL`.

    Returns:
        C, (k, up to k).
    """
    # All k right singular vectors, also of p < k rows: those without a singular value have zero.
    _, sigma, Vt = np.linalg.svd(np.linalg.qr(X, mode="r"))
    rank = np.count_nonzero(sigma > tolerance)
    return np.asarray(Vt[rank:].T)


def diagonalise(H: Array, tolerance: float) -> tuple[Array, Array]:
    """Compute combinations that diagonalise a matrix which is symmetric up to rounding.

    Args:
        H: The matrix, (k, k), scaled to a unit diagonal first.
        tolerance: Eigenvalues θ of the scaled matrix with |θ| ≤ tolerance are left out.

    Returns:
        θ, ascending, (r,), and B with Bᵀ H B = diag(θ), (k, r), r ≤ k.
    """
    scale = unit_scale(H)
    theta, Q = np.linalg.eigh(symmetric_part(scale[:, None] * H * scale))
    is_nonzero = np.abs(theta) > tolerance
    return theta[is_nonzero], scale[:, None] * Q[:, is_nonzero]


def unit_scale(H: Array) -> Array:
    """Return s that scales a diagonal to ±1, :math:`s_j^2 |h_{jj}| = 1`, or 0 where it is zero."""
    root = np.sqrt(np.abs(H.diagonal()))
    return np.divide(1.0, root, where=root > 0.0, out=np.zeros_like(root))


def symmetric_part(H: Array) -> Array:
    """Return ½ (H + Hᵀ)."""
    return np.asarray(0.5 * (H + H.T))
