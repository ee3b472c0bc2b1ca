# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Ritz vectors of a solve, by which later solves are deflated.

They are the combinations (W, Z) y with the smallest Ritz values θ,

.. math:: (W, Z)^⊤ A\, (W, Z)\, y = θ\, (W, Z)^⊤ M^{-1} (W, Z)\, y, \qquad θ < θ_0,

in the span of the solve's own W and of its preconditioned residuals Z (Gosselet, Rey, Pebrel, Total
and selective reuse of Krylov subspaces, 2013; docs/theory.md). They cost no product with A or
:math:`M^{-1}`, because the iterations have computed A Z = R H with Z = Π M R. Π adds to M R
combinations of V and W, so that

.. math:: M^{-1} Z = R + (M^{-1} W)\, W^⊤ M^{-1} Z.

The part in V is left out: with :math:`M + V X V^⊤` in place of M, Z is the same for every X,
because :math:`V^⊤ R = 0`, and the inverse maps V to zero as X grows.

In exact arithmetic :math:`Z^⊤ R` would be diagonal. Rounding spoils the orthogonality of the
residuals; therefore Gram matrices are computed in full. If A is not symmetric, the symmetric part
of (W, Z)ᵀ A (W, Z) is taken. The Ritz vectors have :math:`W^⊤ M^{-1} W = I` with the M of their
solve.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from dolfinx_feti.feti.primal.deflation import MIN_INDEPENDENT_ENERGY, DeflationSpace
from dolfinx_feti.feti.primal.krylov.base import KrylovBasis
from dolfinx_feti.feti.solve_info import DeflationVectors
from dolfinx_feti.feti.subdomain.orthonormal import diagonalise, symmetric_part
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all, total_of

#: Largest Ritz value θ₀ of a vector that is deflated. Apart from soft directions, the spectrum
#: begins at about one (docs/theory.md). The artery path (``primal/__init__``) takes 466 iterations
#: with this value, 541 with 0.4, and 559 with 0.96. More vectors cost time, too: balancing and
#: multiplying a dozen takes as long as six iterations.
MAX_RITZ_VALUE = 0.8

#: Iterations whose vectors are stored, for each Ritz vector that a solve may return. A memory
#: bound: with the default of 20 Ritz vectors, 80 iterations store 160 vectors. The artery path
#: takes 466 iterations with two to eight, and 471 with one.
STORED_ITERATIONS_PER_VECTOR = 4


def recycled_vectors(
    space: DeflationSpace, basis: KrylovBasis, *, max_count: int
) -> DeflationVectors:
    """Return the Ritz vectors of a solve, by which later solves are deflated. Collective.

    Args:
        space: V and W of the solve.
        basis: Vectors of its first iterations.
        max_count: Largest number of Ritz vectors.

    Returns:
        The Ritz vectors with values below ``MAX_RITZ_VALUE``, in ascending order of their values.
        If the basis is empty or has entries that are not finite, the W of the solve.
    """
    unchanged = DeflationVectors(space.W, space.M_inverse_W)
    k = len(basis.Z)
    if k == 0:
        return unchanged
    comm = space.copies.comm
    δ = space.copies.delta[:, None]
    W = space.W
    M_inverse_W = space.M_inverse_W
    Z = basis.Z.T  # (n_Γ, k)
    R = basis.R.T  # (n_Γ, k + 1)
    ZR = total_of(Z.T @ (δ * R), comm)  # Zᵀ R, (k, k + 1)
    WZ = total_of((δ * M_inverse_W).T @ Z, comm)  # Wᵀ M⁻¹ Z, (vectors of W, k)
    if not (np.isfinite(ZR).all() and np.isfinite(WZ).all()):
        return unchanged
    y_W, y_Z = on_all(lambda: _smallest_ritz_vectors(space.H, ZR, WZ, basis.H, max_count), comm)
    ritz_vectors = W @ y_W + Z @ y_Z
    # M⁻¹ (W y_W + Z y_Z), with M⁻¹ Z = R + (M⁻¹ W) Wᵀ M⁻¹ Z
    M_inverse_ritz_vectors = M_inverse_W @ (y_W + WZ @ y_Z) + R[:, :k] @ y_Z
    return DeflationVectors(
        np.asfortranarray(ritz_vectors), np.asfortranarray(M_inverse_ritz_vectors)
    )


def _smallest_ritz_vectors(
    H_W: Array, ZR: Array, WZ: Array, H: Array, max_count: int
) -> tuple[Array, Array]:
    """Compute the combinations of W and Z that are Ritz vectors with the smallest values.

    Args:
        H_W: Wᵀ A W, (w, w), for w vectors W.
        ZR: Zᵀ R, (k, k + 1).
        WZ: The product of W and Z in the scalar product of M⁻¹, Wᵀ M⁻¹ Z, (w, k).
        H: H of A Z = R H, (k + 1, k).
        max_count: Largest number of combinations.

    Returns:
        Coefficients y of W, (w, c), and of Z, (k, c), with c up to ``max_count``.
    """
    w = len(WZ)
    # (W, Z)ᵀ A (W, Z): Wᵀ A Z = 0 because Π makes Z A-orthogonal to W, and Zᵀ A Z = Zᵀ R H.
    energy = scipy.linalg.block_diag(H_W, ZR @ H)
    # (W, Z)ᵀ M⁻¹ (W, Z), with Wᵀ M⁻¹ W = I
    gram = np.block([[np.eye(w), WZ], [WZ.T, symmetric_part(ZR[:, :-1]) + WZ.T @ WZ]])
    squares, T = diagonalise(gram, MIN_INDEPENDENT_ENERGY)
    T /= np.sqrt(np.abs(squares))  # Tᵀ (W, Z)ᵀ M⁻¹ (W, Z) T = I
    θ, Y = np.linalg.eigh(symmetric_part(T.T @ energy @ T))
    count = min(max_count, np.count_nonzero(θ < MAX_RITZ_VALUE))
    y_W, y_Z = np.split(T @ Y[:, :count], [w])
    return y_W, y_Z
