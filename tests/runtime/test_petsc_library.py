# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Functions of PETSc that petsc4py does not wrap."""

from __future__ import annotations

import ctypes

from petsc4py import PETSc

import numpy as np
import pytest
from collective import agree, raises

from dolfinx_feti.runtime import petsc_library
from dolfinx_feti.runtime.petsc_library import function, rows_of


@pytest.mark.parametrize("copied", [False, True])
def test_rows_of_a_matrix(copied, monkeypatch):
    """The arrays are the matrix's own, or copies where the library lacks the functions."""
    if copied:
        monkeypatch.setattr(petsc_library, "function", lambda *_: None)
    csr = ([0, 2, 3, 4], [0, 2, 1, 2], [1.0, 7.0, 2.0, 3.0])
    K = PETSc.Mat().createAIJ((3, 3), csr=csr, comm=PETSc.COMM_SELF)
    with rows_of(K) as rows:
        agree(tuple(array.tolist() for array in rows) == csr)
        agree(all(array.dtype == np.int32 for array in rows[:2]))
        rows.values[0] = 5.0
    agree(K[0, 0] == (1.0 if copied else 5.0))
    K.destroy()


@pytest.mark.parametrize("n", [0, 2])
def test_rows_without_entries(n):
    K = PETSc.Mat().createAIJ((n, n), nnz=0, comm=PETSc.COMM_SELF)
    K.assemble()
    with rows_of(K) as rows:
        agree(rows.indptr.tolist() == [0] * (n + 1))
        agree(len(rows.indices) == len(rows.values) == 0)
    K.destroy()


def test_a_matrix_of_another_type():
    K = PETSc.Mat().createDense((2, 2), comm=PETSc.COMM_SELF)
    K.setUp()
    K.assemble()
    with raises(RuntimeError, "SeqAIJ"), rows_of(K):
        pass
    K.destroy()


def test_a_function_that_is_not_there():
    agree(function("MatNoSuchFunction", (ctypes.c_void_p,)) is None)
