# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The null vectors of a matrix other than given modes R, to a tolerance ε (docs/theory.md).

.. math:: \|(\tilde K + \tilde R \tilde R^⊤)\, \tilde y\| ≤ ε\, \|\tilde y\|, \qquad
          \tilde K = d^{-1/2} K d^{-1/2}, \quad y = d^{-1/2}\, \tilde y

with the absolute diagonal d, and orthonormal columns :math:`\tilde R` of :math:`d^{1/2} R`.
``kernel_detection`` describes how they are used, and defines the tolerances. K is any matrix of one
subdomain, (n_i, n_i). For a small matrix all singular vectors are computed; for a large one the
smallest are approximated by inverse iteration.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.factors.protocol import Factor
from dolfinx_feti.feti.subdomain.kernel_detection import EXACTLY_NULL, NullTolerances
from dolfinx_feti.runtime.arrays import Array, ColumnMap

#: Random vectors whose growth is measured. Rounding turns a zero pivot into about 1e-15 of the
#: diagonal. The growth is then below 1e11 only if less than 1e-4 of each vector is along the null
#: vector. With 1000 dofs the probability of that is 0.3 % for one vector, and 1e-5 for two.
PROBES = 2

#: Largest block whose singular vectors are all computed [dofs]. With 600 dofs that takes about one
#: second, for singular blocks only. Tests check that both methods find the same null vectors.
MAX_DOFS_FOR_SVD = 600

#: Share of the diagonal that inverse iteration adds to the block, because a singular block has no
#: factor. It is above the singular values of exact null vectors, 1e-12 (``EXACTLY_NULL``), and
#: below those of most soft modes. In a scaled matrix, singular values up to 1e-8 count as null
#: (``NEARLY_NULL``). Lattices of 1000 to 4000 dofs with 6, 12 and 24 null vectors have the same
#: ones with 1e-11 to 1e-7.
SHIFT = 1e-9

#: Vectors with which inverse iteration begins. Their number is doubled until they contain a mode
#: that is clearly not null (SEPARATION). A single cell of P2–P0 has three null vectors. The same
#: lattices have the same null vectors with 4, 8 and 16, in times that differ by less than 30 %.
FIRST_VECTORS = 8

#: Ratio of the largest singular value among the vectors to SHIFT, and to the bound of null vectors,
#: from which the null space is complete. Vectors whose singular values are all below SHIFT are
#: mixtures of null vectors and soft modes, which STEPS do not separate: with eight vectors, 3 of 8
#: null vectors were missed where springs of 1e-10 to 1e-6 times the stiffness join two lattices.
#: With ten, a step multiplies what is not among the vectors by 1/11 or less.
SEPARATION = 10.0

#: Steps of inverse iteration. Each multiplies the share of a vector with the singular value σ by
#: SHIFT / (SHIFT + σ): five leave 1e-15 of a mode with σ = 1e-6. The same lattices have the same
#: null vectors with two to ten steps, and none with one, which leaves 1e-8 of stiff modes.
STEPS = 5


def is_numerically_singular(
    factor: Factor, d: Array, tolerances: NullTolerances = EXACTLY_NULL
) -> bool:
    """Return True if a solve makes random vectors grow by more than a bound, or a pivot is zero.

    Args:
        factor: Factor of a block.
        d: Absolute diagonal of the block, (n_i,).
        tolerances: The bound.
    """
    if len(d) == 0:
        return False
    if factor.inertia.zero_pivots:
        return True
    return not growth(factor, d) <= tolerances.max_growth  # true for NaN


def growth(factor: Factor, d: Array) -> float:
    """Return the growth of random vectors in a solve with an equilibrated block, ‖K̃⁻¹ x‖/‖x‖.

    It is the same for a block K and a scaled one, s⁻¹ K s⁻¹: their equilibrated blocks are equal.

    Args:
        factor: Factor of the block K, not equilibrated.
        d: Absolute diagonal of the block, (n_i,).
    """
    d = positive_diagonal(d)
    # The same random vectors in every run: the decision is repeatable.
    X = np.random.default_rng(len(d)).standard_normal((len(d), PROBES))
    root = np.sqrt(d)[:, None]
    return float(np.linalg.norm(root * factor.solve(root * X)) / np.linalg.norm(X))


def null_vectors(
    multiply: ColumnMap,
    factor_shifted: Callable[[Array, Array], Factor],
    d: Array,
    R: Array | None = None,
    tolerances: NullTolerances = EXACTLY_NULL,
) -> Array:
    """Compute the null vectors of a block K other than given modes.

    Args:
        multiply: Returns K X, (n_i, r) → (n_i, r).
        factor_shifted: Returns a factor of K + B Bᵀ + diag(σ), given B, (n_i, k), and σ, (n_i,);
            this function destroys it.
        d: Absolute diagonal of K, (n_i,).
        R: The given modes, (n_i, k); None if there are none.
        tolerances: Largest singular value of a null vector, of the equilibrated block.

    Returns:
        The null vectors d^−½ ỹ with orthonormal ỹ, (n_i, r).

    Raises:
        FactorError: The shifted block has no factor, or K has NaN or Inf.
    """
    d = positive_diagonal(d)
    n = len(d)
    root = np.sqrt(d)[:, None]
    R_tilde = np.linalg.qr((np.zeros((n, 0)) if R is None else R) * root)[0]

    def multiply_equilibrated(X: Array) -> Array:
        return multiply(X / root) / root + R_tilde @ (R_tilde.T @ X)  # (K̃ + R̃ R̃ᵀ) X

    if n <= MAX_DOFS_FOR_SVD:
        values, vectors = _singular_vectors(multiply_equilibrated(np.eye(n)))
    else:
        factor = factor_shifted(root * R_tilde, SHIFT * d)  # d^½ (K̃ + R̃ R̃ᵀ + SHIFT I) d^½

        def solve_equilibrated(X: Array) -> Array:
            return root * factor.solve(root * X)  # (K̃ + R̃ R̃ᵀ + SHIFT I)⁻¹ X

        try:
            values, vectors = _smallest_singular_vectors(
                multiply_equilibrated, solve_equilibrated, n, tolerances.max_singular_value
            )
        finally:
            factor.destroy()
    return vectors[:, values <= tolerances.max_singular_value] / root


def _smallest_singular_vectors(
    multiply: ColumnMap, solve: ColumnMap, n: int, max_null_value: float
) -> tuple[Array, Array]:
    """Approximate the smallest singular values and right singular vectors by inverse iteration.

    The iteration is repeated with twice as many vectors until one of the values is that of a mode
    which is clearly not null. Then the null space is complete.

    Args:
        multiply: Applies the matrix A to columns, (n_i, r) → (n_i, r).
        solve: Applies (A + SHIFT I)⁻¹ to columns.
        n: Number of rows n_i of A.
        max_null_value: Largest singular value of a null vector.

    Returns:
        Values, (r,), and vectors, (n_i, r).
    """
    count = FIRST_VECTORS
    clearly_not_null = SEPARATION * max(SHIFT, max_null_value)
    while True:
        X = np.random.default_rng(n).standard_normal((n, min(n, count)))
        for _ in range(STEPS):
            X = np.linalg.qr(solve(X))[0]
        values, Y = _singular_vectors(multiply(X))
        if count >= n or np.any(values > clearly_not_null):
            return values, X @ Y
        count *= 2


def _singular_vectors(A: Array) -> tuple[Array, Array]:
    """Return singular values, and right singular vectors in columns, of (n_i, r) → (r,), (r, r).

    Raises:
        FactorError: A has NaN or Inf.
    """
    if not np.isfinite(A).all():
        raise FactorError(
            "its null vectors cannot be computed: products with its matrix are NaN or Inf"
        )
    _, values, Vt = np.linalg.svd(A, full_matrices=False)
    return values, Vt.T


def positive_diagonal(d: Array) -> Array:
    """Return an absolute diagonal, (n_i,), with the mean of all entries in place of zeros.

    If all entries are zero, the result is one everywhere.
    """
    if not d.any():
        return np.ones_like(d)
    return np.where(d > 0.0, d, d.mean())
