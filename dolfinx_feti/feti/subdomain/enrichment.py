# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Enrichment: elastic modes of a subdomain that join its kernel.

The algebra of ``pseudoinverse`` is exact for any columns R. Two kinds of eigenvectors pay for their
coarse unknown:

- *soft* modes, :math:`K y = μ\, k_Γ\, y` with μ below a threshold, where :math:`k_Γ` is the
  stiffness of the interface dofs. A wall is a shell: its subdomains bend at a small fraction of the
  energy that the same jump costs the neighbour, and a Krylov method pays for each such mode. For a
  compact subdomain of size H with elements of size h, μ is about h/H, and none is soft.
- *buckling* modes, :math:`K_ρ y = μ y` with μ < 0: a compressed subdomain gives way without its
  neighbours, although the assembled matrix is positive definite.

A rough approximation of the eigenvectors is enough.

Buckling modes need another factor, with the sign of every pivot. Soft ones Y, orthonormal and
orthogonal to R, join by an update of the inverse (Sherman, Morrison and Woodbury). With

.. math:: Z = K_ρ^{-1} Y, \quad Z' = K_ρ^{-⊤} Y, \quad C = (ρ^{-1} I + Y^⊤ Z)^{-1}, \quad
          G = Y^⊤ E, \quad G' = Y^⊤ E',

where E' is E of :math:`K^⊤`, the columns (R, Y) have, without another solve or cancellation,

.. math:: (K_ρ + ρ\, Y Y^⊤)^{-1} = (I - E_Y Y^⊤)\, K_ρ^{-1}, \quad
          (E - E_Y G,\; E_Y), \quad E_Y = Z C, \quad
          \begin{pmatrix} D + G'^⊤ C G & -G'^⊤ C \\ -C G & C \end{pmatrix}.

Both are looked for anew in every matrix. Modes that stayed would let the coarse space grow along a
load path: on a clamped tube that passed through folds on its way to 300 mmHg, twice as many modes
saved a tenth of the iterations, and cost a third more time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.sparse.linalg

__all__ = ["Basis", "Enrichment", "append_orthonormal", "buckling_modes", "join", "soft_modes"]

Array = npt.NDArray[np.float64]
Solve = Callable[[Array], Array]

#: Subdomains up to this size have all their eigenvectors computed.
DENSE = 200

#: Powers of the operator and spare columns in a subspace iteration: more of either find more modes,
#: but save no iterations.
POWERS, SPARE = 2, 4


@dataclass(frozen=True, slots=True)
class Enrichment:
    """Which elastic modes of a subdomain join its kernel.

    Attributes:
        buckling: Those with a negative eigenvalue.
        soft: Most soft ones.
        threshold: Share of the interface stiffness below which a mode is soft.
    """

    buckling: bool
    soft: int
    threshold: float


class Basis(NamedTuple):
    """The modes of a subdomain and what follows from them; see ``pseudoinverse``.

    Attributes:
        R: Orthonormal modes, (n, k).
        E: Their stand-in, (n, k).
        E_left: That for the transposed matrix, (n, k).
        D: Their defect, (k, k).
    """

    R: Array
    E: Array
    E_left: Array
    D: Array


def soft_modes(solve: Solve, weight: Array, most: int, threshold: float) -> Array:
    """Find the softest modes of a subdomain.

    Args:
        solve: Applies :math:`K_ρ^{-1}` to columns, (n, r) → (n, r).
        weight: Stiffness of the interface dofs, zero on the others, (n,).
        most: Most modes to return.
        threshold: A mode is soft if its energy is below this share of its interface stiffness.

    Returns:
        Modes with μ below the threshold, (n, up to ``most``). With more than :data:`DENSE` dofs one
        that is close to it may be missed.
    """
    n, root = len(weight), np.sqrt(weight)
    most = min(most, np.count_nonzero(weight) // 10)
    if most == 0:
        return np.zeros((n, 0))

    X = np.random.default_rng(n).standard_normal((n, min(n, most + SPARE)))
    for _ in range(POWERS):
        X = np.eye(n) if n <= DENSE else np.linalg.qr(X)[0]
        Y = solve(root[:, None] * X)
        image = root[:, None] * Y  # k^½ K_ρ⁻¹ k^½ X
        inverse = X.T @ image
        values, vectors = np.linalg.eigh(0.5 * (inverse + inverse.T))  # 1/μ, by Rayleigh and Ritz
        if n <= DENSE:
            break
        X = image
    soft = np.flatnonzero(values * threshold > 1.0)[-most:]
    return np.asarray(Y @ vectors[:, soft])  # y = K_ρ⁻¹ k^½ X z


def buckling_modes(solve: Solve, multiply: Solve, n: int, count: int) -> Array:
    """Approximate the eigenvectors of the negative eigenvalues of :math:`K_ρ`.

    Those near zero are found at the lower end of the inverse. One far below zero is the last of
    them there, hidden next to zero, but stands alone at the lower end of the matrix.

    Args:
        solve: Applies :math:`K_ρ^{-1}` to columns, (n, r) → (n, r).
        multiply: Applies :math:`K_ρ`, (n, r) → (n, r).
        n: Size of the subdomain.
        count: Number of its negative eigenvalues.

    Returns:
        Eigenvectors, (n, up to ``count``).
    """
    if n <= max(DENSE, 2 * count + 2):
        inverse = solve(np.eye(n))
        return np.linalg.eigh(0.5 * (inverse + inverse.T))[1][:, :count]
    modes = _lower_end(solve, n, count)
    missing = count - modes.shape[1]
    return np.hstack([modes, _lower_end(multiply, n, missing)]) if missing else modes


def _lower_end(apply: Solve, n: int, count: int) -> Array:
    """Return the eigenvectors of the least eigenvalues that were found, (n, up to ``count``)."""
    return _lanczos(apply, n, count, "SA", krylov=max(2 * count + 8, 20), restarts=50)[1]


def join(basis: Basis, Y: Array, Z: Array, Z_left: Array, rho: float) -> Basis:
    """Let soft modes join R.

    Args:
        basis: R, E, E_left and D.
        Y: Orthonormal columns, orthogonal to R, (n, k).
        Z: :math:`K_ρ^{-1} Y`, (n, k).
        Z_left: :math:`K_ρ^{-⊤} Y`, (n, k).
        rho: The stiffness ρ.
    """
    R, E, E_left, D = basis
    C = np.linalg.inv(np.eye(Y.shape[1]) / rho + Y.T @ Z)
    G, G_left = Y.T @ E, Y.T @ E_left
    E_Y, E_Y_left = Z @ C, Z_left @ C.T
    return Basis(
        _side_by_side(R, Y),
        _side_by_side(E - E_Y @ G, E_Y),
        _side_by_side(E_left - E_Y_left @ G_left, E_Y_left),
        np.block([[D + G_left.T @ C @ G, -G_left.T @ C], [-C @ G, C]]),
    )


def _side_by_side(X: Array, Y: Array) -> Array:
    """Return (X, Y) column by column, so that slices of columns are read fast."""
    return np.asfortranarray(np.hstack([X, Y]))


def append_orthonormal(R: Array, Y: Array) -> Array:
    """Append the columns Y to the orthonormal R, orthonormalised; near repetitions are dropped."""
    size = np.linalg.norm(Y, axis=0)
    Y = Y / np.where(size > 0.0, size, 1.0)
    for _ in range(2):
        Y = Y - R @ (R.T @ Y)
    U, sigma, _ = np.linalg.svd(Y, full_matrices=False)
    return np.hstack([R, U[:, sigma > 1e-6]])


def _lanczos(
    apply: Solve, n: int, count: int, end: str, *, krylov: int, restarts: int
) -> tuple[Array, Array]:
    """Return eigenvalues, ascending, and eigenvectors at one end of the spectrum, roughly."""
    operator = scipy.sparse.linalg.LinearOperator(
        (n, n), matvec=lambda x: apply(x.reshape(-1, 1)).ravel(), dtype=np.float64
    )
    start = np.random.default_rng(n).standard_normal(n)
    try:
        values, vectors = scipy.sparse.linalg.eigsh(
            operator, k=count, which=end, v0=start, ncv=min(n - 1, krylov), tol=1e-2,
            maxiter=restarts,
        )  # fmt: skip
    except scipy.sparse.linalg.ArpackNoConvergence as rough:
        values, vectors = rough.eigenvalues, rough.eigenvectors
    order = np.argsort(values)
    return values[order], vectors[:, order]
