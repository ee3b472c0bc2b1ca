# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The coarse problem of the dual formulation: G, the weight Q, and the factored coarse matrix N.

.. math:: G = B E, \qquad e = E^⊤ f, \qquad N = G^⊤ Q\, G + D

(eq. 43 of the paper) with the motions E of all subdomains, (n, N_c), which replace the kernels R,
and the multipliers, (m,). With them ``dual.system`` applies the projection

.. math:: P = I - Q\, G\, N^{-1} G^⊤

(eq. 44 of the paper, which has Q = I and D = 0). N, (N_c, N_c), is sparse and distributed by
subdomains. Q is I (``identity``), diag(q) (``diagonal``) or M + ε diag(q) (``preconditioner``) with

.. math:: q = \operatorname{diag}(B_D \operatorname{diag}(k)\, B_D^⊤).

If A has a null space Z = E Z_c, then N Z_c = 0, and N is made regular along Z_c.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.errors import SetUpError
from dolfinx_feti.feti.coarse.null_space import is_null_space, make_regular
from dolfinx_feti.feti.coarse.solver import CoarseSolver
from dolfinx_feti.feti.coarse.weighted_columns import WeightedColumns, compute_weighted_columns
from dolfinx_feti.feti.interface.gluing import Gluing
from dolfinx_feti.feti.preconditioners.base import Preconditioner
from dolfinx_feti.feti.subdomain.block_diagonal import (
    block_columns,
    block_diagonal,
    distributed_block_diagonal,
)
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.generalized_inverse import GeneralizedInverse
from dolfinx_feti.feti.subsolver_options import DirectOptions
from dolfinx_feti.runtime.arrays import Array, Indices, concatenate, consecutive_slices
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.null_space import read_null_space

Structure = PETSc.Mat.Structure

#: Share ε of the diagonal weight in Q = M + ε diag(q). M vanishes on G s if subdomains in a row
#: move in alternate directions; the second term makes Q definite there, and should change Q little
#: otherwise. On cubes with 8 and 64 subdomains, half and twice of it change the iterations by 7 %
#: at most. With 0.1 a nearly incompressible cube takes 544 iterations instead of 407, and with 1 a
#: compressible one takes 25 instead of 13.
DIAGONAL_SHARE = 0.01

NULL_SPACE_RESISTED = (
    "Single subdomains resist the null space of A, although their sum does not, and the coarse "
    "matrix of the dual formulation is regular along it: use feti_formulation primal."
)


@dataclass(frozen=True, slots=True)
class _SubdomainMotions:
    """The motions of one subdomain.

    Attributes:
        dofs: Torn dofs of the rows of E, (n_i,).
        E: The motions, (n_i, k_i).
        block: Their coarse dofs, as a slice of a coarse vector of this process, (n_c,).
    """

    dofs: Indices
    E: Array
    block: slice


class DualCoarseProblem:
    """E, G, Q and the factored N of one matrix.

    Attributes:
        G: B E, (m, N_c).
        q: Diagonal part of Q, (m,).
        MG: M G if M is a part of Q, else None.
        N: Gᵀ Q G + D, (N_c, N_c).
        D: Defect of the kernels, block-diagonal, (N_c, N_c).
        solver: Solver of N.
        n_c: Number of coarse dofs of this process.
        N_c: Number of coarse dofs over all processes.
        has_exact_kernel: Whether K E = 0 on all subdomains, so that D = 0.
    """

    def __init__(
        self,
        torn: Torn,
        gluing: Gluing,
        delta: Array,
        inverse: GeneralizedInverse,
        preconditioner: Preconditioner,
        *,
        weight: str,
        options: DirectOptions,
    ) -> None:
        """Assemble and factor the coarse matrix. Collective.

        Args:
            torn: The torn matrix.
            gluing: The constraints, with B.
            delta: Weight δ of every torn dof, (n,).
            inverse: K⁺, with E and D of each subdomain.
            preconditioner: M, with B_D.
            weight: Kind of Q: ``identity``, ``diagonal`` or ``preconditioner``.
            options: Options of the coarse solver.

        Raises:
            SetUpError: N could not be factored, or the null space of A is not in the span of E; on
                all processes.
        """
        comm = torn.comm
        modes = inverse.modes
        widths = [of_subdomain.E.shape[1] for of_subdomain in modes]
        self._torn = torn
        blocks = consecutive_slices(widths)
        self._motions = [
            _SubdomainMotions(K_i.dofs, K_i.modes.E, block)
            for K_i, block in zip(inverse.by_subdomain, blocks, strict=True)
        ]
        self.n_c = sum(widths)
        self.N_c = comm.allreduce(self.n_c)
        are_exact = all(of_subdomain.is_exact for of_subdomain in modes)
        self.has_exact_kernel = comm.allreduce(are_exact, op=MPI.LAND)
        self.MG: WeightedColumns | None = None
        with Lifetime() as owned:
            self.G = owned.own(self._product_with_motions(gluing.B))  # G = B E
            self.q = owned.own(_diagonal_weight(torn, preconditioner.B_D.matrix, weight))
            D = block_diagonal([of_subdomain.D for of_subdomain in modes if len(of_subdomain.D)])
            self.D = owned.own(distributed_block_diagonal(D, torn.A.comm))
            N = self._galerkin_matrix_of_diagonal()  # Gᵀ diag(q) G + D
            if weight == "preconditioner":
                self.MG, N = _add_weighted_columns(N, preconditioner, delta, inverse)  # + Gᵀ M G
                owned.own(self.MG)
            self.N = owned.own(N)
            self._make_regular_along_null_space()
            self.N.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self.solver = owned.own(
                CoarseSolver(
                    self.N,
                    options=options,
                    is_symmetric=True,
                    errors=preconditioner.operator.errors,
                    block_widths=np.array(widths, dtype=np.int64),
                )
            )
            self._s, self._e = (owned.own(vector) for vector in self.N.createVecs())
            self._owned = owned.pop_all()

    def _product_with_motions(self, B: PETSc.Mat) -> PETSc.Mat:
        """Return B E, (m, N_c); the caller destroys it. Collective."""
        E = block_columns(self._torn, [(motions.dofs, motions.E) for motions in self._motions])
        G = B.matMult(E)
        E.destroy()
        return G

    def _galerkin_matrix_of_diagonal(self) -> PETSc.Mat:
        """Return Gᵀ diag(q) G + D, (N_c, N_c); the caller destroys it. Collective."""
        weighted = self.G.copy()
        weighted.diagonalScale(L=self.q)  # diag(q) G
        N = self.G.transposeMatMult(weighted)
        weighted.destroy()
        N.axpy(1.0, self.D, structure=Structure.DIFFERENT_NONZERO_PATTERN)
        return N

    def _make_regular_along_null_space(self) -> None:
        """Make N regular along the null space Z of A that the user has given. Collective.

        Raises:
            SetUpError: Z is not in the span of E; on all processes.
        """
        Z = read_null_space(self._torn)
        Z_c = on_subdomains(lambda: self._amplitudes(Z), self._torn.comm)
        if not is_null_space(self.N, Z_c):
            raise SetUpError(NULL_SPACE_RESISTED)
        make_regular(self.N, Z_c)

    def solve(self, e: Array) -> Array:
        """Return N⁻¹ e, (n_c,) → (n_c,). Collective."""
        return self.solve_and_sum(e, 0.0)[0]

    def solve_and_sum(self, e: Array, addend: float) -> tuple[Array, float]:
        """Solve with N, and sum a number over the processes in the same message. Collective.

        Args:
            e: Right-hand side, (n_c,).
            addend: Number of this process.

        Returns:
            N⁻¹ e, (n_c,), and the sum, which costs no further reduction.
        """
        self._e.array[:] = e
        sum_of_addends = self.solver.solve(self._e, self._s, addend)
        return self._s.array_r.copy(), sum_of_addends

    def restrict(self, f: Array) -> Array:
        """Return the forces along the motions, e = Eᵀ f, (n,) → (n_c,)."""
        return concatenate([motions.E.T @ f[motions.dofs] for motions in self._motions])

    def prolong(self, s: Array) -> Array:
        """Return the displacement E s, (n_c,) → (n,)."""
        u = np.zeros(self._torn.n)
        for motions in self._motions:
            u[motions.dofs] = motions.E @ s[motions.block]  # E_i s_i
        return u

    def _amplitudes(self, Z: Array) -> Array:
        """Return Z_c with Z = E Z_c, (n_c, k), for fields Z on the torn dofs, (n, k)."""
        if not Z.size:
            return np.zeros((self.n_c, Z.shape[1]))
        return np.vstack(
            [np.linalg.pinv(motions.E) @ Z[motions.dofs] for motions in self._motions]  # E⁺ Z
        )

    def destroy(self) -> None:
        """Free matrices and solver."""
        self._owned.close()


def _add_weighted_columns(
    N: PETSc.Mat, preconditioner: Preconditioner, delta: Array, inverse: GeneralizedInverse
) -> tuple[WeightedColumns, PETSc.Mat]:
    """Compute M G, and add Gᵀ M G to a coarse matrix. Collective.

    Args:
        N: Coarse matrix without M, (N_c, N_c), which is destroyed.
        preconditioner: M, with B_D.
        delta: Weight δ of every torn dof, (n,).
        inverse: K⁺, with E of each subdomain.

    Returns:
        M G, and the sum N + Gᵀ M G, (N_c, N_c); the caller destroys both.
    """
    with Lifetime() as temporary, Lifetime() as results:
        temporary.own(N)
        MG, G_MG = compute_weighted_columns(preconditioner, delta, inverse)
        results.own(MG)
        results.own(G_MG)
        # Gᵀ M G couples more subdomains than N: N is added to it, and not vice versa.
        G_MG.axpy(1.0, N, structure=Structure.DIFFERENT_NONZERO_PATTERN)
        results.release()  # the caller owns them
    return MG, G_MG


def _diagonal_weight(torn: Torn, B_D: PETSc.Mat, weight: str) -> PETSc.Vec:
    """Return the diagonal part of Q: 1, q, or ε q. Collective.

    Args:
        torn: The torn matrix, with the stiffness k of each dof.
        B_D: Scaled jump operator, (m, n).
        weight: Kind of Q: ``identity``, ``diagonal`` or ``preconditioner``.

    Returns:
        The diagonal, (m,); the caller destroys it.
    """
    diagonal = B_D.createVecLeft()
    if weight == "identity":
        diagonal.set(1.0)
        return diagonal
    indptr, indices, values = B_D.getValuesCSR()
    csr = (indptr, indices, values**2)
    with Lifetime() as owned:
        k = owned.own(B_D.createVecRight())
        k.array[:] = torn.stiffness()
        squared = owned.own(PETSc.Mat().createAIJ(B_D.getSizes(), csr=csr, comm=torn.A.comm))
        squared.mult(k, diagonal)  # q = diag(B_D diag(k) B_Dᵀ)
    if weight == "preconditioner":
        diagonal.scale(DIAGONAL_SHARE)  # ε q
    return diagonal
