# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Soft and buckling modes of a subdomain, which join its kernel (docs/theory.md).

.. math:: K y = μ\, k_Γ\, y, \quad μ < \text{threshold}, \qquad \text{and} \qquad
          K_ρ\, y = μ\, y, \quad μ < 0,

with the stiffness :math:`k_Γ` of the interface dofs. Rough approximations are enough. Soft modes,
(n, k), are joined by an update of the inverse, :math:`(I - E_Y Y^⊤)\, K_ρ^{-1}`, without a factor.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse.linalg

from dolfinx_feti.feti.subdomain.orthonormal import symmetric_part
from dolfinx_feti.runtime.arrays import Array

Solve = Callable[[Array], Array]

#: The modes of a subdomain, orthonormal R, (n, k), E and D: see ``pseudoinverse``.
Basis = tuple[Array, Array, Array]

#: Subdomains of up to so many dofs have all their eigenvectors computed.
ALL_MODES = 200

#: Lanczos' method: relative error of an eigenvalue, and restarts.
ACCURACY, RESTARTS = 1e-2, 50

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
    D = np.block([[D + G.T @ C @ G, -G.T @ C], [-C @ G, C]])
    R, E = np.hstack([R, Y]), np.hstack([E - E_Y @ G, E_Y])
    return np.asfortranarray(R), np.asfortranarray(E), D  # slices of columns are read fast


def buckling_modes(solve: Solve, multiply: Solve, n: int, count: int) -> Array:
    """Approximate eigenvectors of ``count`` negative eigenvalues of :math:`K_ρ`, (n, up to count).

    It is applied and inverted for columns, (n, r) → (n, r).
    """
    if n <= max(ALL_MODES, 2 * count + 2):
        return np.linalg.eigh(symmetric_part(solve(np.eye(n))))[1][:, :count]
    modes = _lower_end(solve, n, count)
    missing = count - modes.shape[1]
    return np.hstack([modes, _lower_end(multiply, n, missing)]) if missing else modes


def _lower_end(apply: Solve, n: int, count: int) -> Array:
    """Return the eigenvectors of the least eigenvalues, as many as converged, (n, up to count)."""
    operator = scipy.sparse.linalg.LinearOperator(
        (n, n), matvec=lambda x: apply(x.reshape(-1, 1)).ravel(), dtype=np.float64
    )
    start = np.random.default_rng(n).standard_normal(n)
    krylov = min(n - 1, max(2 * count + 8, 20))
    try:
        values, vectors = scipy.sparse.linalg.eigsh(
            operator, k=count, which="SA", v0=start, ncv=krylov, tol=ACCURACY, maxiter=RESTARTS
        )
    except scipy.sparse.linalg.ArpackNoConvergence as rough:
        values, vectors = rough.eigenvalues, rough.eigenvectors
    return np.asarray(vectors[:, np.argsort(values)])
