# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Distributed matrices that read as formulas: ``M @ x`` and ``M.T @ y`` on local arrays.

Each process passes in its part of a vector and gets its part of the product, in numpy arrays:
:math:`F λ = B K^+ B^⊤ λ` is ``B @ inverse.solve(B.T @ lam)``.
"""

from __future__ import annotations

from petsc4py import PETSc

from dolfinx_feti.runtime.arrays import Array

__all__ = ["LinearMap"]


class LinearMap:
    """The action of a matrix, which stays its owner's, or of its transpose, on local parts."""

    def __init__(
        self,
        matrix: PETSc.Mat,
        vectors: tuple[PETSc.Vec, PETSc.Vec] | None = None,
        *,
        transposed: bool = False,
    ) -> None:
        """Take a distributed matrix, (M, N), and work vectors; its own if not given."""
        self.matrix, self._transposed = matrix, transposed
        self._x, self._y = vectors or matrix.createVecs()
        self.shape = (self._y.getLocalSize(), self._x.getLocalSize())

    @property
    def T(self) -> LinearMap:
        """The transpose Mᵀ."""
        vectors = self._y, self._x
        return LinearMap(self.matrix, vectors, transposed=not self._transposed)

    def __matmul__(self, x: Array) -> Array:
        """Return M x for the local part of a vector, (n,). Collective."""
        self._x.array[:] = x
        (self.matrix.multTranspose if self._transposed else self.matrix.mult)(self._x, self._y)
        return self._y.array_r.copy()

    def destroy(self) -> None:
        """Free the work vectors."""
        self._x.destroy()
        self._y.destroy()
