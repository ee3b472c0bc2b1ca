# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Adaptive columns: coarse fields that bound what an average of copies costs (docs/theory.md).

.. math:: δ\, T_i A\, T_i^⊤ δ\, u = χ\, S_ρ\, u, \quad χ > χ_0, \qquad
          U_k = S_ρ^{-1} F_k, \quad F_{k+1} = P\, δ\, T_i A\, T_i^⊤ δ\, U_k

on the interface of a subdomain, (n_i,) (Spillane and Rixen 2013), by a block Krylov method from
random forces F₀, which goes on as long as most of what it finds is wanted; P leaves out what the
columns E that V has anyway see, :math:`E^⊤ F = 0`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.subdomain.blocks import on_subdomains
from dolfinx_feti.runtime.arrays import Array

Multiply = Callable[[Array], Array]

#: Steps of the Krylov method, at least and at most; each finds as many columns.
STEPS = 3, 9

#: Interface dofs of a subdomain that may have all columns; one with a share of these dofs has that
#: share of them, as the coarse matrix of many subdomains would cost more than it saves.
DOFS = 640

#: Energy below which a combination of new columns of unit energy repeats others: the square root of
#: rounding, which is the error of an energy with a large χ taken out.
REPEATED_ENERGY = 1e-8

#: Share of a force below which nothing of it is left, and a norm that no force has.
NO_FORCE, TINY = 1e-8, np.finfo(float).tiny


def adaptive_columns(
    copies: Copies,
    assembled: Callable[[int], Multiply],
    solver: Callable[[int], Multiply],
    E: Sequence[Array],
    *,
    most: int,
    threshold: float,
) -> list[Array]:
    """Return the adaptive columns U, (n_i, up to ``most``), with Uᵀ S_ρ U = I. Collective.

    ``assembled`` returns what applies :math:`T_i A T_i^⊤` to columns, (n_i, k) → (n_i, k), until it
    is asked for another subdomain, ``solver`` what applies :math:`S_{ρ,i}^{-1}`. E are the columns
    that the coarse space has anyway, (n_i, k_i), and the threshold is χ₀. Errors are those of all
    processes.
    """
    least, last = STEPS

    def columns(i: int) -> Array:
        rows = copies.blocks[i]
        n, δ = rows.stop - rows.start, copies.delta[rows][:, None]
        wanted = min(most, n, max(last, most * n // DOFS))
        if not wanted:
            return np.zeros((n, 0))
        A, Q = assembled(i), np.linalg.qr(E[i])[0]
        F = np.random.default_rng(n).standard_normal((n, -(-wanted // last)))
        space = _krylov_spaces(F, solver(i), lambda U: δ * A(δ * U), Q, last)
        for krylov in itertools.islice(space, least - 1, last):
            χ = np.linalg.eigvalsh(krylov[2], UPLO="U")
            if 2 * np.count_nonzero(χ > threshold) <= len(χ):
                break
        return _ritz_vectors(*krylov, threshold)[:, :wanted]

    return on_subdomains(lambda: [columns(i) for i in range(len(copies.blocks))], copies.comm)


def _krylov_spaces(
    F: Array, solve: Multiply, cost: Multiply, Q: Array, steps: int
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield growing spaces, whose forces are orthogonal to the orthonormal Q.

    Each is U, (n, k), with the upper triangles of Uᵀ S_ρ U ≈ I and Uᵀ δ T_i A T_iᵀ δ U, (k, k).
    The columns are orthonormal but for rounding: a large χ would leave nothing of others.
    """
    U, S_ρU = np.empty((2, steps * F.shape[1], len(F))).transpose(0, 2, 1)
    H, C = np.empty((2, U.shape[1], U.shape[1]))
    k = 0
    for _ in range(steps):
        F = F / np.maximum(np.linalg.norm(F, axis=0), TINY)
        F = F - Q @ (Q.T @ F)
        F = F[:, np.linalg.norm(F, axis=0) > NO_FORCE]
        X = solve(F)  # X = S_ρ⁻¹ F
        energy = np.sqrt(np.maximum(np.sum(F * X, axis=0), TINY))
        X, F = X / energy, F / energy
        share = U[:, :k].T @ F  # Uᵀ S_ρ X
        X, F = X - U[:, :k] @ share, F - S_ρU[:, :k] @ share
        B = _unit_energy(X.T @ F)
        new = slice(k, k + B.shape[1])
        k = new.stop
        U[:, new], S_ρU[:, new] = X @ B, F @ B
        H[:k, new] = U[:, :k].T @ S_ρU[:, new]
        F = cost(U[:, new])
        C[:k, new] = U[:, :k].T @ F
        yield U[:, :k], H[:k, :k], C[:k, :k]


def _ritz_vectors(U: Array, H: Array, C: Array, threshold: float) -> Array:
    """Return the Ritz vectors with values above a threshold, the largest first, (n, k)."""
    B = _unit_energy(H)
    χ, Q = np.linalg.eigh(B.T @ (np.triu(C) + np.triu(C, 1).T) @ B)
    return np.asarray(U @ (B @ Q[:, np.flatnonzero(χ > threshold)[::-1]]))


def _unit_energy(H: Array) -> Array:
    """Return combinations B with Bᵀ H B = I for energies H = Uᵀ S_ρ U, (k, k) → (k, up to k)."""
    θ, B = np.linalg.eigh(H, UPLO="U")
    return np.asarray(B[:, θ > REPEATED_ENERGY] / np.sqrt(θ[θ > REPEATED_ENERGY]))
