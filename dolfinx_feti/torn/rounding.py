# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Rounding errors of a residual, which bound the smallest residual that a solver can reach.

.. math:: ε_r = ε\, \Bigl\| \Bigl(b_i^2 + \sum_j k_{ij}^2\, x_j^2\Bigr)^{1/2} \Bigr\|

for the residual :math:`b - T^⊤ K T x` on the free dofs. A product :math:`k_{ij} x_j` has a relative
error of ε/2 at most from its own rounding, and as much from that of :math:`x_j`: ε in all. Errors
with random signs add up to the root above. The residual of a direct solution is about as large
(docs/theory.md).
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.petsc_library import csr_of
from dolfinx_feti.torn.matrix import Torn

#: Rows whose squared entries are in memory at once. A memory bound: some megabytes.
CHUNK_ROWS = 20_000

#: Machine epsilon ε, twice the largest relative rounding error.
EPS = float(np.finfo(np.float64).eps)

#: Largest force A y that counts as zero, as a multiple of its estimated rounding errors. The vector
#: y has rounding errors itself. Measured: 0.3 to 2 for a mechanism, whose forces are zero. Measured
#: for forces that are not zero: 110 for islands in a void with 1e-12 of the stiffness, and two
#: million for a bending strip of t/L = 5e-4. Half and twice the value change no result.
FORCE_ROUNDING_MARGIN = 15.0


def product_rounding_squares(K: PETSc.Mat, t: Array) -> Array:
    """Return the squares of the estimated rounding errors of K t, ε² Σ_j k_ij² t_j², (n,).

    Args:
        K: Sequential matrix, (n, n).
        t: Vector, (n,).
    """
    squares = np.zeros(len(t))
    t2 = t**2
    with csr_of(K) as csr:
        for i in range(0, len(t), CHUNK_ROWS):
            ends = csr.indptr[i : i + CHUNK_ROWS + 1]
            part = slice(ends[0], ends[-1])
            rows = (csr.values[part] ** 2, csr.indices[part], ends - ends[0])
            squares[i : i + CHUNK_ROWS] = scipy.sparse.csr_array(rows, (len(ends) - 1, len(t))) @ t2
    return EPS**2 * squares  # ε² Σⱼ kᵢⱼ² tⱼ²


def residual_rounding(torn: Torn, b: PETSc.Vec, x: PETSc.Vec) -> float:
    """Return the size of the rounding errors of b − A x on the free dofs. Collective.

    Args:
        torn: The torn matrix.
        b: Right-hand side, (N,).
        x: Solution, (N,).
    """
    squares = torn.assemble(product_rounding_squares(torn.K, torn.tear(x.array_r)))
    squares += (EPS * b.array_r) ** 2
    local_sum = float(squares[~torn.is_dirichlet].sum())
    return float(np.sqrt(torn.comm.allreduce(local_sum)))
