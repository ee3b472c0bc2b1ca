# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Inverses of small matrices, one for each cell, whose rows and columns have different units."""

from __future__ import annotations

import numpy as np

from dolfinx_feti.runtime.arrays import Array

#: In a matrix (n, n), scaled to entries of at most one, a pivot below n times this bound counts as
#: zero. Rounding leaves some ε in place of a zero pivot; 16 is a margin for the growth of errors in
#: the elimination.
PIVOT_RTOL = 16 * np.finfo(np.float64).eps


class SingularCellError(Exception):
    """A matrix is singular.

    Attributes:
        cell: Its cell.
        column: First column that depends on those before it.
    """

    def __init__(self, cell: int, column: int) -> None:
        """Create an error for a cell and a column."""
        super().__init__(f"column {column} in cell {cell}")
        self.cell = cell
        self.column = column


def invert(K: Array) -> Array:
    """Return the inverse of the matrix of each cell, (cells, n, n).

    Rows and columns are scaled first, so that units do not matter. A matrix with NaN is not
    singular: its inverse has NaN, which Newton's method reports.

    Args:
        K: (cells, n, n).

    Raises:
        SingularCellError: A matrix is singular.
        numpy.linalg.LinAlgError: LAPACK stopped at a matrix that is not singular.
    """
    row_scale = _reciprocal(np.abs(K).max(axis=2, keepdims=True, initial=0.0))
    column_scale = _reciprocal(np.abs(row_scale * K).max(axis=1, keepdims=True, initial=0.0))
    A = row_scale * K * column_scale
    max_entry = 1.0 / (K.shape[1] * PIVOT_RTOL)  # of A⁻¹: its last entry is 1/(last pivot)
    try:
        inverse = np.linalg.inv(A)
    except np.linalg.LinAlgError:  # a pivot in a cell is exactly zero, and NumPy stops
        _require_full_rank(A)
        raise
    is_singular = np.abs(inverse).max(axis=(1, 2), initial=0.0) >= max_entry
    if is_singular.any():
        cell = int(np.argmax(is_singular))
        raise SingularCellError(cell, _first_dependent_column(A[cell]))
    return np.swapaxes(column_scale, 1, 2) * inverse * np.swapaxes(row_scale, 1, 2)


def _require_full_rank(A: Array) -> None:
    """Raise an error for the first finite matrix without full rank.

    Args:
        A: Scaled matrices, (cells, n, n).

    Raises:
        SingularCellError: There is such a matrix.
    """
    n = A.shape[1]
    rank = np.linalg.matrix_rank(np.nan_to_num(A), n * PIVOT_RTOL)  # refuses NaN and infinity
    is_singular = (rank < n) & np.isfinite(A).all(axis=(1, 2))
    if is_singular.any():
        cell = int(np.argmax(is_singular))
        raise SingularCellError(cell, _first_dependent_column(A[cell]))


def _first_dependent_column(A: Array) -> int:
    """Return the first column of a scaled matrix, (n, n), that depends on those before it.

    The result is 0 if the rank of A itself is full to rounding.
    """
    n = len(A)
    for j in range(n):
        if np.linalg.matrix_rank(A[:, : j + 1], n * PIVOT_RTOL) < j + 1:
            return j
    return 0


def _reciprocal(x: Array) -> Array:
    """Return 1/x, and 1 for zero."""
    return 1.0 / np.where(x == 0.0, 1.0, x)
