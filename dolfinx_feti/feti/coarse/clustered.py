# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A large coarse system N x = b: conjugate gradients with a third level, clusters of subdomains.

.. math:: x_0 = Z A_1^{-1} Z^⊤ b, \qquad z = (I - Z A_1^{-1} (N Z)^⊤)\, D\, r, \qquad
          A_1 = Z^⊤ N Z

with small systems D that overlap (``schwarz``), and the rigid motions Z of each cluster of
subdomains as combinations of their columns: the method of the primal form, one level up. A process
holds its rows of N, Z and N Z, and its blocks; A₁ alone is gathered (``gathered``).

How exact has x to be? Its error e perturbs what V x corrects in the primal form, the preconditioned
residual z. In the energy norm, which the inner iterations know, that has to stay small beside z,

.. math:: \|V e\|_A = \|e\|_N ≤ ε \sqrt{r^⊤ z}.

The other solves serve a Krylov method whose right-hand sides b shrink, and the error of each stays
in its residual. So all are solved to the same size of error, and take fewer iterations each time
(Simoncini and Szyld 2003); but no error may be large beside its own right-hand side, or the
directions of the Krylov method are not conjugate any more, at last not even of positive energy,

.. math:: \|b - N x\| ≤ \min(τ \max \|b\|,\; δ \|b\|)

with the largest of the right-hand sides since the first one.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.coarse.gathered import SPREAD, GatheredSolver
from dolfinx_feti.feti.coarse.graph import CoupledSubdomains, coupled_subdomains
from dolfinx_feti.feti.coarse.schwarz import SHIFT, SchwarzBlocks
from dolfinx_feti.feti.subdomain.factors.protocol import Pivots
from dolfinx_feti.runtime.collective import total, total_of
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.petsc_options import inserted

__all__ = [
    "ClusteredSolver",
    "CoarseSolver",
    "create_coarse_solver",
    "number_of_clusters",
    "takes_clusters",
]

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

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

#: Share ε of the energy norm of what a solution corrects. The norm of the preconditioned residual
#: stands in for that of the error, which may be some ten times as large.
ENERGY = 0.003

#: The same of what Z A₁⁻¹ Zᵀ b lacks, for an initial guess: no correction takes that out at once.
START = 1e-5

#: Share τ of the largest right-hand side that a solve leaves.
TOLERANCE = 1e-9

#: Share δ of the present one that it leaves at most.
RELATIVE = 1e-3

#: Most iterations.
ITERATIONS = 500


class ClusteredSolver:
    """Iterative solver for a symmetric positive definite matrix, which stays distributed.

    Attributes:
        clusters: Number of clusters over all processes.
    """

    def __init__(self, N: PETSc.Mat, motions: Array, counts: Counts, *, prefix: str) -> None:
        """Find clusters, and invert blocks and A₁. Collective.

        Args:
            N: Matrix, (K, K); the caller destroys it after this.
            motions: Rigid motions as combinations of the columns of N, (own rows, k).
            counts: Rows of each subdomain of this process.
            prefix: Options prefix of the solver of A₁.

        Raises:
            LinAlgError: A diagonal block is not positive definite; on all processes.
            SetUpError: A₁ could not be factored; on all processes.
        """
        self._N, self._comm = N, N.comm.tompi4py()
        graph = coupled_subdomains(N, counts)
        k = motions.shape[1]
        further = N.getSize()[0] > k * (len(graph.starts) - 1)
        self._schwarz = SchwarzBlocks(N, graph, OTHERS if further else 0)
        cluster = _clusters(N, graph, prefix)
        self.clusters = 1 + self._comm.allreduce(int(cluster.max(initial=-1)), op=MPI.MAX)
        self._Z = _columns(N, motions, np.repeat(cluster, counts), self.clusters)
        self._NZ = N.matMult(self._Z)
        A_1 = self._Z.transposeMatMult(self._NZ)  # A₁ = Zᵀ N Z
        blocks = np.full(A_1.getLocalSize()[0] // max(1, k), k, dtype=np.int64)
        self._third = GatheredSolver(A_1, prefix=prefix, symmetric=True, zero=SHIFT, counts=blocks)
        self._e, self._c = A_1.createVecs()
        A_1.destroy()
        self._y, self._largest = N.createVecRight(), 0.0
        self._ksp = PETSc.KSP().create(N.comm)
        self._ksp.setOptionsPrefix(prefix)
        self._ksp.setOperators(N)
        self._ksp.setType(PETSc.KSP.Type.CG)
        self._ksp.setInitialGuessNonzero(True)
        self._ksp.getPC().setType(PETSc.PC.Type.PYTHON)
        self._ksp.getPC().setPythonContext(SimpleNamespace(apply=self._precondition))
        with inserted(prefix, {"ksp_cg_single_reduction": True}):
            self._ksp.setFromOptions()

    def solve(
        self,
        b: PETSc.Vec,
        x: PETSc.Vec,
        *,
        first: bool = False,
        addend: float | None = None,
        energy: float | None = None,
    ) -> float:
        """Solve N x = b, both in N's own layout; where the solver fails, x is NaN.

        ``first`` tells that the largest right-hand side is to be found anew, from b on. With an
        ``energy``, this process's part of the rᵀ z of what x corrects, that sets the error, or the
        energy of x itself if it is not positive.

        Returns:
            The sum of the ``addend`` of all processes, 0 if there are none.
        """
        with event("FETICoarseSolve"):
            own = np.array([b.array_r @ b.array_r, addend or 0.0, energy or 0.0])
            square, sum_, squared = total_of(own, self._comm)
            size, norm = float(np.sqrt(square)), PETSc.KSP.NormType.UNPRECONDITIONED
            self._largest = max(0.0 if first else self._largest, size)
            error = min(TOLERANCE * self._largest, RELATIVE * size)
            self._on_clusters(self._Z, b, x)  # x₀ = Z A₁⁻¹ Zᵀ b
            if energy is not None:
                norm = PETSc.KSP.NormType.NATURAL
                error = ENERGY * float(np.sqrt(max(0.0, squared)))
                if error == 0.0:
                    error = START * float(np.sqrt(self._energy_left(b, x)))
            self._iterate(b, x, error, norm)
        return float(sum_)

    def _on_clusters(self, X: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Compute x = Z A₁⁻¹ Xᵀ b. Collective."""
        X.multTranspose(b, self._e)
        self._third.solve(self._e, self._c)
        self._Z.mult(self._c, x)

    def _energy_left(self, b: PETSc.Vec, x: PETSc.Vec) -> float:
        """Return ρᵀ z for the residual ρ = b − N x that x₀ leaves. Collective."""
        ρ, z = self._N.createVecs()
        self._N.mult(x, ρ)
        ρ.aypx(-1.0, b)
        self._precondition(None, ρ, z)
        squared = max(0.0, float(ρ.dot(z)))
        for owned in (ρ, z):
            owned.destroy()
        return squared

    def _iterate(self, b: PETSc.Vec, x: PETSc.Vec, error: float, norm: int) -> None:
        """Solve N x = b from x₀ on, up to an error in a norm; NaN if it fails. Collective."""
        self._ksp.setNormType(norm)
        self._ksp.setTolerances(rtol=0.0, atol=error, max_it=ITERATIONS)
        self._ksp.solve(b, x)
        if self._ksp.getConvergedReason() < 0:
            x.set(np.nan)

    def _precondition(self, _pc: PETSc.PC | None, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Compute z = (I − Z A₁⁻¹ (N Z)ᵀ) D r."""
        self._schwarz.apply(r, self._y)  # y = D r
        self._on_clusters(self._NZ, self._y, z)
        z.aypx(-1.0, self._y)  # z = y − Z A₁⁻¹ (N Z)ᵀ y

    def is_definite(self) -> bool:
        """Tell whether a random system is solved, with positive curvatures alone. Collective."""
        b, x = self._N.createVecs()
        x.array[:] = np.random.default_rng(self._comm.rank).standard_normal(len(x.array_r))
        self._N.mult(x, b)  # in the range of N, where columns depend
        self._on_clusters(self._Z, b, x)
        self._iterate(b, x, RELATIVE * b.norm(), PETSc.KSP.NormType.UNPRECONDITIONED)
        for owned in (b, x):
            owned.destroy()
        return self._ksp.getConvergedReason() > 0 and not self._third.pivots().negative

    def pivots(self) -> Pivots:
        """Return that none is negative or zero: :meth:`is_definite` would have met it."""
        return Pivots(0, 0)

    def memory(self) -> float:
        """Return the memory of D, Z, N Z and A₁ over all processes in MiB. Collective."""
        entries = sum(M.getInfo()["nz_used"] for M in (self._Z, self._NZ))
        own = self._schwarz.nbytes + 12.0 * entries
        return total(own, self._comm) / 2**20 + (self._third.memory() or 0.0)

    def __str__(self) -> str:
        """Say how it solves."""
        return f"CG on {self.clusters} clusters of subdomains"

    def destroy(self) -> None:
        """Free solvers, matrices and vectors."""
        solvers = (self._ksp, self._third, self._schwarz)
        owned = (*solvers, self._Z, self._NZ, self._e, self._c, self._y)
        for each in owned:
            each.destroy()


CoarseSolver = GatheredSolver | ClusteredSolver


def create_coarse_solver(
    N: PETSc.Mat,
    counts: Counts,
    motions: Callable[[], Array],
    *,
    prefix: str,
    symmetric: bool,
    definite: bool = False,
    zero: float | None = None,
) -> CoarseSolver:
    """Create the solver for a coarse matrix of its size. Collective.

    Args:
        N: Coarse matrix, (K, K); the caller destroys it after the solver.
        counts: Rows of each subdomain of this process.
        motions: Returns the rigid motions as combinations of the columns, (own rows, k).
        prefix: Options prefix of the solver; with a type of KSP or PC among them N is gathered.
        symmetric: Whether N is symmetric.
        definite: Whether N is known to be positive semi-definite; else a random system is solved.
        zero: See :class:`~dolfinx_feti.feti.coarse.gathered.GatheredSolver`.

    Raises:
        SetUpError: The options are wrong, or a factorisation failed; on all processes.
    """
    own, rows = PETSc.Options(prefix), N.getSize()[0]
    subdomains = N.comm.tompi4py().allreduce(np.count_nonzero(counts))
    large = takes_clusters(rows, N.comm.size, rows / max(1, subdomains))
    if symmetric and large and not any(map(own.hasName, ("ksp_type", "pc_type"))):
        with suppress(np.linalg.LinAlgError):
            solver = ClusteredSolver(N, motions(), counts, prefix=prefix)
            if definite or solver.is_definite():
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


def _clusters(N: PETSc.Mat, graph: CoupledSubdomains, prefix: str) -> npt.NDArray[np.int32]:
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


def _columns(
    N: PETSc.Mat, motions: Array, cluster: npt.NDArray[np.int32], clusters: int
) -> PETSc.Mat:
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
