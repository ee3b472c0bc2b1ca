# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""MUMPS runs out of memory for real, and the error names the option that helps."""

from __future__ import annotations

from petsc4py import PETSc

import pytest
import scipy.sparse

from dolfinx_feti.feti.subdomain.factors.direct import Choice, create_factor
from dolfinx_feti.runtime.petsc_options import inserted

PREFIX = "test_local_"
CHOICE = Choice(PREFIX, symmetric=True, right_hand_sides=4)

#: Too small a work space, one that no machine has, too low a limit: INFOG(1) and the remedy.
SHORTAGES = {
    "work space": ({"mat_mumps_icntl_14": -99}, -9, "raise -{}mat_mumps_icntl_14"),
    "allocation": ({"mat_mumps_icntl_14": 10**8}, -13, "set -{}mat_mumps_icntl_22 1"),
    "limit": ({"mat_mumps_icntl_23": 1}, -19, "raise -{}mat_mumps_icntl_23, the limit in MB"),
}


@pytest.fixture
def laplacian():
    """Of a square with 60 × 60 points."""
    T = scipy.sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(60, 60))
    K = scipy.sparse.csr_array(scipy.sparse.kronsum(T, T))
    csr = K.indptr.astype(PETSc.IntType), K.indices.astype(PETSc.IntType), K.data
    matrix = PETSc.Mat().createAIJ(K.shape, csr=csr, comm=PETSc.COMM_SELF)
    yield matrix
    matrix.destroy()


@pytest.mark.serial
@pytest.mark.parametrize(("options", "infog", "remedy"), SHORTAGES.values(), ids=SHORTAGES)
def test_shortage_of_memory(options, infog, remedy, laplacian):
    with inserted(PREFIX, options), pytest.raises(MemoryError) as caught:
        create_factor(laplacian, CHOICE)
    assert f"not enough memory or work space (MUMPS: INFOG(1) = {infog}" in str(caught.value)
    assert remedy.format(PREFIX) in str(caught.value)


@pytest.mark.serial
@pytest.mark.parametrize("option", [{"mat_mumps_icntl_22": 1}, {"mat_mumps_icntl_23": 64}])
def test_remedies_work(option, laplacian):
    with inserted(PREFIX, option):
        factor = create_factor(laplacian, CHOICE)
    b, x = laplacian.createVecs()
    b.set(1.0)
    factor.apply(b, x)
    error = laplacian * x - b
    assert error.norm() < 1e-11 * b.norm()
    for owned in (factor, b, x, error):
        owned.destroy()
