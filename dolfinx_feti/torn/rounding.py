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

from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.native import load, pointer
from dolfinx_feti.runtime.petsc_library import rows_of
from dolfinx_feti.torn.matrix import Torn

__all__ = ["EPS", "product_rounding", "residual_rounding"]


DECLARATION = """
void sum_squares(int, const int *, const int *, const double *, const double *, double *);
"""

#: Unit of rounding.
EPS = float(np.finfo(np.float64).eps)


def product_rounding(K: PETSc.Mat, t: Array, comm: MPI.Comm) -> Array:
    """Return the squares of rounding errors of K t for a sequential matrix, (n,). Collective."""
    code = load(Path(__file__).with_name("rounding.c"), DECLARATION, comm)
    if K.getSize() != (len(t), len(t)):
        raise ValueError(f"a vector of {len(t)} entries does not fit a matrix of {K.getSize()}")
    squares = np.empty(len(t))
    with rows_of(K) as csr:
        arrays = (csr.indptr, csr.indices, csr.values, np.ascontiguousarray(t), squares)
        code.lib.sum_squares(len(t), *(pointer(code, array) for array in arrays))
    return EPS**2 * squares  # ε² Σⱼ kᵢⱼ² tⱼ²


def residual_rounding(torn: Torn, b: PETSc.Vec, x: PETSc.Vec) -> float:
    """Return δr of b − A x, zero on Dirichlet dofs, for assembled b and x, (N,). Collective."""
    squares = torn.assemble(product_rounding(torn.K, torn.tear(x.array_r), torn.comm))
    own = float((squares + (EPS * b.array_r) ** 2)[~torn.prescribed].sum())
    return float(np.sqrt(torn.comm.allreduce(own)))
