# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Adaptive columns: coarse fields that bound what an average of copies costs.

The primal preconditioner averages local displacements :math:`w = S_ρ^{-1} δ\, T r`. To meet its
neighbours, a subdomain gives up the share :math:`(1 - δ)\, w` of its own, which may cost far more
energy than w holds: with a condensed pressure, a change of volume pays for it with κ; and so does
whatever is stiff where w is soft. The fields for which that is so are the eigenvectors u on the
interface of

.. math:: (1 - δ)\, S\, (1 - δ)\, u = χ\, S_ρ\, u

with :math:`χ > χ_0`. As columns U of the coarse space (``averaged``) they leave the others: every
residual is orthogonal to :math:`T^⊤ δ\, U`, so that
:math:`U^⊤ S_ρ\, w = U^⊤ δ\, T r = 0`, and then

.. math:: |(1 - δ)\, w|_S^2 ≤ χ_0\, |w|_{S_ρ}^2

whatever κ is, and whatever the reason for a large χ. (Spillane and Rixen 2013, who also weigh with
the S of the neighbours.)

The largest eigenvalues are found by a block Krylov method from random forces F₀, in
:data:`STEPS` steps,

.. math:: U_k = S_ρ^{-1} F_k, \qquad F_{k+1} = (1 - δ)\, S\, (1 - δ)\, U_k,

and Rayleigh and Ritz's method on all :math:`U_k`, whose products with both matrices are there by
then. A column that is missed is one that iterations make up for.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.copies import Copies

__all__ = ["DOFS", "STEPS", "adaptive_columns"]

Array = npt.NDArray[np.float64]

#: Steps of the Krylov method: three with a third of the columns find more than one with all.
STEPS = 3

#: Interface dofs of a subdomain that may have all columns; one with a share of these dofs has the
#: square of that share, as the coarse matrix of many subdomains would cost more than it saves.
DOFS = 640

#: Energy below which a combination of columns of unit energy is dropped.
DEPENDENT = 1e-8


def adaptive_columns(
    copies: Copies,
    multiply: Callable[[int, Array], Array],
    solve: Callable[[int, Array], Array],
    *,
    most: int,
    threshold: float,
) -> list[Array]:
    """Return the adaptive columns of each subdomain, (n_i, up to ``most``), with Uᵀ S_ρ U = I.

    Args:
        copies: Copies of the interface dofs.
        multiply: Applies :math:`S_i`, ``multiply(i, U)``, (n_i, k) → (n_i, k).
        solve: Applies :math:`S_{ρ,i}^{-1}`, ``solve(i, F)``, likewise.
        most: Largest number of columns of a subdomain.
        threshold: χ₀.
    """
    found = []
    for i, rows in enumerate(copies.blocks):
        n = rows.stop - rows.start
        wanted = min(most, n, max(STEPS, most * n**2 // DOFS**2))
        if not wanted:
            found.append(np.zeros((n, 0)))
            continue
        given_up = (1.0 - copies.delta[rows])[:, None]
        cost = partial(_cost, partial(multiply, i), given_up)
        F = np.random.default_rng(n).standard_normal((n, -(-wanted // STEPS)))
        space = _krylov_space(F, partial(solve, i), cost)
        found.append(_ritz_vectors(*space, threshold)[:, :wanted])
    return found


def _cost(multiply: Callable[[Array], Array], given_up: Array, U: Array) -> Array:
    """Return (1 − δ) S (1 − δ) U, (n, k)."""
    return given_up * multiply(given_up * U)


def _krylov_space(
    F: Array, solve: Callable[[Array], Array], cost: Callable[[Array], Array]
) -> tuple[Array, Array, Array]:
    """Return columns U of a block Krylov space, S_ρ U, and (1 − δ) S (1 − δ) U, (n, k) each.

    They are orthonormal but for rounding, Uᵀ S_ρ U ≈ I: a large χ would leave nothing of others.
    """
    none: Array = np.zeros((len(F), 0))
    U, S_ρU, CU = none, none, none
    for _ in range(STEPS):
        X = solve(F)  # X = S_ρ⁻¹ F
        share = U.T @ F  # Uᵀ S_ρ X
        X, F = X - U @ share, F - S_ρU @ share
        B = _orthonormal(X.T @ F)
        X, F = X @ B, F @ B
        U, S_ρU = np.hstack([U, X]), np.hstack([S_ρU, F])
        F = cost(X)
        CU = np.hstack([CU, F])
    return U, S_ρU, CU


def _orthonormal(energy: Array) -> Array:
    """Return combinations B with Bᵀ (Uᵀ S_ρ U) B = I, without those that depend, (k, up to k).

    Args:
        energy: Uᵀ S_ρ U of columns U, (k, k).
    """
    size = np.sqrt(np.abs(energy.diagonal()))
    scale = np.divide(1.0, size, where=size > 0.0, out=np.zeros_like(size))
    values, Q = np.linalg.eigh(_symmetric(scale[:, None] * energy * scale))
    kept = values > DEPENDENT
    return np.asarray(scale[:, None] * Q[:, kept] / np.sqrt(values[kept]))


def _ritz_vectors(U: Array, S_ρU: Array, CU: Array, threshold: float) -> Array:
    """Return Ritz vectors of (C, S_ρ) with values above a threshold, the largest first, (n, k)."""
    B = _orthonormal(U.T @ S_ρU)
    χ, Q = np.linalg.eigh(_symmetric(B.T @ (U.T @ CU) @ B))
    return np.asarray(U @ (B @ Q[:, np.flatnonzero(χ > threshold)[::-1]]))


def _symmetric(A: Array) -> Array:
    return np.asarray(0.5 * (A + A.T))
