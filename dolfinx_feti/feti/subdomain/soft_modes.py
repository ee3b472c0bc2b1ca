# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Soft and buckling modes of a subdomain (docs/theory.md).

.. math:: K y = μ\, k_Γ\, y, \quad μ < \text{threshold}, \qquad \text{and} \qquad
          K_ρ\, y = μ\, y, \quad μ < 0,

with the stiffness :math:`k_Γ` of the interface dofs. Soft modes belong to the largest eigenvalues
1/μ of :math:`k_Γ^{1/2} K_ρ^{-1} k_Γ^{1/2}`. The modes R are not among them, because :math:`K_ρ`
stiffens them. Approximate eigenvectors suffice: E and D (``modes``) are exact for any columns R and
Y. Buckling modes join R, and :math:`K_ρ` is factored again. Soft modes join Y, without another
factorisation:

.. math:: K^+ = (K_ρ + ρ\, Y Y^⊤)^{-1} = (I - E_Y Y^⊤)\, K_ρ^{-1}, \qquad
          E_Y = X C, \quad X = K_ρ^{-1} Y, \quad C = (ρ^{-1} I + Y^⊤ X)^{-1}.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse.linalg

from dolfinx_feti.feti.subdomain.orthonormal import symmetric_part
from dolfinx_feti.runtime.arrays import Array, ColumnMap

#: Largest subdomain of which all eigenvectors are computed, and none is missed [dofs]. That takes
#: 7 ms with 200 dofs, and 27 ms with 400.
MAX_DOFS_FOR_EIGH = 200

#: Interface dofs of a subdomain for each of its soft modes, at least. A memory bound: soft modes
#: add at most a tenth of the number of interface dofs to the coarse problem.
MIN_DOFS_PER_MODE = 10

#: Relative error of an eigenvalue in Lanczos' method. An approximate eigenvector is good enough if
#: its Rayleigh quotient is negative.
LANCZOS_RTOL = 1e-2

#: Restarts of Lanczos' method. Modes that have not converged by then are computed from the matrix
#: instead of its inverse, or in the next round (``mode_search.MAX_BUCKLING_ROUNDS``).
MAX_LANCZOS_RESTARTS = 50

#: Smallest basis of Lanczos' method: SciPy's default.
MIN_LANCZOS_VECTORS = 20

#: Vectors in the basis of Lanczos' method in addition to two for each mode. SciPy's default is one;
#: a larger basis needs more memory and fewer restarts.
SPARE_LANCZOS_VECTORS = 8

#: Steps of a subspace iteration. In the dual form a tube of 12 subdomains takes 1146 iterations up
#: to 80 mmHg. One step misses some modes, with 1284 iterations; with four steps there are 1147.
SUBSPACE_STEPS = 2

#: Columns of a subspace iteration in addition to the wanted modes. The same tube takes 1152
#: iterations with two, 1146 with four, and 1149 with eight.
SPARE_COLUMNS = 4


def soft_modes(solve: ColumnMap, weight: Array, max_count: int, threshold: float) -> Array:
    """Approximate the softest modes, those with μ below the threshold, (n_i, up to max_count).

    With more than :data:`MAX_DOFS_FOR_EIGH` dofs a mode close to the threshold may be missed.

    Args:
        solve: Applies K_ρ⁻¹ to columns, (n_i, r) → (n_i, r).
        weight: Stiffness k_Γ of the interface dofs, zero on the others, (n_i,).
        max_count: Largest number of modes.
        threshold: Bound of μ.
    """
    n = len(weight)
    max_count = min(max_count, np.count_nonzero(weight) // MIN_DOFS_PER_MODE)
    if max_count == 0:
        return np.zeros((n, 0))
    root = np.sqrt(weight)[:, None]
    if n <= MAX_DOFS_FOR_EIGH:
        X = np.eye(n)
    else:
        X = _dominant_subspace(solve, root, min(n, max_count + SPARE_COLUMNS))
    Y = solve(root * X)  # K_ρ⁻¹ k^½ X
    values, vectors = np.linalg.eigh(symmetric_part(X.T @ (root * Y)))  # 1/μ, by Rayleigh and Ritz
    is_soft = np.flatnonzero(values * threshold > 1.0)[-max_count:]  # the largest 1/μ are last
    return np.asarray(Y @ vectors[:, is_soft])


def _dominant_subspace(solve: ColumnMap, root: Array, count: int) -> Array:
    """Approximate the eigenvectors of the largest eigenvalues of k^½ K_ρ⁻¹ k^½.

    Args:
        solve: Applies K_ρ⁻¹ to columns, (n_i, r) → (n_i, r).
        root: k^½, (n_i, 1).
        count: Number of vectors.

    Returns:
        An orthonormal basis of their span, (n_i, count).
    """
    n = len(root)
    X = np.random.default_rng(n).standard_normal((n, count))
    for _ in range(SUBSPACE_STEPS - 1):  # the caller takes the last step, by Rayleigh and Ritz
        X = root * solve(root * np.linalg.qr(X)[0])  # k^½ K_ρ⁻¹ k^½ X
    return np.linalg.qr(X)[0]


def append_soft_modes(E: Array, D: Array, Y: Array, X: Array, rho: float) -> tuple[Array, Array]:
    """Compute E and D of the modes (R, Y) from those of R.

    By Sherman, Morrison and Woodbury, with C as above and G = Yᵀ E (docs/theory.md).

    Args:
        E: ρ K_ρ⁻¹ R, (n_i, k).
        D: Its defect, (k, k).
        Y: Soft modes, orthonormal and orthogonal to R, (n_i, k_Y).
        X: K_ρ⁻¹ Y, (n_i, k_Y).
        rho: The stiffness ρ.

    Returns:
        E = ρ K⁺ (R, Y), (n_i, k + k_Y), and D, (k + k_Y, k + k_Y).
    """
    C = np.linalg.inv(np.eye(Y.shape[1]) / rho + Y.T @ X)
    G = Y.T @ E
    E_Y = X @ C
    D = np.block([[D + G.T @ C @ G, -G.T @ C], [-C @ G, C]])
    E = np.hstack([E - E_Y @ G, E_Y])
    return np.asfortranarray(E), D  # slices of columns are read fast in Fortran's order


def buckling_modes(solve: ColumnMap, multiply: ColumnMap, n: int, count: int) -> Array:
    """Approximate eigenvectors of negative eigenvalues of K_ρ, (n_i, up to count).

    Lanczos' method finds eigenvalues at the lower end of a spectrum. There the inverse has the
    negative eigenvalues of K_ρ that are near zero, and K_ρ those that are far below zero.

    Args:
        solve: Applies K_ρ⁻¹ to columns, (n_i, r) → (n_i, r).
        multiply: Applies K_ρ to columns, (n_i, r) → (n_i, r).
        n: Number of dofs n_i.
        count: Number of negative eigenvalues.
    """
    if n <= max(MAX_DOFS_FOR_EIGH, 2 * count + 2):  # Lanczos' method needs more than 2 count rows
        # The inverse has eigenvalues of the same signs. They ascend: the negative ones are first.
        return np.linalg.eigh(symmetric_part(solve(np.eye(n))))[1][:, :count]
    modes = _lowest_eigenvectors(solve, n, count)
    missing = count - modes.shape[1]
    if missing == 0:
        return modes
    return np.hstack([modes, _lowest_eigenvectors(multiply, n, missing)])


def _lowest_eigenvectors(apply: ColumnMap, n: int, count: int) -> Array:
    """Return eigenvectors of the lowest eigenvalues, those that converged, (n_i, up to count)."""
    operator = scipy.sparse.linalg.LinearOperator(
        (n, n), matvec=lambda x: apply(x.reshape(-1, 1)).ravel(), dtype=np.float64
    )
    values, vectors = _lanczos(operator, count)
    return np.asarray(vectors[:, np.argsort(values)])


def _lanczos(operator: scipy.sparse.linalg.LinearOperator, count: int) -> tuple[Array, Array]:
    """Return the lowest eigenvalues that converged, in no order, and eigenvectors in columns."""
    n = operator.shape[0]
    try:
        return scipy.sparse.linalg.eigsh(
            operator,
            k=count,
            which="SA",
            v0=np.random.default_rng(n).standard_normal(n),
            ncv=min(n - 1, max(2 * count + SPARE_LANCZOS_VECTORS, MIN_LANCZOS_VECTORS)),
            tol=LANCZOS_RTOL,
            maxiter=MAX_LANCZOS_RESTARTS,
        )
    except scipy.sparse.linalg.ArpackNoConvergence as partial:
        return partial.eigenvalues, partial.eigenvectors
