# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A large coarse system N x = b: conjugate gradients with a third level, clusters of subdomains.

.. math:: x_0 = Z A_1^{-1} Z^⊤ b, \qquad z = (I - Z A_1^{-1} (N Z)^⊤)\, D\, r, \qquad
          A_1 = Z^⊤ N Z

with small systems D that overlap (``schwarz``), and the rigid motions Z of each cluster as
combinations of its subdomains' columns. A₁ alone is gathered (``gathered``). Where the iterations
stagnate, do not see a positive definite matrix, or meet NaN, a factor of N solves for good.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from types import SimpleNamespace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.coarse.gathered import SPREAD, GatheredSolver
from dolfinx_feti.feti.coarse.near import CoupledSubdomains, coupled_subdomains
from dolfinx_feti.feti.coarse.schwarz import SHIFT, SchwarzBlocks
from dolfinx_feti.feti.solution import CURVATURE
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots
from dolfinx_feti.runtime.arrays import Array, Indices, Numbers
from dolfinx_feti.runtime.collective import total
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.runtime.petsc_options import inserted

__all__ = [
    "ClusteredSolver",
    "CoarseSolver",
    "create_coarse_solver",
    "number_of_clusters",
    "takes_clusters",
]

Reason = PETSc.KSP.ConvergedReason

#: Rows above which N is not gathered any more; and the multiple of them where its inverse can be
#: spread over so many processes that a solve, a collective call and K²/P numbers, is over before
#: the inner iterations have waited for each other.
LARGE, WIDE = 20_000, 4

#: Columns of a subdomain, on average, up to which rigid motions are most of them. Clusters see
#: nothing of further ones: inner iterations are five times as many, and pay for themselves from so
#: many processes on that each has at most FEW rows, as a factor is of one group of them; or above
#: HUGE rows, where a factor would take gigabytes.
RIGID, FEW, HUGE = 10.0, 1500, 100_000

#: Subdomains of a cluster: FEWEST as long as the inverse of A₁ is spread over the processes, beyond
#: that MOST.
FEWEST, MOST = 8, 64

#: Subdomains in a small system beside its own one, if there are more than rigid motions in N: both
#: sides of an interface have columns for what is soft there, and so have nearly the same ones.
OTHERS = 8

#: Share of a right-hand side that a solve leaves. With more of it, directions of the Krylov method
#: are not conjugate, and soft parts beside stiff ones are off by the quotient of stiffnesses.
TOLERANCE = 1e-9

#: Most iterations: with more of them a factor is faster.
ITERATIONS = 100

logger = logging.getLogger("dolfinx_feti")


class ClusteredSolver:
    """Iterative solver for a symmetric positive definite matrix, which stays distributed.

    Attributes:
        clusters: Number of clusters over all processes.
        factor: What solves since the iterations have failed; None before.
    """

    def __init__(
        self,
        N: PETSc.Mat,
        motions: Array,
        counts: Numbers,
        *,
        prefix: str,
        zero: float | None = None,
    ) -> None:
        """Find clusters, and invert blocks and A₁. Collective.

        Args:
            N: Matrix, (K, K); the caller destroys it after this.
            motions: Rigid motions as combinations of the columns of N, (own rows, k).
            counts: Rows of each subdomain of this process.
            prefix: Options prefix of the solver of A₁.
            zero: See :class:`~dolfinx_feti.feti.coarse.gathered.GatheredSolver`, for the factor.

        Raises:
            LinAlgError: A diagonal block is not positive definite; on all processes.
            SetUpError: A₁ could not be factored; on all processes.
        """
        self._N, self._comm = N, N.comm.tompi4py()
        self.factor: GatheredSolver | None = None
        self._create_factor = partial(
            GatheredSolver, N, prefix=prefix, symmetric=True, zero=zero, counts=counts
        )
        graph = coupled_subdomains(N, counts)
        k = motions.shape[1]
        further = N.getSize()[0] > k * (len(graph.starts) - 1)
        with Lifetime() as owned:
            own = owned.own
            self._schwarz = own(SchwarzBlocks(N, graph, OTHERS if further else 0))
            cluster = _clusters(N, graph, prefix)
            self.clusters = 1 + self._comm.allreduce(int(cluster.max(initial=-1)), op=MPI.MAX)
            self._Z = own(_columns(N, motions, np.repeat(cluster, counts), self.clusters))
            self._NZ = own(N.matMult(self._Z))
            A_1 = own(self._Z.transposeMatMult(self._NZ))  # A₁ = Zᵀ N Z
            blocks = np.full(A_1.getLocalSize()[0] // max(1, k), k, dtype=np.int64)
            self._third = own(
                GatheredSolver(A_1, prefix=prefix, symmetric=True, zero=SHIFT, counts=blocks)
            )
            self._e, self._c = (own(vector) for vector in A_1.createVecs())
            self._y = own(N.createVecRight())
            self._ksp = own(PETSc.KSP().create(N.comm))
            self._ksp.setOptionsPrefix(prefix)
            self._ksp.setOperators(N)
            self._ksp.setType(PETSc.KSP.Type.CG)
            self._ksp.setInitialGuessNonzero(True)
            self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
            self._ksp.setTolerances(rtol=TOLERANCE, atol=0.0, max_it=ITERATIONS)
            self._ksp.getPC().setType(PETSc.PC.Type.PYTHON)
            self._ksp.getPC().setPythonContext(SimpleNamespace(apply=self._precondition))
            with inserted(prefix, {"ksp_cg_single_reduction": True}):
                self._ksp.setFromOptions()
            self._owned = owned.pop_all()

    def solve(self, b: PETSc.Vec, x: PETSc.Vec, addend: float = 0.0) -> float:
        """Solve N x = b, both in N's own layout; by a factor from the first failure on. Collective.

        Returns:
            The sum of the ``addend`` of all processes.

        Raises:
            SetUpError: N could not be factored; on all processes.
        """
        if self.factor is None:
            with event("FETICoarseSolve"):
                reason = self._iterate(b, x)
            if reason > 0:
                return total(addend, self._comm)
            self.hand_over(reason)
        assert self.factor is not None
        return self.factor.solve(b, x, addend)

    def hand_over(self, reason: int) -> None:
        """Let a factor solve from now on, since the iterations have ended so. Collective.

        Raises:
            SetUpError: N could not be factored; on all processes.
        """
        self._owned.close()
        self.factor = self._create_factor()
        if self._comm.rank == 0:
            text = "The coarse problem of %d rows is factored, as its iterations ended with reason "
            logger.warning(text + "%d after %d.", self._N.getSize()[0], reason, ITERATIONS)

    def _on_clusters(self, X: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Compute x = Z A₁⁻¹ Xᵀ b. Collective."""
        X.multTranspose(b, self._e)
        self._third.solve(self._e, self._c)
        self._Z.mult(self._c, x)

    def _iterate(self, b: PETSc.Vec, x: PETSc.Vec) -> int:
        """Solve N x = b by conjugate gradients; return the converged reason. Collective."""
        self._on_clusters(self._Z, b, x)  # x₀ = Z A₁⁻¹ Zᵀ b
        self._ksp.solve(b, x)
        return int(self._ksp.getConvergedReason())

    def _precondition(self, _pc: PETSc.PC | None, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Compute z = (I − Z A₁⁻¹ (N Z)ᵀ) D r."""
        self._schwarz.apply(r, self._y)  # y = D r
        self._on_clusters(self._NZ, self._y, z)
        z.aypx(-1.0, self._y)  # z = y − Z A₁⁻¹ (N Z)ᵀ y

    def trial(self) -> int:
        """Solve a random system; return the converged reason, negative if N is not definite."""
        b, x = self._N.createVecs()
        x.array[:] = np.random.default_rng(self._comm.rank).standard_normal(len(x.array_r))
        self._N.mult(x, b)  # in the range of N, where columns depend
        reason = self._iterate(b, x)
        for owned in (b, x):
            owned.destroy()
        indefinite = self._third.pivots().negative
        return int(Reason.DIVERGED_INDEFINITE_MAT) if indefinite else reason

    def pivots(self) -> Pivots:
        """Return numbers of negative and zero pivots; :meth:`trial` has found none, or a factor."""
        return Pivots(0, 0) if self.factor is None else self.factor.pivots()

    def memory(self) -> float | None:
        """Return the memory of D, Z, N Z and A₁, or of the factor, in MiB. Collective."""
        if self.factor is not None:
            return self.factor.memory()
        entries = sum(M.getInfo()["nz_used"] for M in (self._Z, self._NZ))
        own = self._schwarz.nbytes + 12.0 * entries
        return total(own, self._comm) / 2**20 + (self._third.memory() or 0.0)

    def __str__(self) -> str:
        """Say how it solves."""
        clusters = f"CG on {self.clusters} clusters of subdomains"
        return clusters if self.factor is None else f"{self.factor}, as {clusters} has failed"

    def destroy(self) -> None:
        """Free solvers, matrices and vectors."""
        self._owned.close()
        if self.factor is not None:
            self.factor.destroy()


CoarseSolver = GatheredSolver | ClusteredSolver


def create_coarse_solver(
    N: PETSc.Mat,
    counts: Numbers,
    motions: Callable[[], Array],
    *,
    prefix: str,
    symmetric: bool,
    zero: float | None = None,
) -> CoarseSolver:
    """Create the solver for a coarse matrix of its size. Collective.

    Args:
        N: Coarse matrix, (K, K); the caller destroys it after the solver.
        counts: Rows of each subdomain of this process.
        motions: Returns the rigid motions as combinations of the columns, (own rows, k).
        prefix: Options prefix of the solver; with a type of KSP or PC among them N is gathered.
        symmetric: Whether N is symmetric.
        zero: See :class:`~dolfinx_feti.feti.coarse.gathered.GatheredSolver`.

    Raises:
        SetUpError: The options are wrong, or a factorisation failed; on all processes.
    """
    own, rows = PETSc.Options(prefix), N.getSize()[0]
    subdomains = N.comm.tompi4py().allreduce(np.count_nonzero(counts))
    large = takes_clusters(rows, N.comm.size, rows / max(1, subdomains))
    if symmetric and large and not any(map(own.hasName, ("ksp_type", "pc_type"))):
        with suppress(np.linalg.LinAlgError):
            solver = ClusteredSolver(N, motions(), counts, prefix=prefix, zero=zero)
            reason = solver.trial()
            if reason not in CURVATURE:
                if reason < 0:
                    solver.hand_over(reason)
                return solver
            solver.destroy()
    return GatheredSolver(N, prefix=prefix, symmetric=symmetric, zero=zero, counts=counts)


def takes_clusters(rows: int, processes: int, columns: float) -> bool:
    """Tell whether the third level solves with a definite matrix, and not a factor or inverse.

    Args:
        rows: K.
        processes: Number of processes.
        columns: Columns of a subdomain, on average.
    """
    pays = columns <= RIGID or rows <= FEW * processes or rows > HUGE
    return pays and rows > LARGE * (WIDE if rows <= SPREAD * processes else 1)


def number_of_clusters(subdomains: int, processes: int) -> int:
    """Return the number of clusters of so many subdomains, with six columns each."""
    spread = SPREAD * processes // 6
    return max(1, subdomains // MOST, min(subdomains // FEWEST, spread))


def _clusters(N: PETSc.Mat, graph: CoupledSubdomains, prefix: str) -> Indices:
    """Return the cluster of each subdomain of this process, (subdomains,). Collective."""
    indptr, indices, n = graph.indptr, graph.indices, len(graph.starts) - 1
    sizes = (len(indptr) - 1, n)
    csr = (indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), np.ones(len(indices)))
    adjacency = PETSc.Mat().createAIJ((sizes, sizes), csr=csr, comm=N.comm)
    adjacency.convert("mpiadj")
    partitioning = PETSc.MatPartitioning().create(N.comm)
    partitioning.setOptionsPrefix(prefix)
    partitioning.setAdjacency(adjacency)
    with inserted(prefix, {"mat_partitioning_nparts": number_of_clusters(n, N.comm.size)}):
        partitioning.setFromOptions()
    numbers = PETSc.IS()
    partitioning.apply(numbers)
    cluster = numbers.getIndices().copy()
    for owned in (numbers, partitioning, adjacency):
        owned.destroy()
    return cluster


def _columns(N: PETSc.Mat, motions: Array, cluster: Indices, clusters: int) -> PETSc.Mat:
    """Return Z, (K, k clusters), for the cluster of each own row, (own rows,)."""
    n, k = motions.shape
    indices = k * cluster[:, None] + np.arange(k)
    csr = (
        np.arange(0, n * k + 1, k, dtype=PETSc.IntType),
        indices.ravel().astype(PETSc.IntType),
        motions.ravel(),
    )
    own = clusters // N.comm.size + (N.comm.rank < clusters % N.comm.size)  # of A₁'s rows
    sizes = (N.getSizes()[0], (k * own, k * clusters))
    return PETSc.Mat().createAIJ(sizes, csr=csr, comm=N.comm)
