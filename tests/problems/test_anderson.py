# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Anderson's acceleration ends on linear maps, also on those that do not contract."""

from __future__ import annotations

import numpy as np
from collective import COMM, agree, small

from dolfinx_feti.problems.multipliers import Anderson


def part(n: int) -> slice:
    """This process's entries of n."""
    return slice(n * COMM.rank // COMM.size, n * (COMM.rank + 1) // COMM.size)


def test_three_rates_are_gone_after_four_updates():
    """As in GMRES."""
    rate, λ = np.array([0.9, 0.7, 0.3, 0.9])[part(4)], np.zeros(4)[part(4)]
    anderson = Anderson(COMM, len(λ))
    for _ in range(4):
        λ = anderson.next(λ, 1.0 - λ + rate * (λ - 1.0))
    small(np.abs(λ - 1.0).max(initial=0.0), 1e-10)


def test_n_unknowns_take_one_more_evaluation():
    """Though the map itself does not contract; ghosts follow and do not count."""
    n, random = 12, np.random.default_rng(1)
    A, b = random.uniform(-0.8, 0.8, (n, n)), random.uniform(-1.0, 1.0, n)
    agree(np.abs(np.linalg.eigvals(A)).max() > 1.2)
    own = np.r_[part(n)]
    order = np.r_[own, np.setdiff1d(np.arange(n), own)]
    anderson, U = Anderson(COMM, len(own)), np.zeros(n)
    for _ in range(n + 1):
        U[order] = anderson.next(U[order], (A @ U + b - U)[order])
    small(np.abs(A @ U + b - U).max(), 1e-8)
