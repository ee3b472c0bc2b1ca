# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Problems torn by hand: bricks of multilinear elements, known in full on every process.

They are assembled without dolfinx. Their subdomains are the same on any number of processes. A
process may have no subdomain.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse
from collective import COMM, agree, equal, whole

import dolfinx_feti

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]

YOUNG = 210.0
POISSON = 0.3


@dataclass(frozen=True, slots=True)
class HandTorn:
    """A torn problem.

    Attributes:
        A: The torn matrix; each process has its share of the subdomains, in order.
        K: Local matrices of all subdomains, dense, (n_i, n_i) each.
        dofs: Global dof of each row of each local matrix, (n_i,) each.
        x: Coordinates of the nodes, (nodes, dim).
        modes: Kernel of the problem without Dirichlet conditions, (dofs, n_modes).
        dirichlet: Mask of the dofs with a prescribed value, (dofs,).
        local: The sequential matrix of this process, from which ``A`` is created.
    """

    A: PETSc.Mat
    K: list[Array]
    dofs: list[Indices]
    x: Array
    modes: Array
    dirichlet: Mask
    local: PETSc.Mat

    @property
    def K_torn(self) -> Array:
        """Block-diagonal K, (n, n)."""
        return scipy.sparse.block_diag([*self.K, scipy.sparse.coo_array((0, 0))]).toarray()

    @property
    def to_global(self) -> Indices:
        """Global dof of each torn dof, (n,)."""
        return np.concatenate(self.dofs)

    @property
    def T(self) -> Array:
        """T, which copies each dof to its subdomains, (n, dofs)."""
        return np.eye(len(self.dirichlet))[self.to_global]

    @property
    def matrix(self) -> Array:
        """The assembled matrix Tᵀ K T, (dofs, dofs)."""
        return self.T.T @ self.K_torn @ self.T

    @property
    def free_matrix(self) -> Array:
        """The assembled matrix on the dofs without a prescribed value."""
        return self.matrix[np.ix_(~self.dirichlet, ~self.dirichlet)]

    @property
    def n_negative(self) -> int:
        """Number of negative eigenvalues of :attr:`free_matrix`."""
        return np.count_nonzero(np.linalg.eigvalsh(self.free_matrix) < 0.0)

    def solve(self, b: Array) -> Array:
        """Solve the assembled problem; on Dirichlet dofs ``b`` has the prescribed values."""
        K = self.matrix
        x = np.where(self.dirichlet, b, 0.0)
        free = ~self.dirichlet
        x[free] = np.linalg.solve(K[np.ix_(free, free)], (b - K @ x)[free])
        return x

    def vector(self, values: Array) -> PETSc.Vec:
        """Create a vector of PETSc from the values of all dofs, (dofs,); the caller destroys it."""
        b = self.A.createVecLeft()
        b.array[:] = values[slice(*b.getOwnershipRange())]
        return b

    def destroy(self) -> None:
        """Free the matrices."""
        self.A.destroy()
        self.local.destroy()


#: Changes the local matrices K in place. Arguments: K and the dofs of their rows.
Change = Callable[[list[Array], list[Indices]], None]


def each_matrix(alter: Callable[[Array, np.random.Generator], None]) -> Change:
    """Return a change that applies ``alter(K_i, rng)`` to each local matrix in place."""

    def change(K: list[Array], _dofs: object) -> None:
        rng = np.random.default_rng(1986)
        for K_i in K:
            alter(K_i, rng)

    return change


def softened(share: float) -> Change:
    """Subtract a share of the largest entry from the diagonal: subdomains, or the body, buckle."""

    def alter(K_i: Array, _rng: object) -> None:
        K_i -= share * np.abs(K_i).max() * np.eye(len(K_i))

    return each_matrix(alter)


def scaled_diagonal(factor: float) -> Change:
    """Multiply the diagonal of each local matrix: tension above one, compression below."""

    def alter(K_i: Array, _rng: object) -> None:
        np.fill_diagonal(K_i, factor * K_i.diagonal())

    return each_matrix(alter)


def unsymmetric(share: float, *, skew: bool = False) -> Change:
    """Add random entries in the pattern, a share of the largest one; skew ones leave K + Kᵀ."""

    def alter(K_i: Array, rng: np.random.Generator) -> None:
        X = np.where(K_i != 0.0, rng.standard_normal(K_i.shape), 0.0)
        K_i += share * np.abs(K_i).max() * (X - X.T if skew else X)

    return each_matrix(alter)


def one_sided(share: float) -> Change:
    """Add random entries below the diagonal where the matrix has none: the pattern is one-sided."""

    def alter(K_i: Array, rng: np.random.Generator) -> None:
        X = rng.standard_normal(K_i.shape)
        is_new = (rng.random(K_i.shape) < 0.01) & (K_i == 0.0)
        K_i += share * np.abs(K_i).max() * np.tril(np.where(is_new, X, 0.0))

    return each_matrix(alter)


def grid(
    subdomains: Sequence[int],
    cells: Sequence[int],
    *,
    components: int = 1,
    fixed: Callable[[Array], Mask] | None = None,
    change: Change | None = None,
    stiffness: Callable[[int], float] = lambda i: 1.0,
    modes: int | None = None,
) -> HandTorn:
    """Tear a brick into subdomains, in one to three dimensions.

    Args:
        subdomains: Number of subdomains along each axis.
        cells: Number of cells of a subdomain along each axis; the edges of a cell are one.
        components: One for the Laplace equation, the dimension for elasticity.
        fixed: Marks the Dirichlet nodes, (nodes, dim) → (nodes,), or their components, (nodes,
            components); those with x₀ = 0 if not given.
        change: Changes the local matrices in place.
        stiffness: Factor of the matrix of subdomain i.
        modes: Number of modes of the kernel that are attached; all if not given.
    """
    shape = [s * n + 1 for s, n in zip(subdomains, cells, strict=True)]
    x = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    x = x.reshape(-1, len(shape)).astype(np.float64)
    pattern, K_0 = brick(cells, components)
    K = []
    dofs = []
    for i, corner in enumerate(itertools.product(*map(range, subdomains))):
        inside = np.ix_(*[c * n + np.arange(n + 1) for c, n in zip(corner, cells, strict=True)])
        nodes = np.arange(len(x)).reshape(shape)[inside].ravel()
        dofs.append(dofs_of(nodes, components))
        K.append(stiffness(i) * K_0)
    if change is not None:
        change(K, dofs)
    mark = (x[:, 0] == 0.0) if fixed is None else fixed(x)
    mask = np.broadcast_to(mark.reshape(len(x), -1), (len(x), components)).ravel()
    return tear(K, dofs, x, kernel(x, components), mask, pattern=pattern, n_modes=modes)


def nowhere(x: Array) -> Mask:
    """Mark no node."""
    return np.zeros(len(x), dtype=bool)


def origin(x: Array) -> Mask:
    """Mark the node at the origin."""
    return np.all(x == 0.0, axis=1)


def edge(x: Array) -> Mask:
    """Mark the nodes with x₀ = x₁ = 0."""
    return np.all(x[:, :2] == 0.0, axis=1)


def face(x: Array) -> Mask:
    """Mark the nodes with x₀ = 0."""
    return x[:, 0] == 0.0


def components_at(where: Callable[[Array], Mask], *which: int) -> Callable[[Array], Mask]:
    """Return a marker of some components of the nodes that ``where`` marks."""
    return lambda x: where(x)[:, None] & np.isin(np.arange(x.shape[1]), which)


def dofs_of(nodes: Indices, components: int) -> Indices:
    """Return all dofs of some nodes, node by node, (nodes · components,)."""
    return (nodes[:, None] * components + np.arange(components)).ravel()


def tear(
    K: list[Array],
    dofs: list[Indices],
    x: Array,
    modes: Array,
    dirichlet: Mask,
    *,
    pattern: Array | None = None,
    n_modes: int | None = None,
    only_nonzeros: bool = False,
) -> HandTorn:
    """Distribute subdomains over the processes and wrap them as a torn matrix.

    Args:
        K: Matrix of each subdomain, (n_i, n_i).
        dofs: Global dofs of its rows, (n_i,).
        x: Coordinates of the nodes, (nodes, dim).
        modes: Kernel without Dirichlet conditions, (dofs, n_modes).
        dirichlet: Mask of the prescribed dofs, (dofs,).
        pattern: Non-zero where each matrix stores an entry; full if not given.
        n_modes: Number of modes that are attached; all if not given.
        only_nonzeros: Whether a matrix stores only its entries that are not zero.
    """
    bs = len(dirichlet) // len(x)
    n = len(dirichlet)
    mine = own_subdomains(len(K))
    every = [K_i != 0.0 if only_nonzeros else np.ones_like(K_i) for K_i in K]
    local = block_matrix([(K[i], every[i] if pattern is None else pattern) for i in mine], bs)
    blocks = [dofs[i][::bs] // bs for i in mine]
    ends = [len(x) * (COMM.rank + j) // COMM.size * bs for j in (0, 1)]
    A = dolfinx_feti.create_torn_matrix(
        local,
        np.concatenate([*blocks, np.zeros(0, dtype=np.int64)]),
        (ends[1] - ends[0], n),
        comm=COMM,
        dirichlet=np.flatnonzero(dirichlet[slice(*ends)]) + ends[0],
    )
    parts = [mode[slice(*ends)].copy() for mode in modes.T[:n_modes]]  # orthonormalised in place
    vectors = [PETSc.Vec().createWithArray(part, (len(part), n), comm=COMM) for part in parts]
    dolfinx_feti.set_near_kernel(A, vectors, x[ends[0] // bs : ends[1] // bs])
    for vector in vectors:
        vector.destroy()
    return HandTorn(A, K, dofs, x, modes, dirichlet, local)


def subdomains_of(rank: int, count: int) -> list[int]:
    """Return the numbers of the subdomains of a process, out of ``count``; there may be none."""
    return [i for i in range(count) if i * COMM.size // count == rank]


def own_subdomains(count: int) -> list[int]:
    """Return the numbers of the subdomains of this process, out of ``count``."""
    return subdomains_of(COMM.rank, count)


def brick(
    cells: Sequence[int],
    components: int,
    stiffness: Callable[[tuple[int, ...]], float] = lambda cell: 1.0,
) -> tuple[Array, Array]:
    """Assemble a brick of unit cells; return the pattern of its matrix and the matrix, (n, n)."""
    number = np.arange(np.prod(np.add(cells, 1))).reshape(np.add(cells, 1))
    every = list(itertools.product(*map(range, cells)))
    nodes = [number[tuple(slice(c, c + 2) for c in cell)].ravel() for cell in every]
    K_e = element(len(cells), components)
    return assembled(nodes, [stiffness(cell) * K_e for cell in every], components)


def assembled(
    cells: Sequence[Indices], matrices: Sequence[Array], components: int
) -> tuple[Array, Array]:
    """Assemble the matrices of cells.

    Args:
        cells: Nodes of each cell, (nodes of a cell,).
        matrices: Matrix of each cell, (dofs of a cell, dofs of a cell).
        components: Number of components of a node.

    Returns:
        Pattern of the assembled matrix, with ones where it may have entries, and the matrix,
        (n, n) each.
    """
    size = (1 + max(nodes.max() for nodes in cells)) * components
    K = np.zeros((size, size))
    pattern = np.zeros((size, size))
    for nodes, K_e in zip(cells, matrices, strict=True):
        rows = dofs_of(nodes, components)
        K[np.ix_(rows, rows)] += K_e
        pattern[np.ix_(rows, rows)] = 1.0
    return pattern, K


def element(dim: int, components: int) -> Array:
    """Return the stiffness of a unit cell with multilinear shape functions, (dofs, dofs).

    These are products over the axes, and so are their integrals.
    """
    M = np.array([[2, 1], [1, 2]]) / 6
    K = np.array([[1, -1], [-1, 1]])  # ∫ φ_a φ_b, ∫ φ_a' φ_b'
    D = np.array([[-1, -1], [1, 1]]) / 2  # ∫ φ_a' φ_b

    def product(i: int, j: int) -> Array:
        one_axis = {(False, False): M, (True, False): D, (False, True): D.T, (True, True): K}
        factors = [one_axis[k == i, k == j] for k in range(dim)]
        return functools.reduce(np.kron, factors, np.ones((1, 1)))

    G = np.array([[product(i, j) for j in range(dim)] for i in range(dim)])
    return stiffness_of(G, components)


def stiffness_of(G: Array, components: int, nu: float = POISSON) -> Array:
    """Return the stiffness from G = ∫ ∂_i φ_a ∂_j φ_b, (dim, dim, nodes, nodes).

    It is that of ∇φ·∇φ for one component, and that of 2μ ε:ε + λ (div u)² for elasticity.
    """
    laplace = np.einsum("iiab->ab", G)
    if components == 1:
        return laplace
    mu = YOUNG / (2 * (1 + nu))
    lmbda = YOUNG * nu / ((1 + nu) * (1 - 2 * nu))
    K = mu * np.einsum("ab,ij->aibj", laplace, np.eye(components))
    K += mu * np.einsum("jiab->aibj", G) + lmbda * np.einsum("ijab->aibj", G)
    return K.reshape(2 * [len(laplace) * components])


def kernel(x: Array, components: int) -> Array:
    """Return the constants and, for elasticity, the rotations at the nodes, (dofs, modes)."""
    modes = [np.tile(unit, len(x)) for unit in np.eye(components)]
    if components > 1:
        for i, j in itertools.combinations(range(components), 2):
            spin = np.zeros((components, components))
            spin[i, j] = 1.0
            spin[j, i] = -1.0
            modes.append((x @ spin.T).ravel())
    return np.column_stack(modes)


def block_matrix(blocks: list[tuple[Array, Array]], bs: int) -> PETSc.Mat:
    """Create a sequential matrix from diagonal blocks (values, pattern), (n_i, n_i) each."""
    parts = [scipy.sparse.coo_array((0, 0))]
    for values, pattern in blocks:
        rows, columns = np.nonzero((pattern != 0.0) | (values != 0.0))
        parts.append(scipy.sparse.coo_array((values[rows, columns], (rows, columns)), values.shape))
    return aij(scipy.sparse.block_diag(parts, format="csr"), bs)


def aij(K: scipy.sparse.csr_array, bs: int = 1) -> PETSc.Mat:
    """Create a sequential matrix of PETSc; the caller destroys it."""
    csr = K.indptr.astype(PETSc.IntType), K.indices.astype(PETSc.IntType), K.data
    return PETSc.Mat().createAIJ(K.shape, bsize=bs, csr=csr, comm=PETSc.COMM_SELF)


def random_values(problem: HandTorn, seed: int = 101013) -> Array:
    """Return random loads and, on Dirichlet dofs, prescribed values, (dofs,)."""
    return np.random.default_rng(seed).standard_normal(len(problem.dirichlet))


def solve(ksp: PETSc.KSP, problem: HandTorn, values: Array) -> tuple[int, Array]:
    """Solve; return the converged reason and x of all processes, (dofs,)."""
    x = problem.A.createVecRight()
    ksp.solve(problem.vector(values), x)
    return ksp.getConvergedReason(), whole(x.array_r)


def solve_and_check(
    ksp: PETSc.KSP, problem: HandTorn, tolerance: float = 1e-8, values: Array | None = None
) -> dolfinx_feti.FETI:
    """Assert that a solve converges to the dense solution; return the FETI context."""
    values = random_values(problem) if values is None else values
    reason, x = solve(ksp, problem, values)
    agree(reason > 0, ksp.getPythonContext().message)
    equal(x, problem.solve(values), tolerance)
    return ksp.getPythonContext()
