# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The null space of a block: motions without energy beyond those that are known.

A few P2–P0 cells move without energy in more than rigid ways (the deviator of the strain vanishes
for conformal maps, and the change of volume is only felt in the mean of a cell), and so do parts
that hang together in a point or along an edge. A factor of such a block is worthless, and does not
say so: rounding turns the pivots that should be zero into tiny ones. What tells is the growth of
random vectors. The null vectors are singular vectors of the block scaled by its diagonal d,

.. math:: \|(d^{-1/2} K d^{-1/2} + \hat R \hat R^⊤)\, \hat y\| ≤ 10^{-12}\, \|\hat y\|,
          \qquad y = d^{-1/2}\, \hat y,

with an orthonormal basis :math:`\hat R` of :math:`d^{-1/2} R` for the known modes R; found among
all if the block is small, else among a few from inverse iteration with that matrix and
:math:`10^{-9} I`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.sparse.factors import Factors

__all__ = ["factor_tells_singular", "null_space"]

Array = npt.NDArray[np.float64]
Solve = Callable[[Array], Array]

#: A growth of a scaled random vector that no regular block reaches.
GROWTH = 1e11

#: Random vectors, of which one would nearly always do.
LOOK = 2

#: A singular value of the scaled block below this is zero.
ZERO = 1e-12

#: Blocks up to this size have all their singular vectors computed.
DENSE = 600

#: Inverse iteration: share of the diagonal that is added, vectors at first, and rounds.
SHIFT, VECTORS, ROUNDS = 1e-9, 8, 5


def factor_tells_singular(factors: Factors, i: int, d: Array) -> bool:
    """Tell whether a factored block is singular up to rounding.

    Args:
        factors: The factors.
        i: Number of the block.
        d: Its absolute diagonal, (n,).
    """
    if len(d) == 0:
        return False
    d = _positive(d)
    if factors.pivots(i).zero:
        return True
    X = np.random.default_rng(len(d)).standard_normal((len(d), LOOK))
    root = np.sqrt(d)[:, None]
    grown = np.linalg.norm(root * factors.solve_many(i, root * X)) / np.linalg.norm(X)
    return not grown <= GROWTH  # a NaN is no sign of health


def null_space(
    factors: Factors, i: int, multiply: Solve, d: Array, R: Array | None = None, rho: float = 1.0
) -> Array:
    """Find the null space of the block K, but for the modes R.

    Args:
        factors: The factors of the block; of a shifted one afterwards, if it is large and there
            is a null space.
        i: Number of the block.
        multiply: Applies K to columns, (n, r) → (n, r).
        d: Its absolute diagonal, (n,).
        R: Columns R, (n, k); none if not given.
        rho: The stiffness ρ that the factors have, for the time afterwards.

    Returns:
        Null vectors, (n, any number).

    Raises:
        FactorError: Not even the shifted block can be factored. Not collective.
    """
    d = _positive(d)
    n, root = len(d), np.sqrt(d)[:, None]
    R = np.zeros((n, 0)) if R is None else R

    known = np.linalg.qr(R / root)[0]

    def scaled(X: Array) -> Array:
        return multiply(X / root) / root + known @ (known.T @ X)  # d^-½ K d^-½ + R̂ R̂ᵀ

    if n <= DENSE:
        values, vectors = _singular(scaled(np.eye(n)))
    else:
        factors.update_block(i, root * known, shift=SHIFT * d)  # the same matrix, unscaled
        values, vectors = _smallest(scaled, lambda X: root * factors.solve_many(i, root * X), n)
    zero = values <= ZERO
    if n > DENSE and not np.any(zero):
        factors.update_block(i, R, rho)
    return vectors[:, zero] / root


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
        if count >= n or np.any(values > ZERO):
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
