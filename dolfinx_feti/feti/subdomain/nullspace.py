# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The null space of a block: motions without energy beyond those that are known (docs/theory.md).

.. math:: \|(d^{-1/2} K d^{-1/2} + \hat R \hat R^⊤)\, \hat y\| ≤ 10^{-12}\, \|\hat y\|,
          \qquad y = d^{-1/2}\, \hat y,

with the diagonal d and orthonormal :math:`\hat R` of :math:`d^{-1/2} R`: among all singular vectors
of a small block, else by inverse iteration. The growth of random vectors in a solve tells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.gluing.jump import Dofs
from dolfinx_feti.feti.subdomain.blocks import named, sparse_block
from dolfinx_feti.feti.subdomain.factors.direct import Choice
from dolfinx_feti.feti.subdomain.factors.pivoted import factor_with_pivots
from dolfinx_feti.feti.subdomain.factors.protocol import Factor
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.torn.matrix import Torn

Solve = Callable[[Array], Array]

#: A growth of a scaled random vector that no regular block reaches: its condition would be worse.
SINGULAR_GROWTH = 1e11

#: Random vectors, of which one would nearly always do.
PROBES = 2

#: A singular value of the scaled block below this is zero: rounding in a block of some 1000 dofs.
NULL = 1e-12

#: Blocks of up to so many dofs have all their singular vectors computed.
ALL_VECTORS = 600

#: Share of the stiffness above which the interface feels a motion of the interior without energy.
FELT = 1e-5

#: Inverse iteration: share of the diagonal that is added, vectors at first, and rounds.
SHIFT, VECTORS, ROUNDS = 1e-9, 8, 5


def factor_tells_singular(factor: Factor, d: Array) -> bool:
    """Tell whether a factored block of absolute diagonal d, (n,), is singular up to rounding."""
    if len(d) == 0:
        return False
    return bool(factor.pivots.zero) or not growth(factor, d) <= SINGULAR_GROWTH  # or it is NaN


def growth(factor: Factor, d: Array) -> float:
    """Return how random vectors grow in a solve with a factored block that is scaled by d, (n,)."""
    d = _positive(d)
    X = np.random.default_rng(len(d)).standard_normal((len(d), PROBES))
    root = np.sqrt(d)[:, None]
    return float(np.linalg.norm(root * factor.solve(root * X)) / np.linalg.norm(X))


def null_space(
    multiply: Solve, refactor: Callable[[Array, Array], Factor], d: Array, R: Array | None = None
) -> Array:
    """Find the null vectors of the block K, (n, any number), but for the modes R, (n, k).

    ``multiply`` applies K to columns; ``refactor`` factors K + R̂ R̂ᵀ plus a diagonal, given R̂ and
    that. d is the absolute diagonal of K, (n,). A FactorError tells that the shifted block has no
    factor.
    """
    d = _positive(d)
    n, root = len(d), np.sqrt(d)[:, None]
    known = np.linalg.qr((np.zeros((n, 0)) if R is None else R) / root)[0]

    def scaled(X: Array) -> Array:
        return multiply(X / root) / root + known @ (known.T @ X)  # d^-½ K d^-½ + R̂ R̂ᵀ

    if n <= ALL_VECTORS:
        values, vectors = _singular(scaled(np.eye(n)))
    else:
        factor = refactor(root * known, SHIFT * d)  # the same matrix, unscaled
        values, vectors = _smallest(scaled, lambda X: root * factor.solve(root * X), n)
        factor.destroy()
    return vectors[:, values <= NULL] / root


def interior_kernel(torn: Torn, dofs: Dofs, choice: Choice, factors: Sequence[Factor]) -> Array:
    """Return motions of the interior without energy that the interface does not feel, (n, r).

    With r > 0 the assembled matrix is singular. A FactorError tells of one that it feels.
    """
    diagonal = np.abs(torn.diagonal())
    columns = [np.zeros((torn.n, 0))]
    for i, factor in enumerate(factors):
        I = dofs.interior[i]  # noqa: E741
        if factor_tells_singular(factor, diagonal[I]):
            with named(torn.first + i):
                columns.append(_null_motions(torn, dofs, choice, i, diagonal[I]))
    return np.hstack(columns)


def _null_motions(torn: Torn, dofs: Dofs, choice: Choice, i: int, d: Array) -> Array:
    """Return the null vectors of K_II of subdomain i on the torn dofs, (n, r)."""
    Γ, I = dofs.interface[i], dofs.interior[i]  # noqa: E741
    K_II, K_ΓI = sparse_block(torn.K, I, I), sparse_block(torn.K, Γ, I)

    def refactor(R: Array, shift: Array) -> Factor:
        return factor_with_pivots(torn.K, I, choice, R, 1.0, shift)

    Y = null_space(lambda X: K_II @ X, refactor, d)
    force = K_ΓI @ Y
    felt = FELT * np.abs(K_II.data).max() * np.abs(Y).max(initial=0.0)  # of none, if it only seems
    if np.abs(force).max(initial=0.0) > felt:
        raise FactorError(
            "the matrix of its interior is singular, though the assembled one need not be: take "
            "other subdomains, or the options feti_interior keep and feti_pc_type lumped"
        )
    motions = np.zeros((torn.n, Y.shape[1]))
    motions[I] = Y
    return motions


def _smallest(apply: Solve, invert: Solve, n: int) -> tuple[Array, Array]:
    """Approximate the smallest singular values and their right vectors by inverse iteration.

    The number of vectors grows until they hold more than the null space.
    """
    count = VECTORS
    while True:
        X = np.random.default_rng(n).standard_normal((n, min(n, count)))
        for _ in range(ROUNDS):
            X = np.linalg.qr(invert(X))[0]
        values, Y = _singular(apply(X))
        if count >= n or np.any(values > NULL):
            return values, X @ Y
        count *= 2


def _singular(A: Array) -> tuple[Array, Array]:
    """Return singular values and right singular vectors, in columns."""
    if not np.isfinite(A).all():
        raise FactorError("NaN or Inf where a null space is looked for")
    _, values, Vt = np.linalg.svd(A, full_matrices=False)
    return values, Vt.T


def _positive(d: Array) -> Array:
    """Let the entries of a diagonal that are zero be those of an average dof."""
    return np.where(d > 0.0, d, d.mean() or 1.0)
