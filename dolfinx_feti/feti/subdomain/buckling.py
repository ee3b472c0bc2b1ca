# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Buckling modes of a subdomain, K_ρ y = μ y with μ < 0, which join its kernel (docs/theory.md).

Rough eigenvectors are enough: those near zero are at the lower end of the spectrum of the inverse,
one far below zero is at the lower end of the matrix.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse.linalg

from dolfinx_feti.feti.subdomain.orthonormal import symmetric_part
from dolfinx_feti.feti.subdomain.soft import ALL_MODES
from dolfinx_feti.runtime.arrays import Array

__all__ = ["buckling_modes"]

Solve = Callable[[Array], Array]

#: Lanczos' method: relative error of an eigenvalue, and restarts.
ACCURACY, RESTARTS = 1e-2, 50


def buckling_modes(solve: Solve, multiply: Solve, n: int, count: int) -> Array:
    """Approximate eigenvectors of ``count`` negative eigenvalues of :math:`K_ρ`, (n, up to count).

    It is applied and inverted for columns, (n, r) → (n, r).
    """
    if n <= max(ALL_MODES, 2 * count + 2):
        return np.linalg.eigh(symmetric_part(solve(np.eye(n))))[1][:, :count]
    modes = _lower_end(solve, n, count)
    missing = count - modes.shape[1]
    return np.hstack([modes, _lower_end(multiply, n, missing)]) if missing else modes


def _lower_end(apply: Solve, n: int, count: int) -> Array:
    """Return the eigenvectors of the least eigenvalues, as many as converged, (n, up to count)."""
    operator = scipy.sparse.linalg.LinearOperator(
        (n, n), matvec=lambda x: apply(x.reshape(-1, 1)).ravel(), dtype=np.float64
    )
    start = np.random.default_rng(n).standard_normal(n)
    krylov = min(n - 1, max(2 * count + 8, 20))
    try:
        values, vectors = scipy.sparse.linalg.eigsh(
            operator, k=count, which="SA", v0=start, ncv=krylov, tol=ACCURACY, maxiter=RESTARTS
        )
    except scipy.sparse.linalg.ArpackNoConvergence as rough:
        values, vectors = rough.eigenvalues, rough.eigenvectors
    return np.asarray(vectors[:, np.argsort(values)])
