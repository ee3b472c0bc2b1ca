# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Random forms agree with dolfinx's matrices, vectors and scalars, entry by entry."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
from collective import COMM, agree
from random_forms import Grammar

import dolfinx
import ufl

from dolfinx_feti.fem import assembly
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import decompose, tear
from dolfinx_feti.fem.split_form import split_form, split_torn_form

#: The code is run once, on a few cells.
JIT = {"cffi_extra_compile_args": ["-O0", "-g0"]}


def dofs(m: dolfinx.common.IndexMap, bs: int) -> np.ndarray:
    """Return the global number of each dof of this process, ghosts included."""
    blocks = m.local_to_global(np.arange(m.size_local + m.num_ghosts, dtype=np.int32))
    return (blocks[:, None] * bs + np.arange(bs)).ravel()


def added(values: np.ndarray, V: dolfinx.fem.FunctionSpace, *at: np.ndarray) -> np.ndarray:
    """Return vectors or matrices of all processes, summed at their global dofs."""
    n = V.dofmap.index_map.size_global * V.dofmap.index_map_bs
    total = np.zeros((n,) * values.ndim)
    np.add.at(total, np.ix_(*at), values)
    return COMM.allreduce(total)


def dense(A: dolfinx.la.MatrixCSR, rows: int, columns: int) -> np.ndarray:
    """Return all entries of this process, those of ghost rows included."""
    return scipy.sparse.csr_array((A.data, A.indices, A.indptr), shape=(rows, columns)).toarray()


def of_dolfinx(form: ufl.Form, V: dolfinx.fem.FunctionSpace) -> np.ndarray:
    """Return the scalar, vector or matrix that dolfinx assembles."""
    compiled = dolfinx.fem.form(form, jit_options=dict(JIT))
    bs = V.dofmap.index_map_bs
    match len(form.arguments()):
        case 0:
            return np.array([COMM.allreduce(dolfinx.fem.assemble_scalar(compiled))])
        case 1:
            b = dolfinx.fem.assemble_vector(compiled).array
            return added(b, V, dofs(V.dofmap.index_map, bs))
    A = dolfinx.fem.create_matrix(compiled, dolfinx.la.BlockMode.expanded)
    dolfinx.fem.assemble_matrix(A, compiled)
    m = A.index_map(0)
    bs = (len(A.indptr) - 1) // max(m.size_local + m.num_ghosts, 1)
    rows, columns = (dofs(A.index_map(i), bs) for i in (0, 1))
    return added(dense(A, len(rows), len(columns)), V, rows, columns)


def torn(form: ufl.Form, V: dolfinx.fem.FunctionSpace) -> tuple[np.ndarray, int]:
    """Return what this package assembles, and the number of kernels."""
    mesh = V.mesh
    compiler = Compiler(COMM, None, dict(JIT))
    bs = V.dofmap.index_map_bs
    rank = len(form.arguments())
    if rank < 2:
        split = split_form(form, mesh, compiler)
        if rank == 0:
            return np.array([COMM.allreduce(assembly.integrate(split))]), len(split.kernels)
        b = assembly.assemble_vector(split, V).array
        return added(b, V, dofs(V.dofmap.index_map, bs)), len(split.kernels)
    space = tear(V, decompose(mesh, max(3, COMM.size)))
    K = assembly.create_local_matrix(space, compiler)
    split = split_torn_form(form, space, compiler)
    assembly.assemble(K, split)
    K.mat.destroy()
    at = (space.global_block[:, None] * bs + np.arange(bs)).ravel()
    return added(dense(K.csr, len(at), len(at)), V, at, at), len(split.kernels)


@pytest.mark.parametrize("batch", range(10 if COMM.size == 1 else 2))
def test_same_numbers_as_dolfinx(batch):
    """Thirty random forms agree with dolfinx to 1e-12 of the largest entry."""
    own = 0
    for seed in range(30 * batch, 30 * (batch + 1)):
        drawn = Grammar(seed)
        expected = of_dolfinx(drawn.form, drawn.V)
        found, kernels = torn(drawn.form, drawn.V)
        error = np.abs(found - expected).max() / max(np.abs(expected).max(), 1e-300)
        agree(error <= 1e-12, f"{error}: {'; '.join(drawn.text)}: {drawn.form}")
        if kernels > 0:
            own += 1
    agree(own >= 5, "forms with kernels of the package")
