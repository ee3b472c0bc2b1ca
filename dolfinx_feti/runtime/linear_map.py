# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A distributed PETSc matrix that multiplies numpy arrays: ``y = M @ x``, ``x = M.T @ y``."""

from __future__ import annotations

from petsc4py import PETSc

from dolfinx_feti.runtime.arrays import Array


class LinearMap:
    """Products of a distributed matrix with the local parts of vectors.

    Attributes:
        matrix: The matrix M, which is distributed; the caller owns it.
        shape: Numbers of rows and columns of this process, (m, n).
    """

    def __init__(self, matrix: PETSc.Mat) -> None:
        """Create and own work vectors for a matrix that the caller owns."""
        self.matrix = matrix
        self._x, self._y = matrix.createVecs()
        self.shape = (self._y.getLocalSize(), self._x.getLocalSize())

    @property
    def T(self) -> TransposedMap:
        """The transpose Mᵀ, which shares matrix and work vectors.

        A product returns a copy: ``M @ (M.T @ y)`` is safe.
        """
        return TransposedMap(self)

    def __matmul__(self, x: Array) -> Array:
        """Return M x, (n,) → (m,), local parts. Collective."""
        self._x.array[:] = x
        self.matrix.mult(self._x, self._y)
        return self._y.array_r.copy()

    def multiply_transposed(self, y: Array) -> Array:
        """Return Mᵀ y, (m,) → (n,), local parts. Collective."""
        self._y.array[:] = y
        self.matrix.multTranspose(self._y, self._x)
        return self._x.array_r.copy()

    def destroy(self) -> None:
        """Free the work vectors, not the matrix."""
        self._x.destroy()
        self._y.destroy()


class TransposedMap:
    """The transpose of a :class:`LinearMap`."""

    def __init__(self, M: LinearMap) -> None:
        """Refer to the map M whose transpose this is."""
        self._M = M

    def __matmul__(self, y: Array) -> Array:
        """Return Mᵀ y, (m,) → (n,), local parts. Collective."""
        return self._M.multiply_transposed(y)
