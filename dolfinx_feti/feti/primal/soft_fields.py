# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Soft fields, by which a solve without Ritz vectors is deflated if stress softens the body.

The first solve of Newton's method, and each solve outside of it, has no Ritz vectors of an earlier
one. Its vectors W are the fields of V of smallest
energy, corrected by the preconditioner,

.. math:: W = M A V c, \qquad A_0\, c = μ\, V^⊤ V c,

(docs/theory.md). They are computed by inverse iteration with A₀.
"""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np

from dolfinx_feti.feti.coarse.primal_problem import PrimalCoarseProblem
from dolfinx_feti.feti.solve_info import DeflationVectors
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.generalized_inverse import GeneralizedInverse
from dolfinx_feti.feti.subdomain.orthonormal import diagonalise
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all, total_of

#: Steps of inverse iteration with A₀ from random columns. The artery path takes 466 iterations with
#: two or three steps, and 477 with one.
INVERSE_STEPS = 2

#: Smallest squared norm, relative to that of its terms, of a combination of soft fields that counts
#: as independent of the others. A rounding margin: the fields agree in five digits at this value.
#: Half and twice of it change no iteration of the artery path.
MIN_INDEPENDENT_SQUARE = 1e-10


def soft_fields(
    coarse: PrimalCoarseProblem, S: SchurOperator, inverse: GeneralizedInverse, *, count: int
) -> DeflationVectors:
    """Compute the fields of V of smallest energy, corrected: W = M A V c. Collective.

    The first solve of the demo's artery at its pressure takes 47 iterations with these fields, and
    77 without.

    Args:
        coarse: V and A₀ of the current matrix.
        S: Schur complements of the subdomains of this process.
        inverse: K⁺ of the same subdomains. It differs from the K_ρ⁻¹ of M by columns of the coarse
            space, which balancing removes from W.
        count: Largest number of fields.

    Returns:
        W and M⁻¹ W = A V c, (n_Γ, up to ``count``) each, with Wᵀ M⁻¹ W = I.
    """
    copies = coarse.copies
    δ = copies.delta[:, None]
    comm = copies.comm
    X = _softest_in_coarse_space(coarse, count)  # X = V c
    SX = on_subdomains(lambda: S.multiply_columns(X), comm)
    AX = _by_column(copies.sum, SX, copies.size)  # M⁻¹ W = A V c
    Y = on_subdomains(lambda: inverse.solve_on_interface(δ * AX), comm)
    W = _by_column(copies.average, Y, copies.size)  # W = M A V c
    B = _unit_combinations(total_of(W.T @ (δ * AX), comm), comm)  # Bᵀ (Wᵀ M⁻¹ W) B = I
    return DeflationVectors(np.asfortranarray(W @ B), np.asfortranarray(AX @ B))


def _softest_in_coarse_space(coarse: PrimalCoarseProblem, count: int) -> Array:
    """Compute fields V c of small energy for their size by inverse iteration. Collective.

    Args:
        coarse: V and A₀ of the current matrix.
        count: Largest number of fields.

    Returns:
        X = V c with Xᵀ δ X = I, (n_Γ, up to ``count``).
    """
    V = coarse.V
    copies = coarse.copies
    δ = copies.delta[:, None]
    comm = copies.comm

    def solve(e: Array) -> Array:
        """Return V A₀⁻¹ e, orthonormalised, (n_c, k) → (n_Γ, k)."""
        c = _by_column(coarse.solve, e, V.n_c)  # c = A₀⁻¹ e
        X = _by_column(V.prolong, c, copies.size)  # V c
        gram = total_of(X.T @ (δ * X), comm)
        return X @ _unit_combinations(gram, comm)

    generator = np.random.default_rng(comm.rank)  # other numbers on each process, same in each run
    e = generator.standard_normal((V.n_c, min(count, V.N_c)))
    X = solve(e)
    for _ in range(INVERSE_STEPS - 1):
        X = solve(_by_column(V.restrict, X, V.n_c))  # e ← Vᵀ V c
    return X


def _unit_combinations(H: Array, comm: MPI.Comm) -> Array:
    """Return independent combinations B with Bᵀ H B = I, (k, k) → (k, up to k). Collective.

    Args:
        H: Gram matrix, positive semi-definite up to rounding. Its negative eigenvalues are rounding
            errors and left out.
        comm: Communicator.
    """
    θ, B = on_all(lambda: diagonalise(H, MIN_INDEPENDENT_SQUARE), comm)
    is_positive = θ > 0.0
    return np.asarray(B[:, is_positive] / np.sqrt(θ[is_positive]))


def _by_column(apply: Callable[[Array], Array], X: Array, n: int) -> Array:
    """Apply a collective function to each column. Collective.

    Args:
        apply: Function of a vector that returns one of length n.
        X: Columns, (any length, k).
        n: Length of a result.

    Returns:
        Results as columns, (n, k).
    """
    return np.array([apply(x) for x in X.T]).reshape(X.shape[1], n).T
