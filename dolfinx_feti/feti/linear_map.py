# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Distributed matrices that read as formulas: ``M @ x`` and ``M.T @ y`` on local arrays.

Each process passes in its part of a vector and gets its part of the product. So the dual method is
written in numpy arrays, :math:`F λ = B K^+ B^⊤ λ` as ``B @ inverse.solve(B.T @ lam)``, and no
vector is shared between its parts.
"""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

__all__ = ["LinearMap"]

Array = npt.NDArray[np.float64]


class LinearMap:
    """The action of a matrix, which stays its owner's, on the local parts of vectors.

    Attributes:
        shape: Local numbers of rows and columns.
    """

    def __init__(self, matrix: PETSc.Mat) -> None:
        """Take a distributed matrix, (M, N)."""
        self._matrix = matrix
        self._right, self._left = matrix.createVecs()
        self.shape = (self._left.getLocalSize(), self._right.getLocalSize())

    def __matmul__(self, x: Array) -> Array:
        """Return M x for the local part of a vector, (n,), or of several columns, (n, r).

        Note:
            Collective.
        """
        return _columns(self._mult, x, self.shape[0])

    @property
    def T(self) -> _Transpose:
        """The transpose Mᵀ."""
        return _Transpose(self)

    def _mult(self, x: Array) -> Array:
        self._right.array[:] = x
        self._matrix.mult(self._right, self._left)
        return self._left.array_r.copy()

    def _mult_transpose(self, y: Array) -> Array:
        self._left.array[:] = y
        self._matrix.multTranspose(self._left, self._right)
        return self._right.array_r.copy()

    def destroy(self) -> None:
        """Free the work vectors."""
        self._left.destroy()
        self._right.destroy()


class _Transpose:
    """Mᵀ, for ``M.T @ y``."""

    def __init__(self, map: LinearMap) -> None:
        self._map = map

    def __matmul__(self, y: Array) -> Array:
        return _columns(self._map._mult_transpose, y, self._map.shape[1])


def _columns(apply: Callable[[Array], Array], X: Array, rows: int) -> Array:
    """Apply a map to a vector, or to each column of a matrix."""
    if X.ndim == 1:
        return apply(X)
    Y = np.empty((rows, X.shape[1]), order="F")
    for j in range(X.shape[1]):
        Y[:, j] = apply(X[:, j])
    return Y
