# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Factors of sparse regularised blocks by a direct solver of PETSc, by default MUMPS.

.. math:: \begin{pmatrix} K & ρ R \\ ρ R^⊤ & -ρ I \end{pmatrix}
          \begin{pmatrix} x \\ μ \end{pmatrix} = \begin{pmatrix} y \\ 0 \end{pmatrix}
          \quad ⟺ \quad (K + ρ R R^⊤)\, x = y, \; μ = R^⊤ x,

by :math:`L Δ L^⊤`, or :math:`L U` for an unsymmetric K. The border ρ R keeps the matrix sparse. The
bordered matrix is congruent to :math:`\operatorname{diag}(K + ρ R R^⊤, -ρ I)`. The k columns of R
therefore add k negative eigenvalues, which are subtracted from the number that the solver reports.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.feti.subdomain.blocks import index_set
from dolfinx_feti.feti.subdomain.factors.petsc_solver import (
    FactorOptions,
    factor_matrix,
    factor_memory,
    inertia_of,
    is_ldlt,
    solve_columns,
)
from dolfinx_feti.feti.subdomain.factors.protocol import (
    EmptyFactor,
    Factor,
    FactorInertia,
    destroyed_error,
)
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.lifetime import Lifetime


class PetscFactor:
    """The factor of K_ρ = ``K[rows, rows] + ρ R Rᵀ + diag(shift)``, (n_i, n_i), n_i > 0.

    Methods are those of ``Factor``.

    Attributes:
        inertia: Numbers of negative eigenvalues of K_ρ and of zero pivots, if the solver reports
            them.
        is_single_precision: False.
    """

    is_single_precision = False

    def __init__(self, pc: PETSc.PC, matrix: PETSc.Mat, n_border: int) -> None:
        """Own a factor and its matrix.

        Args:
            pc: The factor of the bordered matrix.
            matrix: The bordered matrix, (n_i + n_border, n_i + n_border).
            n_border: Number of columns of R.
        """
        self._pc = pc
        self._matrix = matrix
        self._n = matrix.getSize()[0] - n_border
        self._n_border = n_border
        self._b, self._x = matrix.createVecs()
        self._b.set(0.0)  # a solve sets the first n_i entries; those of the border stay zero
        negative, zero_pivots = inertia_of(pc)
        self.inertia = FactorInertia(None if negative is None else negative - n_border, zero_pivots)

    def solve(self, Y: Array, *, transpose: bool = False) -> Array:
        """Return K_ρ⁻¹ Y, or K_ρ⁻ᵀ Y, (n_i,) or (n_i, r)."""
        if not self._pc:  # a destroyed object of PETSc is false
            raise destroyed_error()
        if Y.ndim == 1:
            return self._solve_one(Y, transpose=transpose)
        if Y.shape[1] == 0:
            return np.zeros(Y.shape)
        padded = np.zeros((self._n + self._n_border, Y.shape[1]), order="F")
        padded[: self._n] = Y
        with Lifetime() as owned:
            B = owned.own(PETSc.Mat().createDense(padded.shape, array=padded, comm=PETSc.COMM_SELF))
            X = owned.own(PETSc.Mat().createDense(padded.shape, comm=PETSc.COMM_SELF))
            X.setUp()
            B.assemble()
            X.assemble()
            solve_columns(self._pc, B, X, transpose=transpose)
            return X.getDenseArray()[: self._n].copy()

    def _solve_one(self, y: Array, *, transpose: bool) -> Array:
        """Return K_ρ⁻¹ y, or K_ρ⁻ᵀ y, (n_i,)."""
        self._b.array[: self._n] = y  # zero on the border
        F = self._pc.getFactorMatrix()
        if transpose:
            F.solveTranspose(self._b, self._x)
        else:
            F.solve(self._b, self._x)
        return self._x.array_r[: self._n].copy()

    def memory(self) -> float:
        """Return the memory of the factor in MiB; zero if the solver does not report it."""
        return (factor_memory(self._pc) or 0.0) if self._pc else 0.0

    def destroy(self) -> None:
        """Free the factor and its matrix."""
        for owned in (self._pc, self._matrix, self._b, self._x):
            owned.destroy()


def factor_by_petsc(
    K: PETSc.Mat,
    rows: Indices,
    options: FactorOptions,
    R: Array | None = None,
    rho: float = 1.0,
    shift: Array | None = None,
) -> Factor:
    """Factor ``K[rows, rows] + ρ R Rᵀ + diag(shift)`` with pivoting.

    Args:
        K: Sequential matrix, (n, n).
        rows: Rows and columns of the block, (n_i,); there may be none.
        options: Settings of the solver.
        R: Columns, (n_i, k), of any norm; None for none.
        rho: Stiffness ρ.
        shift: Addend of the diagonal, (n_i,); None for zero.

    Raises:
        FactorError: The factorisation failed.
        MemoryError: Memory ran out; if MUMPS reports it, the message names the option that helps.
    """
    if len(rows) == 0:
        return EmptyFactor()
    matrix = _shifted_block(K, rows, shift)  # _bordered and _upper_triangle replace and destroy it
    n_border = 0 if R is None else R.shape[1]
    if R is not None and n_border:
        matrix = _bordered(matrix, R, rho)
    # PETSc converts a matrix to its upper triangle only if it is marked as symmetric.
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, options.is_symmetric)
    if is_ldlt(options):
        matrix = _upper_triangle(matrix)
    try:
        pc = factor_matrix(matrix, options)
    except BaseException:
        matrix.destroy()
        raise
    return PetscFactor(pc, matrix, n_border)


def _shifted_block(K: PETSc.Mat, rows: Indices, shift: Array | None) -> PETSc.Mat:
    """Return ``K[rows, rows] + diag(shift)``, which the caller destroys."""
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
    """Return the upper triangle of a symmetric matrix, half its memory, and destroy the matrix."""
    upper = block.convert(PETSc.Mat.Type.SBAIJ, PETSc.Mat())
    block.destroy()
    return upper


def _bordered(block: PETSc.Mat, R: Array, rho: float) -> PETSc.Mat:
    """Return the matrix with the border (ρ R, −ρ I), (n_i + k, n_i + k), and destroy the block."""
    indptr, indices, values = block.getValuesCSR()
    block.destroy()
    n, k = R.shape
    K = scipy.sparse.csr_array((values, indices, indptr), shape=(n, n))
    bordered = scipy.sparse.block_array([[K, rho * R], [rho * R.T, -rho * np.eye(k)]], format="csr")
    csr = (
        bordered.indptr.astype(PETSc.IntType),
        bordered.indices.astype(PETSc.IntType),
        bordered.data,
    )
    return PETSc.Mat().createAIJ((n + k, n + k), csr=csr, comm=PETSc.COMM_SELF)
