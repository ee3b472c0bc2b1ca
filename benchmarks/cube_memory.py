# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What a case of the cube takes of memory, estimated before anything is set up.

The factors are by far the most of it. A decomposed cube has at most four kinds of subdomains, told
apart by how many of their faces lie on its surface; one of each kind is analysed symbolically by
MUMPS, and its figures are multiplied. What grows with the cells, the non-zeros and the glued dofs
was measured once and stands below as bytes for each.
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

from benchmarks.cube_problem import create_problem

__all__ = ["Estimate", "estimate"]

Mask = npt.NDArray[np.bool_]

#: Bytes of a process with everything imported.
PROCESS = 140e6

#: Bytes of a tetrahedron in the mesh, the spaces and the functions.
TETRAHEDRON = 180.0

#: Bytes of an entry in the torn matrix, in the interface rows, and in a block that is factored.
ENTRY, ROW_ENTRY, BLOCK_ENTRY = 16.0, 12.0, 20.0

#: Bytes of a glued dof in the jump operators and the coarse problem.
GLUED = 1500.0

#: Bytes that a factor takes besides its entries.
FACTOR = 0.35e6


@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimated memory of a case.

    Attributes:
        mib: All of it [MiB].
        factor_bytes: Entries of all factors, which an iteration reads twice.
    """

    mib: float
    factor_bytes: float


@dataclass(frozen=True, slots=True)
class _Factor:
    """Figures of a symbolic factorisation: entries, and MUMPS' own estimate of its memory."""

    entries: float
    work: float

    def bytes(self, nonzeros: float) -> float:
        return max(self.work, 8.0 * self.entries) + BLOCK_ENTRY * nonzeros + FACTOR


@cache
def estimate(
    *,
    degree: int,
    cells: int,
    subdomains: int,
    all_floating: bool,
    pc_type: str,
    processes: int,
) -> Estimate:
    """Estimate a case from one subdomain of each kind, on this process alone.

    Args:
        degree: Of the displacements.
        cells: Cells along an edge of a subcube.
        subdomains: Subcubes along an edge of the cube.
        all_floating: Whether Dirichlet dofs stay in the local matrices.
        pc_type: Preconditioner.
        processes: Number of processes.
    """
    K, x = _subcube(degree, cells)
    surface = np.any((x == 0.0) | (x == 1.0), axis=1)
    count = subdomains**3
    total = processes * PROCESS + count * (24 * cells**3 * TETRAHEDRON + K.nnz * ENTRY)
    factor_bytes = 0.0
    for fixed, number in _kinds(subdomains, all_floating).items():
        free = ~_on_faces(x, fixed)
        border = 0 if any(fixed) else 6
        block = K[free][:, free]
        factor = _analyse(block, border)
        total += number * factor.bytes(block.nnz + 2 * border * block.shape[0])
        total += number * GLUED * np.count_nonzero(free & surface)
        factor_bytes += number * 8.0 * factor.entries
    if pc_type == "dirichlet":
        block = K[~surface][:, ~surface]
        factor = _analyse(block, 0)
        total += count * (factor.bytes(block.nnz) + ROW_ENTRY * K[surface].nnz)
        factor_bytes += count * 8.0 * factor.entries
    return Estimate(total / 2**20, factor_bytes)


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
    return _Factor(float(entries if entries >= 0 else -1e6 * entries), 1e6 * megabytes)
