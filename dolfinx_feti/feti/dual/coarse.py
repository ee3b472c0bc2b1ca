# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The coarse problem and the projection.

.. math:: G = B E, \qquad e = E^⊤ f, \qquad N = G^⊤ Q\, G + D, \qquad
          P = I - Q\, G\, N^{-1} G^⊤

(eq. 43; eq. 44, Augustin_eq:projection, has Q = I and D = 0). N, (K, K), is sparse and distributed.
Q is ``identity``, ``diagonal`` or ``preconditioner`` (docs/theory.md). Along a null space of A,
Z = E S on the subdomains with N S = 0, N is anchored.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.coarse.fields import jump_fields
from dolfinx_feti.feti.coarse.gathered import GatheredSolver
from dolfinx_feti.feti.coarse.near import NearColumns, joined
from dolfinx_feti.feti.dual.preconditioner import Preconditioner
from dolfinx_feti.feti.gluing.copies import Copies
from dolfinx_feti.feti.gluing.jump import Gluing
from dolfinx_feti.feti.subdomain.blocks import block_diagonal, on_subdomains, own_columns
from dolfinx_feti.feti.subdomain.modes import SubdomainModes
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.null_space import anchor, null_space

DIFFERENT = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN

#: Share of the diagonal weight in Q = M + ε diag(q).
EPSILON = 0.01


class Coarse:
    """G, Q and the factored N.

    Attributes:
        G: :math:`B E`, (m, K).
        q: Diagonal part of Q, (m,).
        MG: :math:`M G`, if Q has M in it beside the diagonal.
        N: :math:`G^⊤ Q G + D`, (K, K).
        D: Defect of the kernels, block diagonal, (K, K).
        size: Number of coarse unknowns of this process.
        exact: Whether D = 0: all modes are in the kernels.
    """

    def __init__(
        self,
        gluing: Gluing,
        delta: Array,
        modes: Sequence[SubdomainModes],
        preconditioner: Preconditioner,
        *,
        q: str,
        prefix: str,
    ) -> None:
        """Form and factor the coarse matrix, for B, weights δ, (n,), E, D and M. Collective."""
        self._torn, self._dofs = preconditioner.operator.torn, preconditioner.operator.dofs
        self._modes, torn = modes, self._torn
        self.size = sum(m.E.shape[1] for m in modes)
        self.start = torn.comm.scan(self.size) - self.size
        self.total = torn.comm.allreduce(self.size)
        self.exact = torn.comm.allreduce(all(m.exact for m in modes), op=MPI.LAND)
        with Lifetime() as owned:
            own = owned.own
            columns = own_columns(torn, self._dofs, [m.E for m in modes])
            self.G = own(gluing.B.matMult(columns))  # G = B E
            columns.destroy()
            self.q = own(_weight(torn, preconditioner.B_D.matrix, q))
            self.MG: WeightedColumns | None = None
            if q == "preconditioner":
                self.MG = own(WeightedColumns(delta, modes, preconditioner))
            self.D = own(self._block_diagonal([m.D for m in modes]))
            weighed = self.G.copy()
            weighed.diagonalScale(L=self.q)
            self.N = own(self.G.transposeMatMult(weighed))  # N = Gᵀ q G, diagonal part of Q
            weighed.destroy()
            self.N.axpy(1.0, self.D, structure=DIFFERENT)
            if self.MG is not None:  # Gᵀ M G couples more subdomains
                part, self.N = self.N, self.MG.galerkin_matrix
                self.N.axpy(1.0, part, structure=DIFFERENT)
                part.destroy()
            Z = null_space(torn)
            if not anchor(self.N, on_subdomains(lambda: self._amplitudes(Z), torn.comm)):
                raise SetUpError(
                    "Subdomains resist the null space of A: use feti_formulation primal."
                )
            self.N.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self.solver = own(
                GatheredSolver(
                    self.N,
                    prefix=prefix,
                    symmetric=True,
                    counts=np.array([m.E.shape[1] for m in modes], dtype=np.int64),
                )
            )
            self._s, self._e = (own(vector) for vector in self.N.createVecs())
            self._owned = owned.pop_all()

    def solve(self, e: Array) -> Array:
        """Return N⁻¹ e for the local part of a right-hand side, (K,). Collective."""
        return self.solve_and_sum(e, 0.0)[0]

    def solve_and_sum(self, e: Array, addend: float) -> tuple[Array, float]:
        """Solve, and sum a number of each process, without a further reduction. Collective."""
        self._e.array[:] = e
        sum_ = self.solver.solve(self._e, self._s, addend)
        return self._s.array_r.copy(), sum_

    def restrict(self, f: Array) -> Array:
        """Return the load of the kernels, e = Eᵀ f, (n,) → (K,)."""
        pairs = zip(self._modes, self._dofs, strict=True)
        return joined([m.E.T @ f[dofs] for m, dofs in pairs])

    def prolong(self, s: Array) -> Array:
        """Return the motion of the kernels, E s, (K,) → (n,)."""
        u = np.zeros(self._torn.n)
        first = 0
        for modes, dofs in zip(self._modes, self._dofs, strict=True):
            last = first + modes.E.shape[1]
            u[dofs], first = modes.E @ s[first:last], last
        return u

    def _amplitudes(self, Z: Array) -> Array:
        """Return own rows of S, with Z = E S, for fields on the torn dofs, (n, k)."""
        pairs = zip(self._modes, self._dofs, strict=True)
        if not Z.size:
            return np.zeros((self.size, Z.shape[1]))
        return np.vstack([np.linalg.pinv(m.E) @ Z[dofs] for m, dofs in pairs])  # E⁺ Z

    def _block_diagonal(self, blocks: list[Array]) -> PETSc.Mat:
        """Assemble a block for each subdomain, (k_i, k_i), into a matrix, (K, K)."""
        local = block_diagonal([block for block in blocks if len(block)])
        csr = (
            local.indptr.astype(PETSc.IntType),
            (local.indices + self.start).astype(PETSc.IntType),
            local.data,
        )
        sizes = (self.size, self.total)
        return PETSc.Mat().createAIJ((sizes, sizes), csr=csr, comm=self._torn.A.comm)

    def destroy(self) -> None:
        """Free matrices and solver."""
        self._owned.close()


class WeightedColumns:
    r"""M G for G = B E as dense blocks, one for each subdomain, where Q = M.

    .. math:: W_i = (B_D^⊤ G)_i, \quad Y_i = (S_i + Y_Z Y_Z^⊤)\, W_i, \qquad
              M G\, s = B_D\, Y s, \quad G^⊤ M\, r = Y^⊤ B_D^⊤ r, \quad
              G^⊤ M\, G = \sum_i W_i^⊤ Y_i

    with the columns near each subdomain (``near``): fewer entries than M G as a sparse matrix has.

    Attributes:
        blocks: For each subdomain :math:`Y_i`, (n_i, c_i).
        galerkin_matrix: Gᵀ M G, (K, K).
    """

    def __init__(
        self, delta: Array, modes: Sequence[SubdomainModes], preconditioner: Preconditioner
    ) -> None:
        """Form the blocks, for weights δ, (n,), and E of every subdomain. Collective."""
        operator = preconditioner.operator
        self._M, self._torn = preconditioner, operator.torn
        on_interface = operator.on_interface
        with Lifetime() as owned:
            self._copies = owned.own(Copies(operator.torn, operator.interface, delta))
            E = [m.E[on] for m, on in zip(modes, on_interface, strict=True)]
            W = jump_fields(self._copies, E)
            counts = [E_i.shape[1] for E_i in E]
            self._near = owned.own(NearColumns(W, counts, operator.torn.comm))
            self.blocks: list[Array] = []

            def elements() -> Iterator[Array]:
                for i, W_i in enumerate(W.panels):
                    self.blocks.append(preconditioner.image(i, W_i))  # Y = (S + Y_Z Y_Zᵀ) W
                    yield W_i.overlap(self.blocks[i])

            self.galerkin_matrix = owned.own(self._near.sum(elements()))
            self._owned = owned.pop_all()

    def multiply(self, s: Array) -> Array:
        """Return M G s, (K,) → (m,). Collective."""
        near, copies = self._near.from_owners(s), self._copies
        t = np.zeros(self._torn.n)
        blocks = zip(self.blocks, self._near.blocks, strict=True)
        t[copies.dofs] = joined([Y @ near[columns] for Y, columns in blocks])
        return self._M.B_D @ t  # B_D Y s

    def restrict(self, r: Array) -> Array:
        """Return Gᵀ M r, (m,) → (K,). Collective."""
        w = (self._M.B_D.T @ r)[self._copies.dofs]  # w = B_Dᵀ r
        blocks = zip(self.blocks, self._copies.blocks, strict=True)
        return self._near.to_owners(joined([Y.T @ w[rows] for Y, rows in blocks]))

    def destroy(self) -> None:
        """Free star forests and matrix."""
        self._owned.close()


def _weight(torn: Torn, B_D: PETSc.Mat, q: str) -> PETSc.Vec:
    """Form the diagonal part of Q, (m,)."""
    weight = B_D.createVecLeft()
    if q == "identity":
        weight.set(1.0)
        return weight
    stiffness = B_D.createVecRight()
    stiffness.array[:] = torn.stiffness()
    indptr, indices, values = B_D.getValuesCSR()
    csr = (indptr, indices, values**2)
    squared = PETSc.Mat().createAIJ(B_D.getSizes(), csr=csr, comm=torn.A.comm)
    squared.mult(stiffness, weight)  # q = diag(B_D diag(k) B_Dᵀ)
    if q == "preconditioner":
        weight.scale(EPSILON)
    stiffness.destroy()
    squared.destroy()
    return weight
