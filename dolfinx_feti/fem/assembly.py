# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Assembly of the local matrices of all subdomains, of residuals and of energies.

.. math:: K_i[a, b] = \mathrm D F_i(U)[φ_b; φ_a]

(eq. 27 of the paper, on subdomain i): the derivative in the direction of the trial function φ_b of
the residual F_i tested with φ_a. One matrix of each process, on the torn dofs, has the K_i of all
its subdomains as diagonal blocks. Both parts of a form (``split_form``) are added to the same
entries, in memory that dolfinx's and PETSc's matrix share. Condensed fields are subtracted
afterwards (``condensation``). Dirichlet conditions do not change K (``torn_matrix``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import numpy as np
import scipy.sparse

import dolfinx
import ufl

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import TornSpace
from dolfinx_feti.fem.split_form import SplitForm, dolfinx_form, first_component
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.events import event
from dolfinx_feti.runtime.native import pointer


@dataclass(frozen=True, slots=True)
class LocalMatrix:
    """A matrix of this process, as an object of dolfinx and one of PETSc on the same memory.

    After a change of the entries through ``csr``, call ``mat.stateIncrease()``: PETSc does not
    detect the change.

    Attributes:
        csr: dolfinx's matrix.
        mat: PETSc's sequential AIJ matrix; the caller destroys it.
        nodes: Torn nodes (blocks of dofs) of each owned cell, (cells, k).
        offsets: Offset of the columns of node j in each row of node i, counted from the start of
            the row, (cells, k, k).
    """

    csr: dolfinx.la.MatrixCSR
    mat: PETSc.Mat
    nodes: Indices
    offsets: Indices

    def c_struct(self, module: Any) -> Any:
        """Return a pointer to a ``CsrMatrix`` of ``csr_matrix.h``, valid as long as this object.

        Args:
            module: Loaded module that declares ``CsrMatrix``.
        """
        n_cells, nodes = self.nodes.shape
        members = {
            "cells": n_cells,
            "nodes": nodes,
            "bs": self.mat.getBlockSize(),
            "cell_nodes": pointer(module, self.nodes),
            "offsets": pointer(module, self.offsets),
            "indptr": pointer(module, self.csr.indptr),
            "values": pointer(module, self.csr.data),
        }
        return module.ffi.new("CsrMatrix *", members)


def create_csr(spaces: tuple[TornSpace, TornSpace], compiler: Compiler) -> dolfinx.la.MatrixCSR:
    """Create dolfinx's matrix, in which all dofs of a cell are coupled. Collective.

    Args:
        spaces: Torn spaces of rows and columns, with the same block size.
        compiler: Compiler of the problem.
    """
    v = first_component(ufl.TestFunction(spaces[0].V))
    u = first_component(ufl.TrialFunction(spaces[1].V))
    # dolfinx takes a pattern from a form; this one is on all cells, and is never assembled
    form = v * u * ufl.dx(metadata={"quadrature_degree": 0})
    pattern = dolfinx.fem.create_sparsity_pattern(dolfinx_form(form, spaces, compiler))
    pattern.finalize()
    # a row for each dof, as in PETSc's AIJ, not one for each block of dofs
    expanded = dolfinx.la.BlockMode.expanded  # type: ignore[attr-defined]
    return dolfinx.la.matrix_csr(pattern, expanded)


@event("FETIPattern")
def create_local_matrix(space: TornSpace, compiler: Compiler) -> LocalMatrix:
    """Create the local matrix of a torn space. Collective."""
    csr = create_csr((space, space), compiler)
    topology = space.V.mesh.topology
    dofmap = space.V_torn.dofmap
    bs = dofmap.index_map_bs
    n = len(csr.indptr) - 1
    indptr = csr.indptr.astype(PETSc.IntType, copy=False)
    indices = csr.indices.astype(PETSc.IntType, copy=False)
    mat = PETSc.Mat().createAIJWithArrays((n, n), (indptr, indices, csr.data), comm=PETSc.COMM_SELF)
    mat.setBlockSizes(bs, bs)  # in petsc4py 3.22 bsize= of createAIJWithArrays has no effect
    nodes = dofmap.list[: topology.index_map(topology.dim).size_local]
    return LocalMatrix(csr, mat, nodes, _column_offsets(csr, nodes, bs))


def _column_offsets(csr: dolfinx.la.MatrixCSR, nodes: Indices, bs: int) -> Indices:
    """Return the offset of the columns of node j in each row of node i, (cells, k, k).

    The rows of a node have the same columns, so only its first row is searched. Each entry gets the
    number row · n + column. These numbers are sorted, so one binary search finds all positions.

    Args:
        csr: Matrix with sorted columns and n rows.
        nodes: Nodes of each cell, (cells, k).
        bs: Rows of a node.
    """
    n = len(csr.indptr) - 1
    # the first row of each node; SciPy needs values, which are not used: here the column indices
    rows = scipy.sparse.csr_array((csr.indices, csr.indices, csr.indptr), (n, n))[::bs]
    row_of_entry = np.repeat(np.arange(n // bs), np.diff(rows.indptr))
    sorted_entries = row_of_entry * n + rows.indices
    row_of_node_i = nodes[:, :, None].astype(np.int64)
    column_of_node_j = nodes[:, None, :] * bs
    positions = np.searchsorted(sorted_entries, row_of_node_i * n + column_of_node_j)
    starts = rows.indptr[nodes][:, :, None]
    return (positions - starts).astype(np.int32)


def assemble(K: LocalMatrix, form: SplitForm) -> None:
    """Assemble a bilinear form into a local matrix, without communication.

    Args:
        K: Local matrix of the torn space; its entries are replaced.
        form: Bilinear form on the torn space.
    """
    K.csr.data[:] = 0.0
    if form.dolfinx_part is not None:
        dolfinx.fem.assemble_matrix(K.csr, form.dolfinx_part)  # type: ignore[arg-type]
    for kernel in form.kernels:
        kernel.add_to(K.c_struct(kernel.module))
    K.mat.stateIncrease()


def assemble_vector(form: SplitForm, V: dolfinx.fem.FunctionSpace) -> dolfinx.la.Vector:
    """Assemble a linear form over the cells of this process. Not collective.

    As by ``dolfinx.fem.assemble_vector``, contributions to ghosts are not sent to their owners.

    Args:
        form: Form with its test function in V.
        V: The space, not torn.

    Returns:
        The vector; ghosts have the contributions of this process.
    """
    if form.dolfinx_part is None:
        b = dolfinx.la.vector(V.dofmap.index_map, V.dofmap.index_map_bs)
    else:
        b = dolfinx.fem.assemble_vector(form.dolfinx_part)
    bs = V.dofmap.index_map_bs
    for kernel in form.kernels:
        (r,) = kernel.evaluate()
        dofs = V.dofmap.list[kernel.rows][:, :, None] * bs + np.arange(bs, dtype=np.int32)
        b.array[:] += np.bincount(dofs.ravel(), r.ravel(), minlength=len(b.array))
    return b


def integrate(form: SplitForm) -> float:
    """Return the integral of a form without arguments over the cells of this process.

    Not collective: the caller sums over processes.
    """
    total = 0.0
    if form.dolfinx_part is not None:
        total = float(dolfinx.fem.assemble_scalar(form.dolfinx_part))
    return total + sum(float(kernel.evaluate()[0].sum()) for kernel in form.kernels)


def assemble_owned(form: dolfinx.fem.Form) -> Array:
    """Return the owned entries of a linear form (eq. 28 of the paper), (owned,). Collective.

    The form is one of dolfinx alone, not split; contributions of other processes are included.
    """
    b = dolfinx.fem.assemble_vector(form)
    b.scatter_reverse(dolfinx.la.InsertMode.add)
    return b.array[: b.index_map.size_local * b.block_size].copy()
