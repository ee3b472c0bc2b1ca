# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The averaged coarse space of the primal method and its Galerkin matrix.

Each subdomain contributes columns :math:`U_i` on its interface: the stand-in E of its kernel
(``pseudoinverse``) and others, such as those of ``adaptive``. With their copies averaged they are
fields of the assembled problem,

.. math:: V = T^⊤ δ\, U, \qquad A_0 = V^⊤ A V = \sum_i W_i^⊤ S_i W_i, \qquad W_i = (T V)_i,

(Mandel 1993, Fragakis and Papadrakakis 2003). :math:`W_i` holds the columns of subdomain i and
those of its neighbours, as one dense block, and so does :math:`Y_i = S_i W_i`, so that the
projection

.. math:: z ← z - V A_0^{-1} (A V)^⊤ z, \qquad (A V)^⊤ z = \sum_i Y_i^⊤ (T z)_i

takes two dense products for each subdomain, one coarse solve, and an average. V serves any matrix,
:class:`AveragedColumns`; A V and A₀ are those of one, :class:`AveragedSpace`.

The columns are scaled to energy one. Those of a subdomain may depend on each other, or nearly so.
Its block on the diagonal of A₀ tells: combinations with an energy below :data:`DEPENDENT` are
dropped, and the others take the place of the columns. Columns of several subdomains may depend on
each other, too: pivots below :data:`ZERO` are left out of the solution, which is exact on what is
left. Rounding gives such columns energies of either sign. So negative eigenvalues count only if
they are those of :math:`A_0 + ε`, with a diagonal ε just above the rounding errors of the energies,
:math:`\sum_i \|S_i\|_F \|W_i\|^2` times the unit of rounding for each column.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse

from dolfinx_feti.feti.coarse.fields import averaged_fields
from dolfinx_feti.feti.coarse.gathered import GatheredSolver
from dolfinx_feti.feti.coarse.near import NearColumns, joined
from dolfinx_feti.feti.copies import Copies, consecutive
from dolfinx_feti.feti.preconditioner.base import Preconditioner

__all__ = ["BOUNDS", "EPS", "AveragedColumns", "AveragedSpace", "estimated_norm"]

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]

#: Energy below which a combination of the columns of a subdomain, of unit energy each, is dropped.
DEPENDENT = 1e-6

#: A pivot of A₀ below this multiple of its norm is that of a column that depends on others.
ZERO = 1e-8

#: Bounds of rounding errors by which an eigenvalue of A₀ has to be negative.
BOUNDS = 10.0

#: Unit of rounding.
EPS = float(np.finfo(np.float64).eps)

#: Steps of conjugate gradients for each unknown of A₀ in the search of a negative direction.
STEPS = 3


class AveragedColumns:
    """V = Tᵀ δ U.

    Attributes:
        copies: Copies of the interface dofs.
        size: Number of columns of this process.
        total: Number of columns over all processes.
        columns: For each subdomain :math:`U_i`, (n_i, k_i).
        own: Where they stand among those of this process.
        W: For each subdomain :math:`W_i = (T V)_i`, (n_i, c_i).
        near: Which columns these are.
    """

    def __init__(self, copies: Copies, U: Sequence[Array]) -> None:
        """Average the columns.

        Args:
            copies: Copies of the interface dofs.
            U: For each subdomain its columns on the interface, (n_i, k_i).

        Note:
            Collective.
        """
        counts = [U_i.shape[1] for U_i in U]
        self.copies = copies
        self.columns = [np.asfortranarray(U_i) for U_i in U]
        self.own = consecutive(counts)
        self.size = sum(counts)
        self.total = copies.comm.allreduce(self.size)
        self.W = averaged_fields(copies, self.columns)
        self.near = NearColumns(self.W.numbers, counts, copies.comm)

    def restrict(self, r: Array) -> Array:
        """Return Vᵀ r of an assembled residual given by copies, (n,) → (size,)."""
        t = self.copies.delta * r
        blocks = zip(self.columns, self.copies.blocks, strict=True)
        return joined([U.T @ t[rows] for U, rows in blocks])

    def prolong(self, y: Array) -> Array:
        """Return the copies of V y, (size,) → (n,). Collective."""
        t = np.empty(self.copies.n)
        for U, rows, own in zip(self.columns, self.copies.blocks, self.own, strict=True):
            t[rows] = U @ y[own]
        return self.copies.average(t)

    def memory(self) -> float:
        """Return the memory of the columns of this process in MiB."""
        return sum(U.nbytes for U in self.columns) / 2**20 + self.W.memory()

    def destroy(self) -> None:
        """Free the star forest."""
        self.near.destroy()


class AveragedSpace:
    """V, A V and the factored A₀.

    Attributes:
        V: The columns.
        total: Number of columns over all processes.
        combinations: Of the columns of each subdomain, those that A₀ belongs to,
            (k_i, up to k_i).
        dropped: Number of dependent combinations, over all processes.
        AV: For each subdomain :math:`Y_i`, (n_i, c_i).
        A_0: The Galerkin matrix of the independent combinations.
        solver: Its factors.
    """

    def __init__(
        self,
        V: AveragedColumns,
        S: Preconditioner,
        *,
        prefix: str,
        combinations: Sequence[Array] | None = None,
    ) -> None:
        """Form and factor the Galerkin matrix.

        Args:
            V: The columns; the caller destroys them after this.
            S: Applies S_i.
            prefix: Options prefix of the coarse solver.
            combinations: Those that another matrix has shown to be independent; None to look for
                them.

        Note:
            Collective.
        """
        self.V = V
        self.total = V.total
        self.AV: list[Array] = []

        def elements() -> Iterator[Array]:
            for i in range(len(V.W)):
                W_i = V.W[i]
                self.AV.append(S.multiply_panels(i, W_i))  # Y = S W
                yield W_i.overlap(self.AV[i])  # Wᵀ Y

        whole = V.near.sum(elements())
        self.combinations = _independent(whole, V.own) if combinations is None else combinations
        self._basis = _block_diagonal(self.combinations)
        self.A_0 = _change_of_basis(whole, self._basis)
        self.A_0.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.dropped = V.total - self.A_0.getSize()[0]
        self._x, self._y = self.A_0.createVecs()
        self.solver = GatheredSolver(self.A_0, prefix=prefix, symmetric=True, zero=ZERO)
        self._negative = self.solver.pivots().negative
        if self._negative:
            near = [
                EPS * estimated_norm(S.multiply_many, i, rows.stop - rows.start) * V.W[i].squares()
                for i, rows in enumerate(V.copies.blocks)
            ]
            rounding = self._basis.multiply(self._basis).T @ V.near.to_owners(joined(near))
            self._negative = self._count_negative(BOUNDS * rounding, prefix)

    def start(self, r: Array) -> Array:
        """Return V A₀⁻¹ Vᵀ r of an assembled residual, all given by copies, (n,). Collective."""
        return self.V.prolong(self.solve(self.V.restrict(r)))

    def correct(self, z: Array, r: Array) -> Array:
        """Return z + V A₀⁻¹ (Vᵀ r − (A V)ᵀ z), of and by copies, (n,). Collective.

        It is the projection of z where r is orthogonal to V, and removes what rounding leaves of r
        along V elsewhere.
        """
        return z + self.V.prolong(self.solve(self.V.restrict(r) - self.energies(z)))

    def correct_with_product(self, z: Array, r: Array) -> tuple[Array, float]:
        """Return what :meth:`correct` does, and its product with r. Collective."""
        z = self.correct(z, r)
        return z, self.V.copies.dot(r, z)

    def energies(self, z: Array) -> Array:
        """Return the energy products with the columns of this process, (A V)ᵀ z, (size,)."""
        blocks = zip(self.AV, self.V.copies.blocks, strict=True)
        return self.V.near.to_owners(joined([Y.T @ z[rows] for Y, rows in blocks]))

    def solve(self, e: Array) -> Array:
        """Return A₀⁻¹ e, both (size,). Collective."""
        self._y.array[:] = self._basis.T @ e
        self.solver.solve(self._y, self._x)
        return np.asarray(self._basis @ self._x.array_r)

    def negative(self) -> int | None:
        """Count the negative eigenvalues of A₀, which A has at least; None if not known."""
        return self._negative

    def _count_negative(self, rounding: Array, prefix: str) -> int | None:
        """Count the negative eigenvalues of A₀ + ε, with the diagonal ε of this process."""
        self._x.array[:] = rounding
        shifted = self.A_0.copy()
        shifted.setDiagonal(self._x, addv=PETSc.InsertMode.ADD_VALUES)
        solver = GatheredSolver(shifted, prefix=prefix, symmetric=True)
        negative = solver.pivots().negative
        solver.destroy()
        shifted.destroy()
        return negative

    def negative_direction(self) -> Array | None:
        """Return the copies of a field v with vᵀ A v < 0, (n,); None if A₀ is positive definite.

        Conjugate gradients for A₀ meet one before they converge.

        Note:
            Collective.
        """
        if self.negative() == 0:
            return None
        r, q = self.A_0.createVecs()
        r.array[:] = np.random.default_rng(self.V.copies.comm.rank).standard_normal(len(r.array_r))
        p, ρ, v = r.copy(), r.dot(r), None
        for _ in range(STEPS * self.A_0.getSize()[0]):
            self.A_0.mult(p, q)
            curvature = p.dot(q)
            if curvature <= 0.0:
                v = self.V.prolong(np.asarray(self._basis @ p.array_r))
                break
            r.axpy(-ρ / curvature, q)
            ρ, last = r.dot(r), ρ
            p.aypx(ρ / last, r)
        for owned in (r, q, p):
            owned.destroy()
        return v

    def memory(self) -> float:
        """Return the memory of the dense blocks of this process in MiB."""
        return self.V.memory() + sum(Y.nbytes for Y in self.AV) / 2**20

    def destroy(self) -> None:
        """Free A V, matrix and solver; the columns stay."""
        self.AV.clear()
        self.solver.destroy()
        for owned in (self.A_0, self._x, self._y):
            owned.destroy()


def estimated_norm(multiply: Callable[[int, Array], Array], i: int, n: int) -> float:
    """Return a norm of the size of ‖S_i‖_F, (n, n)."""
    ω = np.random.default_rng(n).standard_normal((n, 1))
    return float(np.linalg.norm(multiply(i, ω)))


def _independent(A: PETSc.Mat, blocks: Sequence[slice]) -> list[Array]:
    """Return columns, or combinations, of energy ±1 that are independent in each diagonal block.

    Args:
        A: Galerkin matrix of all columns, distributed.
        blocks: Rows of each subdomain among those of this process.

    Returns:
        The combinations of each subdomain, (k_i, up to k_i).
    """
    indptr, indices, values = A.getDiagonalBlock().getValuesCSR()
    size = A.getLocalSize()[0]
    local = scipy.sparse.csr_array((values, indices, indptr), shape=(size, size))
    return [_normalised(local[rows][:, rows].toarray()) for rows in blocks]


def _block_diagonal(combinations: Sequence[Array]) -> scipy.sparse.csr_array:
    """Return the combinations of all subdomains of this process, (size, up to size)."""
    if not combinations:
        return scipy.sparse.csr_array((0, 0))
    basis = scipy.sparse.csr_array(scipy.sparse.block_diag(combinations, format="csr"))
    basis.eliminate_zeros()
    return basis


def _normalised(A: Array) -> Array:
    """Return Q with entries ±1 on the diagonal of Qᵀ A Q, (k, up to k).

    It is diagonal, or else leaves out directions of no energy.
    """
    size = np.sqrt(np.abs(A.diagonal()))
    scale = np.divide(1.0, size, where=size > 0.0, out=np.zeros_like(size))
    values, Q = np.linalg.eigh(scale[:, None] * A * scale)
    kept = np.abs(values) > DEPENDENT
    if np.all(kept):
        return np.diag(scale)
    return scale[:, None] * Q[:, kept] / np.sqrt(np.abs(values[kept]))


def _change_of_basis(A: PETSc.Mat, basis: scipy.sparse.csr_array) -> PETSc.Mat:
    """Return Bᵀ A B, with the rows and columns of the block-diagonal B of each process; free A."""
    size, comm = basis.shape[1], A.comm.tompi4py()
    if comm.allreduce(size == basis.shape[0] and basis.nnz == size, op=MPI.LAND):
        scale = A.createVecRight()
        scale.array[:] = basis.diagonal()
        A.diagonalScale(scale, scale)
        scale.destroy()
        return A
    before, total = comm.scan(size) - size, comm.allreduce(size)
    csr = (
        basis.indptr.astype(PETSc.IntType),
        (basis.indices + before).astype(PETSc.IntType),
        basis.data,
    )
    B = PETSc.Mat().createAIJ((A.getSizes()[0], (size, total)), csr=csr, comm=A.comm)
    A_0 = A.ptap(B)
    for owned in (A, B):
        owned.destroy()
    return A_0
