# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Soft modes of a subdomain, which join its kernel by an update of the inverse.

.. math:: K y = μ\, k_Γ\, y, \qquad μ < \text{threshold},

with the stiffness :math:`k_Γ` of the interface dofs; a rough approximation is enough. Columns Y,
orthogonal to R, join R without another factor (Sherman, Morrison and Woodbury; docs/theory.md),

.. math:: Z = K_ρ^{-1} Y, \quad C = (ρ^{-1} I + Y^⊤ Z)^{-1}, \quad G = Y^⊤ E, \quad E_Y = Z C, \quad
          (E - E_Y G,\; E_Y), \quad
          \begin{pmatrix} D + G^⊤ C G & -G^⊤ C \\ -C G & C \end{pmatrix}

and :math:`(I - E_Y Y^⊤)\, K_ρ^{-1}` for the inverse.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dolfinx_feti.feti.subdomain.orthonormal import symmetric_part
from dolfinx_feti.runtime.arrays import Array

__all__ = ["ALL_MODES", "Basis", "join", "soft_modes"]

Solve = Callable[[Array], Array]

#: The modes of a subdomain, orthonormal R, (n, k), E and D: see ``pseudoinverse``.
Basis = tuple[Array, Array, Array]

#: Subdomains of up to so many dofs have all their eigenvectors computed.
ALL_MODES = 200

#: Powers of the operator and spare columns in a subspace iteration: more of either find more modes,
#: but save no iterations.
POWERS, SPARE = 2, 4


def soft_modes(solve: Solve, weight: Array, most: int, threshold: float) -> Array:
    """Approximate the softest modes, up to ``most``, with μ below the threshold, (n, k).

    :math:`K_ρ^{-1}` is applied by ``solve``; the weight is the stiffness of the interface dofs,
    zero on the others, (n,). With more than :data:`ALL_MODES` dofs a mode close to the threshold
    may be missed.
    """
    n, root = len(weight), np.sqrt(weight)
    most = min(most, np.count_nonzero(weight) // 10)
    if most == 0:
        return np.zeros((n, 0))

    X = np.random.default_rng(n).standard_normal((n, min(n, most + SPARE)))
    for _ in range(POWERS):
        X = np.eye(n) if n <= ALL_MODES else np.linalg.qr(X)[0]
        Y = solve(root[:, None] * X)
        image = root[:, None] * Y  # k^½ K_ρ⁻¹ k^½ X
        values, vectors = np.linalg.eigh(symmetric_part(X.T @ image))  # 1/μ, by Rayleigh and Ritz
        if n <= ALL_MODES:
            break
        X = image
    soft = np.flatnonzero(values * threshold > 1.0)[-most:]
    return np.asarray(Y @ vectors[:, soft])  # y = K_ρ⁻¹ k^½ X z


def join(basis: Basis, Y: Array, Z: Array, rho: float) -> Basis:
    """Let soft modes Y, orthonormal and orthogonal to R, join R; Z is K_ρ⁻¹ Y, (n, k)."""
    R, E, D = basis
    C = np.linalg.inv(np.eye(Y.shape[1]) / rho + Y.T @ Z)
    G, E_Y = Y.T @ E, Z @ C
    return (
        _side_by_side(R, Y),
        _side_by_side(E - E_Y @ G, E_Y),
        np.block([[D + G.T @ C @ G, -G.T @ C], [-C @ G, C]]),
    )


def _side_by_side(X: Array, Y: Array) -> Array:
    """Return (X, Y) column by column, so that slices of columns are read fast."""
    return np.asfortranarray(np.hstack([X, Y]))
