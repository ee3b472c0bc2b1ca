# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A few long columns of which each process has some rows: QR factors, of all rows or in groups.

.. math:: X = Q R, \qquad R^⊤ R = X^⊤ X,

but without the square: the processes' triangular factors are stacked and factored again, so that
singular values come out to :math:`ε \|X\|`.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

__all__ = ["independent_columns", "orthonormal_columns", "triangles"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]


def triangles(X: Array, group: Integers, count: int, comm: MPI.Comm) -> Array:
    """Return R of each group of rows, (count, k, k), the same on all processes.

    Args:
        X: Rows of this process, (n, k).
        group: Group of each row, from 0; rows of other numbers are left out, (n,).
        count: Number of groups over all processes.
        comm: Communicator.

    Note:
        Collective.
    """
    k = X.shape[1]
    own = np.zeros((count, k, k))
    order = np.argsort(group, kind="stable")
    ends = np.searchsorted(group[order], np.arange(count + 1))
    for g in np.flatnonzero(np.diff(ends)):
        own[g] = _triangle(X[order[ends[g] : ends[g + 1]]])
    stacked = np.stack(comm.allgather(own), axis=1)  # (count, processes, k, k)
    return np.array([_triangle(rows.reshape(-1, k)) for rows in stacked]).reshape(count, k, k)


def orthonormal_columns(X: Array, comm: MPI.Comm) -> Array:
    """Return an orthonormal basis of columns, (n, k).

    Args:
        X: Rows of this process, (n, k).
        comm: Communicator.

    Note:
        Collective.
    """
    k = X.shape[1]
    Q, R = np.linalg.qr(np.vstack([X, np.zeros((k, k))]))  # as many rows as columns, at least
    Q_all, _ = np.linalg.qr(np.vstack(comm.allgather(R)))
    return np.asarray(Q[: len(X)] @ Q_all[comm.rank * k : (comm.rank + 1) * k])


def independent_columns(X: Array, tolerance: float, comm: MPI.Comm) -> Array:
    """Return an orthonormal basis of columns of size one at most, without what is smaller.

    Args:
        X: Rows of this process, (n, k).
        tolerance: A combination of the columns of size one that is smaller than this is left out.
        comm: Communicator.

    Note:
        Collective.
    """
    R = triangles(X, np.zeros(len(X), dtype=np.int64), 1, comm)[0]
    _, sigma, Vt = np.linalg.svd(R)
    return orthonormal_columns(X @ Vt[sigma > tolerance].T, comm)


def _triangle(X: Array) -> Array:
    """Return R of X = Q R, (k, k)."""
    k = X.shape[1]
    if len(X) < k:
        X = np.vstack([X, np.zeros((k, k))])
    return np.asarray(np.linalg.qr(X, mode="r"))
