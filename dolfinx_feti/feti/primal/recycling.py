# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Recycling: the vectors W by which later solves are deflated.

*Ritz vectors* of a solve are the combinations (W, Z) y with the smallest Ritz values θ,

.. math:: (W, Z)^⊤ A\, (W, Z)\, y = θ\, (W, Z)^⊤ M^{-1} (W, Z)\, y, \qquad θ < θ_0,

in the span of the solve's own W and of its preconditioned residuals Z (Gosselet, Rey, Pebrel, Total
and selective reuse of Krylov subspaces, 2013; docs/theory.md). They cost no product with A or
:math:`M^{-1}`, because the iterations have computed A Z = R H with Z = Π M R. Π removes from Z what
W spans, so that

.. math:: M^{-1} Z = R + (M^{-1} W)\, W^⊤ M^{-1} Z.

In exact arithmetic :math:`Z^⊤ R` would be diagonal. Rounding spoils the orthogonality of the
residuals; therefore Gram matrices are computed in full. If A is not symmetric, the symmetric part
of (W, Z)ᵀ A (W, Z) is taken. The Ritz vectors have :math:`W^⊤ M^{-1} W = I` with the M of their
solve.

*Soft fields* serve a first solve, which has no Ritz vectors, if stress softens the body. They are
the fields of V of smallest energy, corrected by the preconditioner,

.. math:: W = M A V c, \qquad A_0\, c = μ\, V^⊤ V c.
"""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
import scipy.linalg

from dolfinx_feti.feti.coarse.primal_problem import PrimalCoarseProblem
from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.primal.deflation import MIN_INDEPENDENT_ENERGY, DeflationSpace
from dolfinx_feti.feti.primal.krylov.base import KrylovBasis
from dolfinx_feti.feti.solve_info import DeflationVectors
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.generalized_inverse import GeneralizedInverse
from dolfinx_feti.feti.subdomain.orthonormal import diagonalise, symmetric_part
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
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

#: Steps of inverse iteration with A₀ from random columns. The artery path takes 466 iterations with
#: two or three steps, and 477 with one.
INVERSE_STEPS = 2

#: Smallest squared norm, relative to that of its terms, of a combination of soft fields that counts
#: as independent of the others. A rounding margin: the fields agree in five digits at this value.
#: Half and twice of it change no iteration of the artery path.
MIN_INDEPENDENT_SQUARE = 1e-10


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
    W_AW: Array, ZR: Array, WZ: Array, H: Array, max_count: int
) -> tuple[Array, Array]:
    """Compute the combinations of W and Z that are Ritz vectors with the smallest values.

    Args:
        W_AW: Wᵀ A W, (w, w), for w vectors W.
        ZR: Zᵀ R, (k, k + 1).
        WZ: The product of W and Z in the scalar product of M⁻¹, Wᵀ M⁻¹ Z, (w, k).
        H: H of A Z = R H, (k + 1, k).
        max_count: Largest number of combinations.

    Returns:
        Coefficients y of W, (w, c), and of Z, (k, c), with c up to ``max_count``.
    """
    w = len(WZ)
    # (W, Z)ᵀ A (W, Z): Wᵀ A Z = 0 because Π makes Z A-orthogonal to W, and Zᵀ A Z = Zᵀ R H.
    energy = scipy.linalg.block_diag(W_AW, ZR @ H)
    # (W, Z)ᵀ M⁻¹ (W, Z), with Wᵀ M⁻¹ W = I
    gram = np.block([[np.eye(w), WZ], [WZ.T, symmetric_part(ZR[:, :-1]) + WZ.T @ WZ]])
    values, T = diagonalise(gram, MIN_INDEPENDENT_ENERGY)
    T /= np.sqrt(np.abs(values))  # Tᵀ (W, Z)ᵀ M⁻¹ (W, Z) T = I
    θ, Y = np.linalg.eigh(symmetric_part(T.T @ energy @ T))
    count = min(max_count, np.count_nonzero(θ < MAX_RITZ_VALUE))
    y_W, y_Z = np.split(T @ Y[:, :count], [w])
    return y_W, y_Z


def soft_fields(
    coarse: PrimalCoarseProblem,
    copies: Copies,
    S: SchurOperator,
    inverse: GeneralizedInverse,
    *,
    count: int,
) -> DeflationVectors:
    """Compute the fields of V of smallest energy, corrected: W = M A V c. Collective.

    The first solve of the demo's artery at its pressure takes 47 iterations with these fields, and
    77 without.

    Args:
        coarse: V and A₀ of the current matrix.
        copies: Copies of the interface dofs.
        S: Schur complements of the subdomains of this process.
        inverse: K⁺ of the same subdomains. It differs from the K_ρ⁻¹ of M by columns of the coarse
            space, which balancing removes from W.
        count: Largest number of fields.

    Returns:
        W and M⁻¹ W = A V c, (n_Γ, up to ``count``) each, with Wᵀ M⁻¹ W = I.
    """
    δ = copies.delta[:, None]
    comm = copies.comm
    X = _softest_in_coarse_space(coarse, copies, count)  # X = V c
    SX = on_subdomains(lambda: S.multiply_columns(X), comm)
    AX = _by_column(copies.sum, SX, copies.size)  # M⁻¹ W = A V c
    Y = on_subdomains(lambda: inverse.solve_on_interface(δ * AX), comm)
    W = _by_column(copies.average, Y, copies.size)  # W = M A V c
    B = _unit_combinations(total_of(W.T @ (δ * AX), comm), comm)  # Bᵀ (Wᵀ M⁻¹ W) B = I
    return DeflationVectors(np.asfortranarray(W @ B), np.asfortranarray(AX @ B))


def _softest_in_coarse_space(coarse: PrimalCoarseProblem, copies: Copies, count: int) -> Array:
    """Compute fields V c of small energy for their size by inverse iteration. Collective.

    Args:
        coarse: V and A₀ of the current matrix.
        copies: Copies of the interface dofs.
        count: Largest number of fields.

    Returns:
        X = V c with Xᵀ δ X = I, (n_Γ, up to ``count``).
    """
    V = coarse.V
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
