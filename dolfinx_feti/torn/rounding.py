# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Rounding errors of a residual: how far down any solver can get it.

.. math:: δr = ε\, \Bigl\| \Bigl(b_i^2 + \sum_j k_{ij}^2\, x_j^2\Bigr)^{1/2} \Bigr\|

for the residual :math:`b - T^⊤ K T x` on the free dofs. Every product and every entry of x is
rounded by a share ε/2 at most; with signs at random the errors of a row add up to this root. What a
direct solution leaves is about as large (docs/theory.md).
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.petsc_library import rows_of
from dolfinx_feti.torn.matrix import Torn

#: Rows whose squares are in memory at once.
CHUNK = 20_000

#: Unit of rounding.
EPS = float(np.finfo(np.float64).eps)


def product_rounding(K: PETSc.Mat, t: Array) -> Array:
    """Return the squares of rounding errors of K t for a sequential matrix, (n,)."""
    squares, t2 = np.zeros(len(t)), t**2
    with rows_of(K) as csr:
        for i in range(0, len(t), CHUNK):
            ends = csr.indptr[i : i + CHUNK + 1]
            part = slice(ends[0], ends[-1])
            rows = (csr.values[part] ** 2, csr.indices[part], ends - ends[0])
            squares[i : i + CHUNK] = scipy.sparse.csr_array(rows, (len(ends) - 1, len(t))) @ t2
    return EPS**2 * squares  # ε² Σⱼ kᵢⱼ² tⱼ²


def residual_rounding(torn: Torn, b: PETSc.Vec, x: PETSc.Vec) -> float:
    """Return δr of b − A x, zero on Dirichlet dofs, for assembled b and x, (N,). Collective."""
    squares = torn.assemble(product_rounding(torn.K, torn.tear(x.array_r)))
    own = float((squares + (EPS * b.array_r) ** 2)[~torn.prescribed].sum())
    return float(np.sqrt(torn.comm.allreduce(own)))
