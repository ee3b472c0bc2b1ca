# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Entries of a sequential matrix that are read in place: its diagonal, and rounding errors."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import scipy.sparse
from collective import agree, equal, whole

from dolfinx_feti.runtime.connectivity import diagonal_places
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.rounding import EPS, product_rounding

SEED = 31025


def test_places_of_the_diagonal():
    """A row without a diagonal entry has none; columns may stand in any order."""
    K = scipy.sparse.random_array((60, 60), density=0.2, rng=SEED, format="csr")
    K.setdiag(np.arange(1.0, 61.0))
    K = scipy.sparse.csr_array(K)
    K.data[K.data == 7.0] = 0.0  # row 6 has no diagonal entry, once it is taken out
    K.eliminate_zeros()
    rng = np.random.default_rng(SEED)
    for order in (np.sort, rng.permutation):
        indices = np.concatenate([order(row) for row in np.split(K.indices, K.indptr[1:-1])])
        row = np.repeat(np.arange(60), np.diff(K.indptr))
        values = K.toarray()[row, indices]
        csr = (K.indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), values)
        matrix = PETSc.Mat().createAIJWithArrays((60, 60), csr, comm=PETSc.COMM_SELF)
        place = diagonal_places(matrix)
        agree((place < 0).nonzero()[0].tolist() == [6], place)
        equal(np.where(place < 0, 0.0, values[place]), K.diagonal())
        matrix.destroy()


def test_rounding_of_a_product(torn_grid):
    problem = torn_grid((2, 2), (3, 2), components=2)
    torn = Torn(problem.A)
    t = np.random.default_rng(SEED).standard_normal(len(problem.to_global))
    mine = slice(torn.start, torn.start + torn.n)
    found = whole(product_rounding(torn.K, t[mine]))
    equal(found / EPS**2, (problem.K_torn**2) @ t**2, 1e-13)
    equal(whole(torn.diagonal()), problem.K_torn.diagonal())
    torn.destroy()
