# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Direct factors of diagonal blocks of the local matrix, one a subdomain.

Both the generalised inverse :math:`K_ρ^{-1}` and the interior solve :math:`K_{II}^{-1}` of the
Dirichlet preconditioner are *a block of K, factored*; the former with a border of k columns R,

.. math:: \begin{pmatrix} K & ρ R \\ ρ R^⊤ & -ρ I \end{pmatrix}
          \begin{pmatrix} x \\ μ \end{pmatrix} =
          \begin{pmatrix} y \\ 0 \end{pmatrix} \quad ⟺ \quad
          (K + ρ R R^⊤)\, x = y, \; μ = R^⊤ x,

which adds the dense :math:`ρ R R^⊤` at the price of k rows of the factor. The factor is
:math:`L Δ L^⊤` (LU for an unsymmetric K): a loaded wall has subdomains with negative eigenvalues,
and their number, the inertia, is read off Δ; the border contributes k.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse

from dolfinx_feti.errors import FactorError

__all__ = ["BlockFactors", "Choice", "create_factor"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]


#: Percent of work space that MUMPS gets for delayed pivots, one try after the other.
ROOM = (50, 200, 1000)


class BlockFactors:
    """Factors of the blocks ``K[dofs_i, dofs_i]``.

    The symbolic factorisation is done once; :meth:`update` refills the blocks and refactors.

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
        """Prepare one factorisation a block; nothing is factored yet.

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
        self._is = [
            PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
            for rows in blocks
        ]
        self._choice = Choice(prefix, symmetric, right_hand_sides)
        self._blocks: list[_Block | None] = [None] * len(blocks)

    def update(self, borders: Sequence[Array] | None = None, rho: Array | None = None) -> None:
        """Refill and factor every block.

        Args:
            borders: For each block its columns R, (n_i, k).
            rho: For each block the stiffness ρ.

        Raises:
            FactorError: A factorisation failed. Not collective: the caller reduces.
        """
        for i, n in enumerate(self._sizes):
            R = np.zeros((n, 0)) if borders is None else borders[i]
            self.update_block(i, R, 1.0 if rho is None else float(rho[i]))

    def update_block(self, i: int, R: Array, rho: float) -> None:
        """Refill and factor block i with the border R, see :meth:`update`."""
        if self._sizes[i] == 0:
            return
        csr = _bordered(self._K.createSubMatrix(self._is[i], self._is[i]), R, rho)
        block = self._blocks[i]
        if block is not None and block.border != R.shape[1]:
            block.destroy()
            block = None
        if block is None:
            block = _Block(csr, R.shape[1], self._choice)
            self._blocks[i] = block
        block.factor(csr[2])

    def solve(self, y: Array, x: Array) -> None:
        """Solve with every block: ``x[rows_i] = K_i⁻¹ y[rows_i]``, other entries untouched."""
        for rows, block in zip(self.rows, self._blocks, strict=True):
            if block is not None:
                x[rows] = block.solve(y[rows])

    def solve_many(self, i: int, Y: Array) -> Array:
        """Solve with block i for several right-hand sides, (n_i, r) → (n_i, r)."""
        block = self._blocks[i]
        if block is None or Y.shape[1] == 0:
            return np.zeros(Y.shape)
        if block.border == 0:
            return block.solve_many(Y)
        return block.solve_many(np.vstack([Y, np.zeros((block.border, Y.shape[1]))]))[: len(Y)]

    def solve_border(self, i: int, *, transpose: bool = False) -> tuple[Array, Array]:
        """Solve with block i for (0, I) as right-hand sides; return x, (n_i, k), and μ, (k, k)."""
        block, n = self._blocks[i], self._sizes[i]
        if block is None:
            return np.zeros((0, 0)), np.zeros((0, 0))
        rhs = np.vstack([np.zeros((n, block.border)), np.eye(block.border)])
        both = block.solve_many(rhs, transpose=transpose)
        return both[:n], both[n:]

    def inertia(self) -> npt.NDArray[np.int64]:
        """Count negative and zero eigenvalues of each block, (blocks, 2); −1 where unknown.

        A border counts as the term ρ R Rᵀ that it stands for.
        """
        known = [self.inertia_of(i) for i in range(len(self._blocks))]
        return np.array(known, dtype=np.int64).reshape(-1, 2)

    def inertia_of(self, i: int) -> tuple[int, int]:
        """Count negative and zero eigenvalues of block i, see :meth:`inertia`."""
        block = self._blocks[i]
        return (0, 0) if block is None else block.inertia()

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


@dataclass(frozen=True, slots=True)
class Choice:
    """What all factorisations have in common.

    Attributes:
        prefix: Options prefix.
        symmetric: Whether the matrices are symmetric.
        right_hand_sides: How many of them MUMPS treats at once.
    """

    prefix: str
    symmetric: bool
    right_hand_sides: int


class _Block:
    """One factored matrix, (n + k, n + k), with the work vectors of its solves."""

    def __init__(self, csr: tuple[Indices, Indices, Array], border: int, choice: Choice) -> None:
        indptr, indices, values = csr
        n = len(indptr) - 1
        self.border = border
        self._n = n - border
        self._values = values.copy()
        self._matrix = PETSc.Mat().createAIJWithArrays(
            (n, n), (indptr, indices, self._values), comm=PETSc.COMM_SELF
        )
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, choice.symmetric)
        self._b, self._x = self._matrix.createVecs()
        self._b.set(0.0)
        self._choice = choice
        self._pc: PETSc.PC | None = None
        self._F = PETSc.Mat()

    def factor(self, values: Array) -> None:
        self._values[:] = values
        self._matrix.stateIncrease()
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
        if transpose:
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

    def inertia(self) -> tuple[int, int]:
        if not self._F.handle or self._F.getType() != "mumps":
            return -1, -1
        if self._pc is None or self._pc.getType() != "cholesky":
            return -1, self._F.getMumpsInfog(28)
        return self._F.getMumpsInfog(12) - self.border, self._F.getMumpsInfog(28)

    def memory(self) -> float:
        if not self._F.handle:
            return 0.0
        if self._F.getType() == "mumps":
            return float(self._F.getMumpsInfog(22))  # used, in units of 10⁶ bytes
        return float(self._F.getInfo(PETSc.Mat.InfoType.LOCAL)["memory"]) / 2**20

    def destroy(self) -> None:
        for owned in (self._pc, self._matrix, self._b, self._x):
            if owned is not None:
                owned.destroy()


def create_factor(
    matrix: PETSc.Mat, choice: Choice, prepare: Callable[[PETSc.Mat], object] | None = None
) -> PETSc.PC:
    """Factor a sequential matrix, with more work space for MUMPS if it asks for it.

    Args:
        matrix: The matrix, (n, n).
        choice: How to factor.
        prepare: Called with the factor before the work begins.

    Raises:
        FactorError: The factorisation failed.
    """
    for room in ROOM:
        pc = _create_pc(matrix, choice, room)
        if prepare is not None:
            prepare(pc.getFactorMatrix())
        pc.setUp()
        failed = pc.getFailedReason()
        if not failed:
            return pc
        pc.destroy()  # PETSc does not call MUMPS again with a factor that has failed
        if failed != PETSc.PC.FailedReason.FACTOR_OUTMEMORY:
            break
    raise FactorError(f"PETSc reports failed reason {failed}")


def _create_pc(matrix: PETSc.Mat, choice: Choice, room: int) -> PETSc.PC:
    pc = PETSc.PC().create(PETSc.COMM_SELF)
    pc.setOptionsPrefix(choice.prefix)
    pc.setOperators(matrix)
    pc.setType(PETSc.PC.Type.CHOLESKY if choice.symmetric else PETSc.PC.Type.LU)
    pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    pc.setFromOptions()
    if pc.getFactorSolverType() == "mumps":
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(14, room)
        pc.getFactorMatrix().setMumpsIcntl(27, choice.right_hand_sides)
        pc.getFactorMatrix().setMumpsIcntl(24, 1)  # count zero pivots instead of dividing by them
    return pc


def _bordered(block: PETSc.Mat, R: Array, rho: float) -> tuple[Indices, Indices, Array]:
    """Add the border (ρ R, −ρ I) to a block, which is destroyed; return the rows as CSR."""
    indptr, indices, values = block.getValuesCSR()
    block.destroy()
    n, k = R.shape
    if k == 0:
        return indptr, indices, values
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
    return rows.astype(PETSc.IntType), column, data


def _as_slice(rows: Indices) -> slice | Indices:
    """Turn consecutive rows into a slice, which numpy copies without an index."""
    if len(rows) and rows[-1] - rows[0] + 1 == len(rows):
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows
