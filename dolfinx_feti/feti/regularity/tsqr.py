# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""QR factors of a few columns whose rows are distributed over all processes.

.. math:: X = \begin{pmatrix} Q_1 R_1 \\ Q_2 R_2 \\ ⋮ \end{pmatrix}, \qquad
          \begin{pmatrix} R_1 \\ R_2 \\ ⋮ \end{pmatrix} = Q R

(TSQR, Demmel et al. 2012). Each process factors its rows; then every process factors the stacked
factors, (processes · k, k). R alone yields norms and products of combinations of columns,
:math:`\|X c\| = \|R c\|`.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from dolfinx_feti.runtime.arrays import Array, Integers
from dolfinx_feti.runtime.collective import on_all


def r_factors(X: Array, group: Integers, count: int, comm: MPI.Comm) -> Array:
    """Return the R of each group of rows of X, the same on all processes. Collective.

    Args:
        X: Rows of this process, (n, k).
        group: Group of each row, (n,); rows of other groups than 0 … count − 1 are left out.
        count: Number of groups.
        comm: Processes that have rows.

    Returns:
        Upper triangles, (count, k, k).
    """
    k = X.shape[1]
    if k == 0:
        return np.zeros((count, 0, 0))
    order = np.argsort(group, kind="stable")
    ends = np.searchsorted(group[order], np.arange(count + 1))

    def of_this_process() -> Array:
        R = np.zeros((count, k, k))
        for g in np.flatnonzero(np.diff(ends)):
            R[g] = _r_factor(X[order[ends[g] : ends[g + 1]]])
        return R

    gathered = comm.allgather(on_all(of_this_process, comm))
    stacked = np.stack(gathered, axis=1)  # (count, processes, k, k)
    factors = on_all(lambda: [_r_factor(rows.reshape(-1, k)) for rows in stacked], comm)
    return np.array(factors).reshape(count, k, k)


def r_factor(X: Array, comm: MPI.Comm) -> Array:
    """Return the R of X, (n, k) → (k, k), the same on all processes. Collective."""
    return np.asarray(r_factors(X, np.zeros(len(X), dtype=np.int64), 1, comm)[0])


def orthonormal_columns(X: Array, comm: MPI.Comm) -> Array:
    """Return Q of X = Q R, whose columns are orthonormal over all processes. Collective.

    Args:
        X: Rows of this process, (n, k).
        comm: Processes that have rows.

    Returns:
        Rows of Q of this process, (n, k).
    """
    k = X.shape[1]
    padded = np.vstack([X, np.zeros((k, k))])  # at least k rows, so that R is (k, k)
    Q_local, R_local = on_all(lambda: np.linalg.qr(padded), comm)
    stacked = np.vstack(comm.allgather(R_local))  # (processes · k, k)
    Q_stacked, _ = on_all(lambda: np.linalg.qr(stacked), comm)
    of_process = slice(comm.rank * k, (comm.rank + 1) * k)
    return np.asarray(Q_local[: len(X)] @ Q_stacked[of_process])


def independent_columns(X: Array, tolerance: float, comm: MPI.Comm) -> Array:
    """Return an orthonormal basis of the span of columns, without dependent ones. Collective.

    Args:
        X: Rows of this process, (n, k), of columns with norms up to one.
        tolerance: Norm of X c up to which a unit vector c is dropped.
        comm: Processes that have rows.

    Returns:
        Rows of the basis of this process, (n, ≤ k).
    """
    R = r_factor(X, comm)
    _, sigma, Vt = on_all(lambda: np.linalg.svd(R), comm)
    return orthonormal_columns(X @ Vt[sigma > tolerance].T, comm)


def _r_factor(X: Array) -> Array:
    """Return R of X = Q R, (n, k) → (k, k)."""
    k = X.shape[1]
    if len(X) < k:  # NumPy's R would have n rows
        X = np.vstack([X, np.zeros((k, k))])
    return np.asarray(np.linalg.qr(X, mode="r"))
