# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The averaged coarse space and its Galerkin matrix.

.. math:: V = T^⊤ δ\, U, \qquad A_0 = V^⊤ A V = \sum_i W_i^⊤ S_i W_i, \qquad W_i = (T V)_i

(docs/theory.md) with columns :math:`U_i` of each subdomain on its interface, (n_i, k_i), and
:math:`W_i`, (n_i, c_i), those of its neighbours, too. V serves any matrix; A V and A₀ are of one.
A has at least as many negative eigenvalues as A₀; they count only if they are those of
:math:`A_0 + ε`, with ε just above rounding, :math:`\sum_i \|S_i\|_F \|W_i\|^2` times its unit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse
import scipy.sparse.linalg

from dolfinx_feti.feti.coarse.fields import averaged_fields
from dolfinx_feti.feti.coarse.gathered import GatheredSolver
from dolfinx_feti.feti.coarse.near import NearColumns, joined
from dolfinx_feti.feti.gluing.copies import Copies, consecutive
from dolfinx_feti.feti.subdomain.blocks import block_diagonal, on_subdomains
from dolfinx_feti.feti.subdomain.operator import Operator
from dolfinx_feti.feti.subdomain.orthonormal import diagonalising, unit_scale
from dolfinx_feti.feti.subdomain.panels import rows_product
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.collective import deferred
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.null_space import anchor, null_space
from dolfinx_feti.torn.rounding import EPS

#: Energy below which a combination of the columns of a subdomain, of unit energy each, is dropped.
LEAST_ENERGY = 1e-6

#: A pivot of A₀ below this multiple of its norm is that of a column that depends on others.
ZERO_PIVOT = 1e-8

#: Precision of A V where preconditioner and matrix belong together.
PRECISION: type[np.floating] = np.float32

#: Stiffness, over the greatest of a subdomain, of which single precision leaves nothing.
SOFTEST = 10.0 * float(np.finfo(np.float32).eps)

#: Multiple of a bound of rounding errors by which an energy has to be negative.
MARGIN = 10.0


class AveragedColumns:
    """V = Tᵀ δ U.

    Attributes:
        copies: Copies of the interface dofs.
        size: Number of columns of this process.
        total: Number of columns over all processes.
        columns: For each subdomain :math:`U_i`, (n_i, k_i).
        own: Their numbers among those of this process.
        W: For each subdomain :math:`W_i = (T V)_i`, (n_i, c_i), of the columns ``near`` it.
    """

    def __init__(self, copies: Copies, U: Sequence[Array]) -> None:
        """Average the columns U_i of each subdomain on its interface, (n_i, k_i). Collective."""
        counts = [U_i.shape[1] for U_i in U]
        self.copies = copies
        self.columns = [np.asfortranarray(U_i) for U_i in U]
        self.own = consecutive(counts)
        self.size = sum(counts)
        self.total = copies.comm.allreduce(self.size)
        self.W = averaged_fields(copies, self.columns)
        self.near = NearColumns(self.W, counts, copies.comm)

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

    def destroy(self) -> None:
        """Free the star forest."""
        self.near.destroy()


class AveragedSpace:
    """V, A V and the factored A₀.

    Attributes:
        V: The columns.
        total: Number of columns over all processes.
        combinations: Those of the columns of this process that A₀ belongs to, block-diagonal,
            (size, up to size).
        AV: For each subdomain :math:`Y_i^⊤`, (c_i, n_i), in single precision where that does.
        A_0: The Galerkin matrix of the independent combinations.
        solver: Its factors.
    """

    def __init__(
        self,
        V: AveragedColumns,
        S: Operator,
        *,
        prefix: str,
        symmetric: bool = True,
        combinations: scipy.sparse.csr_array | None = None,
    ) -> None:
        """Form and factor the Galerkin matrix. Collective.

        Args:
            V: The columns; the caller destroys them after this.
            S: Applies S_i.
            prefix: Options prefix of the coarse solver.
            symmetric: Whether K is; if not, A₀ is factored by LU and tells no negative eigenvalues.
            combinations: Independent ones, of another matrix; None to look for them.
        """
        self.V = V
        self.total = V.total
        self.AV: list[npt.NDArray[np.floating]] = []
        stiffness = np.abs(S.torn.diagonal()[V.copies.dofs])

        def elements() -> Iterator[Array]:
            for i, (W_i, rows) in enumerate(zip(V.W.panels, V.copies.blocks, strict=True)):
                Y = S.multiply_panels(i, W_i, transpose=not symmetric)  # Y = Sᵀ W
                k = stiffness[rows]
                even = k.min(initial=np.inf) >= SOFTEST * k.max(initial=0.0)
                single = combinations is None and even
                self.AV.append(np.ascontiguousarray(Y.T, PRECISION if single else np.float64))
                E = W_i.overlap(Y, symmetric=symmetric)  # Wᵀ Y
                yield E if symmetric else E.T

        with Lifetime() as owned:
            own = owned.own
            energies = own(V.near.sum(elements()))
            if combinations is None:
                combinations = on_subdomains(lambda: _independent(energies, V.own), V.copies.comm)
            self.combinations = combinations
            self.A_0 = own(_change_of_basis(energies, combinations))
            Z = null_space(S.torn)[V.copies.dofs]
            anchor(self.A_0, on_subdomains(lambda: self._amplitudes(Z), V.copies.comm))
            self.A_0.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
            self._x, self._y = (own(vector) for vector in self.A_0.createVecs())
            self.solver = own(
                GatheredSolver(
                    self.A_0,
                    prefix=prefix,
                    symmetric=symmetric,
                    zero=ZERO_PIVOT,
                    counts=self._counts(),
                )
            )
            self._negative = self.solver.pivots().negative
            if symmetric and self._negative:  # perhaps by rounding
                shifted = own(self._with_rounding(S))
                solver = own(GatheredSolver(shifted, prefix=prefix, symmetric=True))
                self._negative = solver.pivots().negative
            self._owned = owned.pop_all()

    def initial_guess(self, r: Array) -> Array:
        """Return V A₀⁻¹ Vᵀ r of an assembled residual, all given by copies, (n,). Collective."""
        return self.V.prolong(self.solve(self.V.restrict(r)))

    def correct(self, z: Array, r: Array) -> Array:
        """Return z + V A₀⁻¹ Vᵀ (r − A z), the projection of z for Vᵀ r = 0, by copies, (n,)."""
        parts = zip(self.V.W.panels, self.AV, self.V.copies.blocks, strict=True)
        near = deferred(
            lambda: joined([rows_product(W.code, Y, z[rows]) for W, Y, rows in parts]),
            self.V.near.near,
        )
        energies = self.V.near.to_owners(near)  # Vᵀ A z
        return z + self.V.prolong(self.solve(self.V.restrict(r) - energies))

    def solve(self, e: Array) -> Array:
        """Return A₀⁻¹ e, both (size,). Collective."""
        self._y.array[:] = self.combinations.T @ e
        self.solver.solve(self._y, self._x)
        return np.asarray(self.combinations @ self._x.array_r)

    def negative(self) -> int | None:
        """Count the negative eigenvalues of A₀, which A has at least; None if not known."""
        return self._negative

    def destroy(self) -> None:
        """Free A V, matrices and solver; the columns stay."""
        self.AV.clear()
        self._owned.close()

    def _counts(self) -> Numbers:
        """Count the combinations of each subdomain."""
        some = self.combinations.tocsc()
        row = some.indices[some.indptr[:-1]]  # any of each column
        ends = [own.stop for own in self.V.own]
        return np.bincount(np.searchsorted(ends, row, side="right"), minlength=len(ends))

    def _amplitudes(self, Z: Array) -> Array:
        """Return own rows of y, with Z = V y, for fields of A on the interface, (n, k)."""
        pairs, B = zip(self.V.columns, self.V.copies.blocks, strict=True), self.combinations
        if not Z.size:
            return np.zeros((B.shape[1], Z.shape[1]))
        s = np.vstack([np.linalg.pinv(U) @ Z[rows] for U, rows in pairs])  # Z = U s
        y = scipy.sparse.linalg.spsolve((B.T @ B).tocsc(), B.T @ s)  # s = B y
        return np.asarray(y).reshape(B.shape[1], Z.shape[1])

    def _with_rounding(self, S: Operator) -> PETSc.Mat:
        """Return A₀ + ε. Collective."""
        copies = self.V.copies
        norms = on_subdomains(lambda: estimated_norms(copies, S.multiply_many), copies.comm)
        pairs = zip(self.V.W.panels, norms, strict=True)
        bounds = [EPS * norm * W.squares() for W, norm in pairs]
        columns = self.V.near.to_owners(joined(bounds))
        self._x.array[:] = MARGIN * (self.combinations.multiply(self.combinations).T @ columns)
        shifted = self.A_0.copy()
        shifted.setDiagonal(self._x, addv=PETSc.InsertMode.ADD_VALUES)
        return shifted


def estimated_norms(copies: Copies, multiply: Callable[[int, Array], Array]) -> list[float]:
    """Return norms of the size of ‖S_i‖_F of each subdomain, by a product with a random vector."""
    sizes = [rows.stop - rows.start for rows in copies.blocks]
    ω = [np.random.default_rng(n).standard_normal((n, 1)) for n in sizes]
    return [float(np.linalg.norm(multiply(i, ω_i))) for i, ω_i in enumerate(ω)]


def _independent(A: PETSc.Mat, blocks: Sequence[slice]) -> scipy.sparse.csr_array:
    """Return columns, or combinations, of energy ±1 that are independent in each diagonal block."""
    indptr, indices, values = A.getDiagonalBlock().getValuesCSR()
    size = A.getLocalSize()[0]
    local = scipy.sparse.csr_array((values, indices, indptr), shape=(size, size))
    combinations = [_unit_energy(local[rows, rows].toarray()) for rows in blocks]
    basis = block_diagonal(combinations)
    basis.eliminate_zeros()
    return basis


def _unit_energy(H: Array) -> Array:
    """Return B with entries ±1 on the diagonal of Bᵀ H B, diagonal itself if none is dropped."""
    θ, B = diagonalising(H, LEAST_ENERGY)
    return np.diag(unit_scale(H)) if len(θ) == len(H) else B / np.sqrt(np.abs(θ))


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
    csr = (a.astype(PETSc.IntType) for a in (basis.indptr, basis.indices + before))
    sizes = A.getSizes()[0], (size, total)
    B = PETSc.Mat().createAIJ(sizes, csr=(*csr, basis.data), comm=A.comm)
    A_0 = A.ptap(B)
    for owned in (A, B):
        owned.destroy()
    return A_0
