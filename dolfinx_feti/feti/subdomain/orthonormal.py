# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Orthonormal bases of columns, dependent ones dropped.

.. math:: X = U Σ V^⊤, \qquad X B = U \text{ for } B = V Σ^{-1}, \qquad B^⊤ H B = Θ

for columns X, (n, k), in Euclid's scalar product, and for a Gram matrix H, (k, k), in that of H,
scaled to a unit diagonal first. For rows that are distributed see ``regularity.motions``.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from dolfinx_feti.runtime.arrays import Array

#: A singular value below this share of the largest one is zero: the square root of rounding, so
#: that columns far from the origin, which agree in half of their digits, still count.
RANK = 1e-8

#: Sine of the angle to given columns below which a column repeats them. Eigenvectors are
#: approximate, and what this leaves of one has ten digits.
REPETITION = 1e-6


def orthonormal(X: Array) -> Array:
    """Return an orthonormal basis of columns, (n, k) → (n, up to k)."""
    if X.size == 0:
        return X[:, :0]
    U, sigma, _ = scipy.linalg.svd(X, full_matrices=False)
    return np.ascontiguousarray(U[:, sigma > RANK * sigma[0]])


def append_orthonormal(R: Array, Y: Array) -> Array:
    """Append columns to orthonormal ones, orthonormalised, (n, k), (n, r) → (n, up to k + r)."""
    size = np.linalg.norm(Y, axis=0)
    Y = Y / np.where(size > 0.0, size, 1.0)
    for _ in range(2):
        Y = Y - R @ (R.T @ Y)
    U, sigma, _ = np.linalg.svd(Y, full_matrices=False)
    return np.hstack([R, U[:, sigma > REPETITION]])


def orthonormalising(X: Array) -> Array:
    """Return combinations B with (X B)ᵀ X B = I, (n, k) → (k, up to k)."""
    _, sigma, Vt = np.linalg.svd(X, full_matrices=False)
    kept = sigma > RANK * sigma.max(initial=0.0)
    return np.asarray(Vt[kept].T / sigma[kept])


def null_combinations(X: Array, tolerance: float) -> Array:
    """Return orthonormal combinations C with ‖X C‖ ≤ tolerance, (n, k) → (k, up to k)."""
    _, sigma, Vt = np.linalg.svd(np.linalg.qr(X, mode="r"))
    return np.asarray(Vt[np.count_nonzero(sigma > tolerance) :].T)


def diagonalising(H: Array, tolerance: float) -> tuple[Array, Array]:
    """Return θ, ascending, and combinations B with Bᵀ H B = diag(θ), (k, k) → (k, up to k).

    H is symmetric up to rounding. Scaled to a unit diagonal, eigenvalues in ± tolerance are left
    out.
    """
    scale = unit_scale(H)
    theta, Q = np.linalg.eigh(symmetric_part(scale[:, None] * H * scale))
    kept = np.abs(theta) > tolerance
    return theta[kept], scale[:, None] * Q[:, kept]


def unit_scale(H: Array) -> Array:
    """Return s that scales a diagonal to ±1, :math:`s_j^2 |h_{jj}| = 1`, or 0 where it is zero."""
    size = np.sqrt(np.abs(H.diagonal()))
    return np.divide(1.0, size, where=size > 0.0, out=np.zeros_like(size))


def symmetric_part(H: Array) -> Array:
    """Return ½ (H + Hᵀ)."""
    return np.asarray(0.5 * (H + H.T))
