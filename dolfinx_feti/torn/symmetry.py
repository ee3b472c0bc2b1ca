# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A test whether the matrices :math:`K_i` of all subdomains are symmetric up to rounding.

.. math:: |a_{ij} - a_{ji}| ≤ τ\, s_i s_j, \qquad
          s_i^2 = \max(|a_{ii}|, \, τ_s \max_j |a_{ij}|)

for the entries a of :math:`K_i`, with τ = :data:`SYMMETRY_RTOL` and :math:`τ_s` =
:data:`MIN_DIAGONAL`. A tolerance relative to ‖K‖, which grows with the penalty κ, would miss the
unsymmetric stiffness of a small follower load. The assembled matrix may be symmetric although the
:math:`K_i` are not. An example is the full tangent of a pressure on a surface whose rim is clamped.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.petsc_library import csr_of, product

#: Largest |a_ij − a_ji| of a symmetric matrix, relative to s_i s_j. Rounding errors of assembly and
#: condensation reach 7e-12 (P2) and 3e-13 (P2–P0) for κ/μ = 10⁶.
SYMMETRY_RTOL = 1e-10

#: Bound for the components of s⁻¹ (K − Kᵀ) s⁻¹ ω, with random weights ω between 1 and 2. Below it,
#: K counts as symmetric, and its entries are not compared. It is a hundredth of SYMMETRY_RTOL: one
#: entry above SYMMETRY_RTOL lifts the component of its row above this bound, unless other entries
#: of the row cancel it.
PROBE_RTOL = 1e-12

#: Smallest s_i², relative to the largest entry of its row. It gives a scale to rows with a zero on
#: the diagonal, such as those of a multiplier.
MIN_DIAGONAL = 1e-8


def is_symmetric(A: PETSc.Mat) -> bool:
    """Return True if all K_i of a torn matrix are symmetric. Collective.

    PETSc's flag is used if it is set; otherwise the entries are compared.
    """
    comm = A.comm.tompi4py()
    K = A.getISLocalMat()

    def is_locally_symmetric() -> bool:
        is_known, is_known_symmetric = K.isSymmetricKnown()
        return bool(is_known_symmetric) if is_known else _has_symmetric_entries(K)

    return bool(comm.allreduce(on_all(is_locally_symmetric, comm), op=MPI.LAND))


def _has_symmetric_entries(K: PETSc.Mat) -> bool:
    """Return True if a sequential AIJ matrix, (n, n), is symmetric up to rounding."""
    if K.getSize()[0] == 0:
        return True
    root = np.sqrt(np.abs(K.getDiagonal().array_r))
    if root.all() and _passes_probe(K, root):
        return True
    with csr_of(K) as csr:
        A = scipy.sparse.csr_array((csr.values, csr.indices, csr.indptr), K.getSize())
        largest = np.abs(A).max(axis=1).toarray().ravel()
        s = np.sqrt(np.maximum(root**2, MIN_DIAGONAL * largest))
        skew = (A - A.T.tocsr()).tocoo()
        return bool(np.all(np.abs(skew.data) <= SYMMETRY_RTOL * s[skew.row] * s[skew.col]))


def _passes_probe(K: PETSc.Mat, s: Array) -> bool:
    """Return True if |(K − Kᵀ) s⁻¹ ω| ≤ PROBE_RTOL s for random ω, by two products."""
    n = len(s)
    x = np.random.default_rng(n).uniform(1.0, 2.0, n) / s
    difference = product(K, x) - product(K, x, transpose=True)
    return bool(np.all(np.abs(difference) <= PROBE_RTOL * s))
