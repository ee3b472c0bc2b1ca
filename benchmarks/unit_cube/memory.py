# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Memory of a case of the cube, estimated before anything is set up.

The factors are by far the most of it. A decomposed cube has at most four kinds of subdomains, told
apart by how many of their faces lie on its surface; one of each kind is analysed symbolically, and
its figures are multiplied. Where the solver eliminates the interior dofs, the dense Schur
complements take the place of the factors of K. The coarse matrix couples a subdomain with the 26
around it, or with 124 if Q is the preconditioner; its factor is analysed with one dof in the place
of six modes. What grows with the cells, the non-zeros and the glued dofs was measured once
and is given below as bytes for each.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass
from functools import cache

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse

import dolfinx
import dolfinx.fem.petsc

from benchmarks.unit_cube.problem import create_problem
from dolfinx_feti.feti.subdomain.elimination import SMALL
from dolfinx_feti.feti.subdomain.matrices import DENSITY, LARGEST
from dolfinx_feti.feti.subdomain.sparse.fronts import Fronts, load_fronts
from dolfinx_feti.petsc_library import Rows

__all__ = ["Estimate", "estimate"]

Mask = npt.NDArray[np.bool_]

#: Bytes per process with everything imported.
PROCESS = 140e6

#: Bytes per tetrahedron in the mesh, the spaces and the functions, by degree.
TETRAHEDRON = {1: 600.0, 2: 3800.0}

#: Bytes per entry in the torn matrix, in the interface rows, and in a block that MUMPS factors.
ENTRY, ROW_ENTRY, BLOCK_ENTRY = 16.0, 12.0, 20.0

#: Bytes per glued dof in the jump operators and the coarse problem.
GLUED = 1500.0

#: Bytes per glued dof in the product of the preconditioner with G, for Q = preconditioner.
PRODUCT = 3000.0

#: Bytes per factor besides its entries.
FACTOR = 0.15e6

#: Bytes per entry in the factor of the coarse matrix, and in the copies of that matrix.
COARSE_FACTOR, COARSE_ENTRY = 12.0, 36.0

#: Modes of a subdomain in the coarse space.
MODES = 6


@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimate of a case.

    Attributes:
        mib: Memory [MiB].
        streamed: Size of the factors and dense blocks that an iteration reads [bytes].
    """

    mib: float
    streamed: float


@dataclass(frozen=True, slots=True)
class _Factor:
    """Figures of a symbolic factorisation: entries, and what it all takes [bytes]."""

    entries: float
    bytes: float


@dataclass(frozen=True, slots=True, eq=False)
class _Kind:
    """Subdomains of one kind: how many, the mask of their free dofs, modes in the kernel."""

    number: int
    free: Mask
    border: int


@cache
def estimate(
    *,
    degree: int,
    cells: int,
    subdomains: int,
    all_floating: bool,
    pc_type: str,
    coarse_q: str,
    interior: str,
    processes: int,
) -> Estimate:
    """Estimate a case from one subdomain of each kind, on this process alone.

    Args:
        degree: Of the displacements.
        cells: Cells along an edge of a subcube.
        subdomains: Subcubes along an edge of the cube.
        all_floating: Whether Dirichlet dofs stay in the local matrices.
        pc_type: Preconditioner.
        coarse_q: Weight of the projection.
        interior: Whether the interior dofs are kept or eliminated, as in the options.
        processes: Number of processes.
    """
    K, x = _subcube(degree, cells)
    surface = np.any((x == 0.0) | (x == 1.0), axis=1)
    count = subdomains**3
    kinds = [
        _Kind(number, ~_on_faces(x, fixed), 0 if any(fixed) else MODES)
        for fixed, number in _kinds(subdomains, all_floating).items()
    ]
    glued = {kind: np.count_nonzero(kind.free & surface) for kind in kinds}
    eliminated = _is_eliminated(interior, kinds, glued)
    total = processes * PROCESS + count * (24 * cells**3 * TETRAHEDRON[degree] + K.nnz * ENTRY)
    far = coarse_q == "preconditioner"
    total += _coarse(subdomains if all_floating else subdomains - 2, 2 if far else 1)
    each = GLUED + PRODUCT * far
    total += each * sum(kind.number * glued[kind] for kind in kinds)
    streamed = 0.0
    inside = _inside(K, surface) if eliminated else _sparse(K[~surface][:, ~surface], 0)
    for kind in kinds:
        if eliminated:  # forward and back substitution, and a triangle to apply S
            dense = 8.0 * glued[kind] ** 2
            total += kind.number * (dense + inside.bytes)
            streamed += kind.number * dense * (1.5 if pc_type == "dirichlet" else 1.0)
        else:
            factor = _sparse(K[kind.free][:, kind.free], kind.border)
            total += kind.number * factor.bytes
            streamed += kind.number * 2 * 8.0 * factor.entries  # forward and back
    if pc_type == "dirichlet" and not eliminated:
        total += count * (inside.bytes + ROW_ENTRY * K[surface].nnz)
        streamed += count * 2 * 8.0 * inside.entries
    return Estimate(total / 2**20, streamed)


def _coarse(edge: int, reach: int) -> float:
    """Return the bytes of the coarse problem of edge³ subdomains that couple so far."""
    if edge < 1:
        return 0.0
    near = np.arange(-reach, reach + 1)
    near = near[np.abs(near) < edge]
    values = np.where(near == 0, 8.0, 1.0)
    line = scipy.sparse.diags_array(values, offsets=near, shape=(edge, edge))
    neighbours = scipy.sparse.csr_array(scipy.sparse.kron(scipy.sparse.kron(line, line), line))
    entries = _analyse(neighbours, 0).entries
    return MODES**2 * (COARSE_FACTOR * entries + COARSE_ENTRY * neighbours.nnz)


def _is_eliminated(interior: str, kinds: list[_Kind], glued: dict[_Kind, int]) -> bool:
    """Decide as the solver does."""
    if interior != "auto":
        return interior == "eliminate"
    dense = sum(kind.number * glued[kind] ** 2 for kind in kinds)
    sparse = sum(kind.number * np.count_nonzero(kind.free) ** (4 / 3) for kind in kinds)
    return bool(dense <= DENSITY * sparse and max(glued.values()) <= LARGEST)


def _kinds(subdomains: int, all_floating: bool) -> Counter[tuple[int, ...]]:
    """Count the subdomains by the number of their fixed faces across each axis, sorted."""
    if all_floating:
        return Counter({(0, 0, 0): subdomains**3})
    ends = [0] * subdomains
    ends[0] += 1
    ends[-1] += 1
    axis = Counter(ends)
    kinds: Counter[tuple[int, ...]] = Counter()
    for places in itertools.product(axis.items(), repeat=3):
        fixed, numbers = zip(*places, strict=True)
        kinds[tuple(sorted(fixed))] += int(np.prod(numbers))
    return kinds


def _on_faces(x: npt.NDArray[np.float64], fixed: tuple[int, ...]) -> Mask:
    """Mark the dofs on the first, or on both, faces across each axis."""
    low = (x == 0.0) & (np.array(fixed) >= 1)
    high = (x == 1.0) & (np.array(fixed) == 2)
    return np.any(low | high, axis=1)


@cache
def _subcube(degree: int, cells: int) -> tuple[scipy.sparse.csr_array, npt.NDArray[np.float64]]:
    """Assemble the matrix of one subcube; return it and the place of each dof."""
    problem = create_problem(
        MPI.COMM_SELF, subdomains=1, cells=cells, degree=degree, source=(2.0, 2.0, 2.0)
    )
    V = problem.a.arguments()[0].ufl_function_space()
    A = dolfinx.fem.petsc.assemble_matrix(dolfinx.fem.form(problem.a))
    A.assemble()
    indptr, indices, data = A.getValuesCSR()
    A.destroy()
    x = np.repeat(np.round(V.tabulate_dof_coordinates(), 12), 3, axis=0)
    return scipy.sparse.csr_array((data, indices, indptr)), x


def _inside(K: scipy.sparse.csr_array, surface: Mask) -> _Factor:
    """Analyse the elimination of the interior, which is dense where it is small."""
    n = np.count_nonzero(~surface)
    if n <= SMALL:
        return _Factor(0.5 * n * n, 4.0 * n * n)
    return _fronts(K, np.flatnonzero(surface)) or _analyse(K[~surface][:, ~surface], 0)


def _sparse(K: scipy.sparse.csr_array, modes: int) -> _Factor:
    """Analyse a sparse block, with modes R that are held: they and 2 k columns stand beside it."""
    found = _fronts(K, np.zeros(0))
    if found is None:
        return _analyse(K, modes)
    return _Factor(found.entries, found.bytes + 3 * 8.0 * modes * K.shape[0])


def _fronts(K: scipy.sparse.csr_array, interface: npt.NDArray[np.int64]) -> _Factor | None:
    """Analyse a factorisation by fronts that stops at the interface; None without a compiler."""
    n, code = K.shape[0], load_fronts(MPI.COMM_SELF)
    if n == 0 or code is None:
        return None
    K.sort_indices()
    rows = np.arange(n, dtype=np.int32)
    matrix = Rows(K.indptr.astype(np.int32), K.indices.astype(np.int32), K.data)
    fronts = Fronts(code, matrix, rows, rows, 3, interface.astype(np.int32))
    return _Factor(fronts.entries, 8.0 * fronts.entries + FACTOR)


def _analyse(K: scipy.sparse.csr_array, border: int) -> _Factor:
    """Analyse a matrix with a dense border, without factoring it."""
    n = K.shape[0]
    if n == 0:
        return _Factor(0.0, 0.0)
    dense = scipy.sparse.csr_array(np.ones((n, border)))
    bordered = scipy.sparse.csr_array(
        scipy.sparse.block_array([[K, dense], [dense.T, scipy.sparse.eye_array(border)]])
        if border
        else K
    )
    bordered.sort_indices()
    csr = (bordered.indptr.astype(PETSc.IntType), bordered.indices.astype(PETSc.IntType))
    A = PETSc.Mat().createAIJ(bordered.shape, csr=(*csr, bordered.data), comm=PETSc.COMM_SELF)
    A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    pc = PETSc.PC().create(PETSc.COMM_SELF)
    pc.setOperators(A)
    pc.setType(PETSc.PC.Type.CHOLESKY)
    pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    pc.setFactorSetUpSolverType()
    F = pc.getFactorMatrix()
    F.setMumpsIcntl(14, 0)  # no work space for pivots to come
    F.setMumpsIcntl(23, 1)  # a megabyte at most: the numerical factorisation ends at once
    pc.setUp()
    entries, megabytes = F.getMumpsInfog(3), F.getMumpsInfog(16)
    pc.destroy()
    A.destroy()
    entries = float(entries if entries >= 0 else -1e6 * entries)  # MUMPS counts millions, then
    work = max(1e6 * megabytes, 8.0 * entries)
    return _Factor(entries, work + BLOCK_ENTRY * bordered.nnz + FACTOR)
