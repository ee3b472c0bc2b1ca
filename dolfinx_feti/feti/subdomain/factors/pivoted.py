# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Factors with pivots of sparse blocks: MUMPS, or another solver of PETSc's.

.. math:: \begin{pmatrix} K & ρ R \\ ρ R^⊤ & -ρ I \end{pmatrix}
          \begin{pmatrix} x \\ μ \end{pmatrix} = \begin{pmatrix} y \\ 0 \end{pmatrix}
          \quad ⟺ \quad (K + ρ R R^⊤)\, x = y, \; μ = R^⊤ x,

by :math:`L Δ L^⊤` (LU for an unsymmetric K). The border of k columns R contributes k to the number
of negative eigenvalues, which is read off Δ.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.feti.subdomain.blocks import index_set
from dolfinx_feti.feti.subdomain.factors.dense import DenseFactor, PackedMatrix
from dolfinx_feti.feti.subdomain.factors.direct import (
    Choice,
    create_factor,
    mebibytes,
    pivots_of,
    solve_many,
    takes_ldlt,
)
from dolfinx_feti.feti.subdomain.factors.protocol import Factor, Pivots, require_alive
from dolfinx_feti.runtime.arrays import Array, Indices


class PivotedFactor:
    """The factor of ``K[rows, rows] + ρ R Rᵀ``: see ``protocol``.

    Attributes:
        pivots: Numbers of negative and zero eigenvalues of K_ρ.
    """

    def __init__(
        self,
        K: PETSc.Mat,
        rows: Indices,
        choice: Choice,
        R: Array | None = None,
        rho: float = 1.0,
        shift: Array | None = None,
    ) -> None:
        """Factor ``K[rows, rows] + ρ R Rᵀ + diag(shift)`` for a row at least; R is (n, k)."""
        self._n, self._border = len(rows), 0 if R is None else R.shape[1]
        self._matrix = _block(K, rows, shift)
        if R is not None and self._border:
            self._matrix = _bordered(self._matrix, R, rho)
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, choice.symmetric)
        if takes_ldlt(choice):
            self._matrix = _upper_triangle(self._matrix)
        self._pc = create_factor(self._matrix, choice)
        self._b, self._x = self._matrix.createVecs()
        self._b.set(0.0)
        negative, zero = pivots_of(self._pc)
        self.pivots = Pivots(None if negative is None else negative - self._border, zero)

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return K_ρ⁻¹ Y, or K_ρ⁻ᵀ Y, (n,) or (n, r)."""
        require_alive(bool(self._pc))
        F = self._pc.getFactorMatrix()
        if Y.ndim == 1:
            self._b.array[: self._n] = Y
            (F.solveTranspose if transpose else F.solve)(self._b, self._x)
            return self._x.array_r[: self._n].copy()
        if Y.shape[1] == 0:
            return np.zeros(Y.shape)
        padded = np.zeros((self._n + self._border, Y.shape[1]), order="F")
        padded[: self._n] = Y
        rhs = PETSc.Mat().createDense(padded.shape, array=padded, comm=PETSc.COMM_SELF)
        sol = PETSc.Mat().createDense(padded.shape, comm=PETSc.COMM_SELF)
        sol.setUp()
        rhs.assemble()
        sol.assemble()
        solve_many(self._pc, rhs, sol, transpose=transpose)
        X = sol.getDenseArray()[: self._n].copy()
        rhs.destroy()
        sol.destroy()
        return X

    def memory(self) -> float:
        """Return the memory of the factor in MiB."""
        return mebibytes(self._pc) or 0.0

    def destroy(self) -> None:
        """Free the factor and its matrix."""
        for owned in (self._pc, self._matrix, self._b, self._x):
            owned.destroy()


def factor_with_pivots(
    K: PETSc.Mat,
    rows: Indices,
    choice: Choice,
    R: Array | None = None,
    rho: float = 1.0,
    shift: Array | None = None,
) -> Factor:
    """Factor ``K[rows, rows] + ρ R Rᵀ`` with pivots; it may be empty; see ``PivotedFactor``."""
    if len(rows) == 0:
        return DenseFactor(PackedMatrix(np.zeros(0), 0, np.zeros(0)))
    return PivotedFactor(K, rows, choice, R, rho, shift)


def _block(K: PETSc.Mat, rows: Indices, shift: Array | None) -> PETSc.Mat:
    """Return the shifted block ``K[rows, rows]``."""
    indices = index_set(rows)
    block = K.createSubMatrix(indices, indices)
    indices.destroy()
    if shift is not None:
        diagonal = block.getDiagonal()
        diagonal.array[:] += shift
        block.setDiagonal(diagonal)
        diagonal.destroy()
    return block


def _upper_triangle(block: PETSc.Mat) -> PETSc.Mat:
    """Return the upper triangle, half the memory; the symmetric block itself is destroyed."""
    upper = block.convert(PETSc.Mat.Type.SBAIJ, PETSc.Mat())
    block.destroy()
    return upper


def _bordered(block: PETSc.Mat, R: Array, rho: float) -> PETSc.Mat:
    """Return the matrix with the border (ρ R, −ρ I); the block itself is destroyed."""
    indptr, indices, values = block.getValuesCSR()
    block.destroy()
    n, k = R.shape
    K = scipy.sparse.csr_array((values, indices, indptr), shape=(n, n))
    whole = scipy.sparse.block_array([[K, rho * R], [rho * R.T, -rho * np.eye(k)]], format="csr")
    csr = (*(a.astype(PETSc.IntType) for a in (whole.indptr, whole.indices)), whole.data)
    return PETSc.Mat().createAIJ((n + k, n + k), csr=csr, comm=PETSc.COMM_SELF)
