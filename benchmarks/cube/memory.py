# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Memory of a case of the cube, estimated before anything is set up.

The factors are by far the most of it. By nested dissection the Cholesky factor of n dofs in three
dimensions has :math:`c\, n^{4/3}` entries; c was measured once, and so were the bytes for each
tetrahedron and each glued dof. A decomposed cube has at most four kinds of subdomains, told apart
by how many of their faces lie on its surface. Where the solver eliminates the interior dofs, the
dense Schur complements take the place of the factors of K. The coarse matrix couples a subdomain
with the 26 around it, or with 124 if Q is the preconditioner.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass
from functools import cache

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx

from meshes.cube import create_cube

__all__ = ["Estimate", "estimate"]

#: Bytes per process with everything imported.
PROCESS = 140e6

#: Bytes per tetrahedron in the mesh, the spaces, the functions and the torn matrix, by degree.
TETRAHEDRON = {1: 1000.0, 2: 9800.0}

#: Bytes per glued dof in the jump operators and the coarse problem; for Q = preconditioner in the
#: product of the preconditioner with G; for Dirichlet's with the interior in its rows of K.
GLUED, PRODUCT, ROWS = 1500.0, 3000.0, 1000.0

#: c by degree, bytes per entry of a factor, and bytes of a factor besides.
FILL, ENTRY, FACTOR = {1: 8.5, 2: 10.4}, 8.0, 0.15e6

#: Modes of a subdomain in the coarse space.
MODES = 6

#: c of the coarse matrix in place of a dof, its entries in a row, and bytes for both of them, by
#: how far its subdomains couple.
COARSE_FILL, COARSE_ROW = {1: 12.0, 2: 32.0}, {1: 26.0, 2: 111.0}
COARSE_FACTOR, COARSE_ENTRY = 12.0, 36.0

#: When the solver eliminates the interior: S has at most so many entries for n^(4/3) of a factor of
#: K, and so many rows.
DENSITY, LARGEST = 30.0, 2048


@dataclass(frozen=True, slots=True)
class Estimate:
    """Memory [MiB], and the size of the factors and blocks that an iteration reads [bytes]."""

    mib: float
    streamed: float


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
    """Estimate a case, with so many cells along an edge of a subcube and subcubes along the cube's.

    The others are options of the solver.
    """
    x = _nodes(degree, cells)
    surface = np.any((x == 0.0) | (x == 1.0), axis=1)
    count, inside = subdomains**3, np.count_nonzero(~surface)
    kinds = [(number, *_sizes(x, surface, fixed))
             for fixed, number in _kinds(subdomains, all_floating).items()]  # fmt: skip
    eliminated = _is_eliminated(interior, kinds)
    far, dirichlet = coarse_q == "preconditioner", pc_type == "dirichlet"
    total = processes * PROCESS + count * 24 * cells**3 * TETRAHEDRON[degree]
    total += _coarse(subdomains if all_floating else subdomains - 2, 2 if far else 1)
    each = GLUED + PRODUCT * far + ROWS * (dirichlet and not eliminated)
    streamed = 0.0
    if eliminated or dirichlet:
        total += count * (ENTRY * _entries(inside, degree) + FACTOR)
    for number, free, glued in kinds:
        total += number * glued * each
        if eliminated:  # forward and back substitution, and a triangle to apply S
            total += number * 8.0 * glued**2
            streamed += number * 8.0 * glued**2 * (1.5 if dirichlet else 1.0)
        else:  # forward and back; the modes and two columns for each stand beside the factor
            total += number * (ENTRY * (_entries(free, degree) + 3 * MODES * free) + FACTOR)
            streamed += number * 2 * ENTRY * _entries(free, degree)
    if dirichlet and not eliminated:
        streamed += count * 2 * ENTRY * _entries(inside, degree)
    return Estimate(total / 2**20, streamed)


def _entries(n: int, degree: int) -> float:
    """Return c n^(4/3), or a dense triangle where it has fewer."""
    return min(FILL[degree] * n ** (4 / 3), n * (n + 1) / 2)


def _coarse(edge: int, reach: int) -> float:
    """Return the bytes of the coarse problem of edge³ subdomains that couple so far."""
    n = max(edge, 0) ** 3
    entries = (
        COARSE_FACTOR * COARSE_FILL[reach] * n ** (4 / 3) + COARSE_ENTRY * COARSE_ROW[reach] * n
    )
    return MODES**2 * entries


def _is_eliminated(interior: str, kinds: list[tuple[int, int, int]]) -> bool:
    """Decide as the solver does."""
    if interior != "auto":
        return interior == "eliminate"
    dense = sum(number * glued**2 for number, _, glued in kinds)
    sparse = sum(number * free ** (4 / 3) for number, free, _ in kinds)
    return dense <= DENSITY * sparse and max(glued for *_, glued in kinds) <= LARGEST


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


def _sizes(
    x: npt.NDArray[np.float64], surface: npt.NDArray[np.bool_], fixed: tuple[int, ...]
) -> tuple[int, int]:
    """Return the free dofs and those of them that are glued, with the first or both faces fixed."""
    low = (x == 0.0) & (np.array(fixed) >= 1)
    high = (x == 1.0) & (np.array(fixed) == 2)
    free = ~np.any(low | high, axis=1)
    return int(np.count_nonzero(free)), int(np.count_nonzero(free & surface))


@cache
def _nodes(degree: int, cells: int) -> npt.NDArray[np.float64]:
    """Return the place of each dof of a subcube, (n, 3)."""
    mesh, _ = create_cube(MPI.COMM_SELF, 1, cells)
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", degree))
    return np.repeat(np.round(V.tabulate_dof_coordinates(), 12), 3, axis=0)
