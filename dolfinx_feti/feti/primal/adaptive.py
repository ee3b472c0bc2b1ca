# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Adaptive columns: coarse fields that bound what an average of copies costs.

.. math:: (1 - δ)\, S\, (1 - δ)\, u = χ\, S_ρ\, u, \qquad χ > χ_0

on the interface of a subdomain, (n_i,). The primal preconditioner averages local displacements
:math:`w = S_ρ^{-1} δ\, T r`; to meet its neighbours, a subdomain gives up :math:`(1 - δ)\, w`,
which may cost far more energy than w has, as a change of volume does. With the eigenvectors u as
columns U of the coarse space, :math:`U^⊤ S_ρ\, w = U^⊤ δ\, T r = 0` for every residual, and

.. math:: |(1 - δ)\, w|_S^2 ≤ χ_0\, |w|_{S_ρ}^2

for any κ and any reason for a large χ (Spillane and Rixen 2013, who also weigh with the S of the
neighbours). A block Krylov method from random forces F₀ approximates the largest χ,

.. math:: U_k = S_ρ^{-1} F_k, \qquad F_{k+1} = (1 - δ)\, S\, (1 - δ)\, U_k,

with Rayleigh and Ritz's method on all :math:`U_k`; iterations make up for a column that is missed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.subdomain.blocks import on_subdomains
from dolfinx_feti.feti.subdomain.orthonormal import diagonalising, symmetric_part

__all__ = ["DOFS", "STEPS", "adaptive_columns"]

Array = npt.NDArray[np.float64]
Multiply = Callable[[Array], Array]

#: Steps of the Krylov method: three with a third of the columns find more than one with all.
STEPS = 3

#: Interface dofs of a subdomain that may have all columns; one with a share of these dofs has the
#: square of that share, as the coarse matrix of many subdomains would cost more than it saves.
DOFS = 640

#: Energy below which a combination of new columns of unit energy repeats others: the square root of
#: rounding, which is the error of an energy with a large χ taken out.
REPEATED_ENERGY = 1e-8


def adaptive_columns(
    copies: Copies,
    multiply: Callable[[int, Array], Array],
    solve: Callable[[int, Array], Array],
    *,
    most: int,
    threshold: float,
) -> list[Array]:
    """Return the adaptive columns U, (n_i, up to ``most``), with Uᵀ S_ρ U = I. Collective.

    Args:
        copies: Copies of the interface dofs.
        multiply: Applies :math:`S_i`, ``multiply(i, U)``, (n_i, k) → (n_i, k). Not collective.
        solve: Applies :math:`S_{ρ,i}^{-1}`, ``solve(i, F)``, likewise.
        most: Largest number of columns of a subdomain.
        threshold: χ₀.

    Raises:
        Exception: What the work on a subdomain raises, on all processes.
    """

    def columns(i: int) -> Array:
        rows = copies.blocks[i]
        n, share = rows.stop - rows.start, (1.0 - copies.delta[rows])[:, None]
        wanted = min(most, n, max(STEPS, most * n**2 // DOFS**2))
        if not wanted:
            return np.zeros((n, 0))
        F = np.random.default_rng(n).standard_normal((n, -(-wanted // STEPS)))
        U, S_ρU, CU = _krylov_space(
            F, lambda F: solve(i, F), lambda U: share * multiply(i, share * U)
        )
        return _ritz_vectors(U, S_ρU, CU, threshold)[:, :wanted]

    return on_subdomains(lambda: [columns(i) for i in range(len(copies.blocks))], copies.comm)


def _krylov_space(F: Array, solve: Multiply, cost: Multiply) -> tuple[Array, Array, Array]:
    """Return columns U of a block Krylov space, S_ρ U, and (1 − δ) S (1 − δ) U, (n, k) each.

    They are orthonormal but for rounding, Uᵀ S_ρ U ≈ I: a large χ would leave nothing of others.
    """
    U: Array = np.zeros((len(F), 0))
    S_ρU = CU = U
    for _ in range(STEPS):
        X = solve(F)  # X = S_ρ⁻¹ F
        share = U.T @ F  # Uᵀ S_ρ X
        X, F = X - U @ share, F - S_ρU @ share
        B = _unit_energy(X.T @ F)
        X, F = X @ B, F @ B
        U, S_ρU = np.hstack([U, X]), np.hstack([S_ρU, F])
        F = cost(X)
        CU = np.hstack([CU, F])
    return U, S_ρU, CU


def _ritz_vectors(U: Array, S_ρU: Array, CU: Array, threshold: float) -> Array:
    """Return Ritz vectors of (C, S_ρ) with values above a threshold, the largest first, (n, k)."""
    B = _unit_energy(U.T @ S_ρU)
    χ, Q = np.linalg.eigh(symmetric_part(B.T @ (U.T @ CU) @ B))
    return np.asarray(U @ (B @ Q[:, np.flatnonzero(χ > threshold)[::-1]]))


def _unit_energy(H: Array) -> Array:
    """Return combinations B with Bᵀ H B = I for energies H = Uᵀ S_ρ U, (k, k) → (k, up to k)."""
    θ, B = diagonalising(H, REPEATED_ENERGY)
    return np.asarray(B[:, θ > 0.0] / np.sqrt(θ[θ > 0.0]))
