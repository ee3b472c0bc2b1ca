# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Factors with pivots of diagonal blocks of the local matrix, one per subdomain.

Both the generalised inverse :math:`K_ρ^{-1}` and the interior solve :math:`K_{II}^{-1}` of the
Dirichlet preconditioner are *a block of K, factored*; the former with a border of k columns R,

.. math:: \begin{pmatrix} K & ρ R \\ ρ R^⊤ & -ρ I \end{pmatrix}
          \begin{pmatrix} x \\ μ \end{pmatrix} =
          \begin{pmatrix} y \\ 0 \end{pmatrix} \quad ⟺ \quad
          (K + ρ R R^⊤)\, x = y, \; μ = R^⊤ x,

which adds the dense :math:`ρ R R^⊤` at the price of k rows of the factor. The factor is
:math:`L Δ L^⊤` (LU for an unsymmetric K): a loaded wall has subdomains with negative eigenvalues,
and their number, the inertia, is read off Δ; the border contributes k.

What factors a regularised block has the methods of :class:`Factors`, whether the block is sparse
(here) or dense (``dense``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse

from dolfinx_feti.feti.subdomain.blocks import index_set
from dolfinx_feti.feti.subdomain.direct import (
    Choice,
    Pivots,
    create_factor,
    mebibytes,
    pivots_of,
    takes_ldlt,
)

__all__ = ["BlockFactors", "Factors"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]


class Factors(Protocol):
    """Factors of the regularised blocks ``K_i + ρ R Rᵀ``."""

    @property
    def rows(self) -> Sequence[slice | Indices]:
        """Rows of each block."""

    def update_block(
        self, i: int, R: Array | None = None, rho: float = 1.0, *, shift: Array | None = None
    ) -> None:
        """Factor block i of the present matrix.

        Args:
            i: Number of the block.
            R: Its columns, (n_i, k), orthonormal; none if not given.
            rho: The stiffness ρ.
            shift: Added to the diagonal, (n_i,).

        Raises:
            FactorError: The factorisation failed. Not collective: the caller reduces.
        """

    def solve(self, y: Array, x: Array) -> None:
        """Solve with every block: ``x[rows_i] = K_i⁻¹ y[rows_i]``, other entries untouched."""

    def solve_many(self, i: int, Y: Array, *, transpose: bool = False) -> Array:
        """Solve with block i for several right-hand sides, (n_i, r) → (n_i, r)."""

    def solve_border(self, i: int) -> tuple[Array, Array]:
        """Return E/ρ, (n_i, k), and −D/ρ², (k, k)."""

    def pivots(self, i: int) -> Pivots:
        """Count negative and zero eigenvalues of block i."""

    def memory(self) -> float:
        """Return the memory of all factors of this process in MiB."""

    def destroy(self) -> None:
        """Free the factors."""


class BlockFactors:
    """Factors of the blocks ``K[rows_i, rows_i]``, which are sparse.

    The symbolic factorisation is done once, as long as the width of the border stays;
    :meth:`update_block` refills a block and factors it again.

    Attributes:
        rows: Rows of each block, a slice where they are consecutive.
    """

    def __init__(
        self,
        K: PETSc.Mat,
        blocks: Sequence[Indices],
        *,
        prefix: str,
        symmetric: bool,
        right_hand_sides: int = 32,
    ) -> None:
        """Prepare one factorisation per block; nothing is factored yet.

        Args:
            K: Local matrix, (n, n).
            blocks: Rows of each block; may be empty.
            prefix: Options prefix of the factorisations.
            symmetric: Whether K is symmetric.
            right_hand_sides: How many of them MUMPS treats at once.
        """
        self._K = K
        self.rows = [_as_slice(rows) for rows in blocks]
        self._sizes = [len(rows) for rows in blocks]
        self._is = [index_set(rows) for rows in blocks]
        self._choice = Choice(prefix, symmetric, right_hand_sides)
        self._half = takes_ldlt(self._choice)
        self._blocks: list[_Block | None] = [None] * len(blocks)

    def update_block(
        self, i: int, R: Array | None = None, rho: float = 1.0, *, shift: Array | None = None
    ) -> None:
        """Refill and factor one block, with the border R; see ``Factors``."""
        if self._sizes[i] == 0:
            return
        K = self._K.createSubMatrix(self._is[i], self._is[i])
        if shift is not None:
            diagonal = K.getDiagonal()
            diagonal.array[:] += shift
            K.setDiagonal(diagonal)
            diagonal.destroy()
        width = 0 if R is None else R.shape[1]
        if R is not None and width:
            K = _bordered(K, R, rho)
        K.setOption(PETSc.Mat.Option.SYMMETRIC, self._choice.symmetric)
        if self._half:
            K = _upper_triangle(K)
        block = self._blocks[i]
        if block is not None and block.border != width:
            block.destroy()
            block = None
        if block is None:
            block = _Block(K, width, self._choice)
            self._blocks[i] = block
        else:
            block.refill(K)
        block.factor()

    def release_block(self, i: int) -> None:
        """Free the factor of one block."""
        block = self._blocks[i]
        if block is not None:
            block.destroy()
        self._blocks[i] = None

    def solve(self, y: Array, x: Array) -> None:
        """Solve with every block: ``x[rows_i] = K_i⁻¹ y[rows_i]``, other entries untouched."""
        for rows, block in zip(self.rows, self._blocks, strict=True):
            if block is not None:
                x[rows] = block.solve(y[rows])

    def solve_many(self, i: int, Y: Array, *, transpose: bool = False) -> Array:
        """Solve with block i for several right-hand sides, (n_i, r) → (n_i, r)."""
        block = self._blocks[i]
        if block is None or Y.shape[1] == 0:
            return np.zeros(Y.shape)
        rhs = np.vstack([Y, np.zeros((block.border, Y.shape[1]))]) if block.border else Y
        return block.solve_many(rhs, transpose=transpose)[: len(Y)]

    def solve_border(self, i: int) -> tuple[Array, Array]:
        """Solve with block i for (0, I) as right-hand sides; return x, (n_i, k), and μ, (k, k)."""
        block, n = self._blocks[i], self._sizes[i]
        if block is None:
            return np.zeros((0, 0)), np.zeros((0, 0))
        rhs = np.vstack([np.zeros((n, block.border)), np.eye(block.border)])
        both = block.solve_many(rhs)
        return both[:n], both[n:]

    def pivots(self, i: int) -> Pivots:
        """Count negative and zero eigenvalues of block i.

        A border counts as the term ρ R Rᵀ that it stands for.
        """
        block = self._blocks[i]
        return Pivots(0, 0) if block is None else block.pivots()

    def memory(self) -> float:
        """Return the memory of all factors of this process in MiB."""
        return sum(block.memory() for block in self._blocks if block is not None)

    def destroy(self) -> None:
        """Free factors and blocks."""
        for index in self._is:
            index.destroy()
        for block in self._blocks:
            if block is not None:
                block.destroy()


class _Block:
    """One factored matrix, (n + k, n + k), with the work vectors of its solves."""

    def __init__(self, matrix: PETSc.Mat, border: int, choice: Choice) -> None:
        """Take the matrix, which belongs to the block from now on."""
        self.border = border
        self._n = matrix.getSize()[0] - border
        self._matrix = matrix
        self._b, self._x = self._matrix.createVecs()
        self._b.set(0.0)
        self._choice = choice
        self._pc: PETSc.PC | None = None
        self._F = PETSc.Mat()

    def refill(self, matrix: PETSc.Mat) -> None:
        """Take the values of a matrix of the same pattern, and free it."""
        matrix.copy(self._matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        matrix.destroy()

    def factor(self) -> None:
        if self._pc is not None:
            self._pc.setUp()
            if self._pc.getFailedReason():
                self._pc.destroy()
                self._pc = None
        if self._pc is None:
            self._pc = create_factor(self._matrix, self._choice)
        self._F = self._pc.getFactorMatrix()

    def solve(self, y: Array) -> Array:
        self._b.array[: self._n] = y
        self._F.solve(self._b, self._x)
        return self._x.array_r[: self._n]

    def solve_many(self, Y: Array, *, transpose: bool = False) -> Array:
        if transpose and Y.shape[1]:
            return np.column_stack([self._solve_transposed(column) for column in Y.T])
        rhs = PETSc.Mat().createDense(Y.shape, array=np.asfortranarray(Y), comm=PETSc.COMM_SELF)
        sol = PETSc.Mat().createDense(Y.shape, comm=PETSc.COMM_SELF)
        sol.setUp()
        rhs.assemble()
        sol.assemble()
        self._F.matSolve(rhs, sol)
        X = sol.getDenseArray().copy()
        rhs.destroy()
        sol.destroy()
        return X

    def _solve_transposed(self, y: Array) -> Array:
        b = PETSc.Vec().createWithArray(np.ascontiguousarray(y), comm=PETSc.COMM_SELF)
        self._F.solveTranspose(b, self._x)
        b.destroy()
        return self._x.array_r.copy()

    def pivots(self) -> Pivots:
        if self._pc is None:
            return Pivots(None, None)
        negative, zero = pivots_of(self._pc)
        return Pivots(None if negative is None else negative - self.border, zero)

    def memory(self) -> float:
        return 0.0 if self._pc is None else mebibytes(self._pc) or 0.0

    def destroy(self) -> None:
        for owned in (self._pc, self._matrix, self._b, self._x):
            if owned is not None:
                owned.destroy()


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
    inside = np.arange(K.nnz) + k * np.repeat(np.arange(n), np.diff(indptr))
    last = np.hstack([rho * R.T, -rho * np.eye(k)])
    size = K.nnz + n * k + last.size
    data, column = np.empty(size), np.empty(size, dtype=PETSc.IntType)
    border = (indptr[1:, None] + k * np.arange(n)[:, None] + np.arange(k)).ravel()
    data[inside], column[inside] = values, indices
    data[border], column[border] = rho * R.ravel(), np.tile(np.arange(n, n + k), n)
    data[-last.size :], column[-last.size :] = last.ravel(), np.tile(np.arange(n + k), k)
    rows = np.concatenate([indptr + k * np.arange(n + 1), size - (n + k) * np.arange(k)[::-1]])
    csr = (rows.astype(PETSc.IntType), column, data)
    return PETSc.Mat().createAIJ((n + k, n + k), csr=csr, comm=PETSc.COMM_SELF)


def _as_slice(rows: Indices) -> slice | Indices:
    """Turn consecutive rows into a slice, which numpy copies without an index."""
    if len(rows) and rows[-1] - rows[0] + 1 == len(rows):
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows
