# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Small systems that overlap, beside the sum over dense blocks."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
import scipy.sparse
from collective import COMM, agree, equal, raises, whole

from dolfinx_feti.feti.coarse.near import coupled_subdomains
from dolfinx_feti.feti.coarse.schwarz import SHIFT, SchwarzBlocks

pytestmark = pytest.mark.processes(1, 2, 3, 4, 8)

SEED = 4127

#: Rows of the subdomains of each process, some of which have none.
SIZES = np.array([2, 0, 3, 1])


@pytest.fixture
def chain():
    """A definite matrix that couples each subdomain with the two before and after it."""
    sizes = np.tile(SIZES, COMM.size)
    subdomain = np.repeat(np.arange(len(sizes)), sizes)
    root = np.random.default_rng(SEED).standard_normal((len(subdomain),) * 2)
    A = root + root.T
    A[np.abs(subdomain[:, None] - subdomain) > 2] = 0.0
    return A + 2 * len(subdomain) * np.eye(len(subdomain)), subdomain


@pytest.fixture
def distributed():
    """Distribute a dense matrix by rows, without its zeros."""
    made = []

    def create(A):
        own = int(SIZES.sum())
        rows = scipy.sparse.csr_array(A[COMM.rank * own : (COMM.rank + 1) * own])
        csr = (rows.indptr, rows.indices, rows.data)
        made.append(PETSc.Mat().createAIJ(((own, len(A)), (own, len(A))), csr=csr, comm=COMM))
        return made[-1]

    yield create
    for N in made:
        N.destroy()


@pytest.mark.parametrize("others", [0, 1, 2, 100])
def test_sum_of_inverse_blocks(others, chain, distributed):
    A, subdomain = chain
    N = distributed(A)
    D = np.zeros_like(A)
    there = np.unique(subdomain)
    for i in there:
        coupling = {j: np.linalg.norm(A[subdomain == i][:, subdomain == j]) for j in there}
        near = sorted((j for j in there if j != i and coupling[j]), key=lambda j: -coupling[j])
        rows = np.flatnonzero(np.isin(subdomain, [i, *near[:others]]))
        block = A[np.ix_(rows, rows)] + SHIFT * np.diag(A.diagonal()[rows])
        D[np.ix_(rows, rows)] += np.linalg.inv(block)
    blocks = SchwarzBlocks(N, coupled_subdomains(N, SIZES), others)
    r, y = N.createVecs()
    r.array[:] = np.random.default_rng(COMM.rank).standard_normal(len(r.array_r))
    for _ in range(2):
        blocks.apply(r, y)
        equal(whole(y.array_r), D @ whole(r.array_r), 1e-12)
    agree(blocks.nbytes >= 8 * (SIZES**2).sum())
    for owned in (blocks, r, y):
        owned.destroy()


def test_block_that_is_not_definite(chain, distributed):
    """On the last process alone; all raise."""
    A, _ = chain
    A[-1, -1] = -1.0
    N = distributed(A)
    with raises(np.linalg.LinAlgError, "not positive definite"):
        SchwarzBlocks(N, coupled_subdomains(N, SIZES), 0)
