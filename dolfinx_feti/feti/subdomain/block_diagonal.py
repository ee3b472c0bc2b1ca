# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Dense blocks of all subdomains as one sparse matrix: block-diagonal, or one below the other."""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.runtime.arrays import Array, Indices, concatenate
from dolfinx_feti.torn.matrix import Torn


def block_diagonal(blocks: Sequence[Array]) -> scipy.sparse.csr_array:
    """Return dense blocks, (r_i, c_i), as the diagonal of a sparse matrix; zeros are stored."""
    # With the empty block the result is a sparse array even if there are no other blocks.
    return scipy.sparse.block_diag([*blocks, scipy.sparse.coo_array((0, 0))], format="csr")


def block_columns(torn: Torn, blocks: Sequence[tuple[Indices, Array]]) -> PETSc.Mat:
    """Create a matrix with consecutive columns for each block, (Σ n, Σ c_i). Collective.

    Args:
        torn: The torn matrix.
        blocks: Torn dofs of each block of this process, (r_i,), and the values on them, (r_i, c_i).
            The dofs of different blocks are disjoint. Rows of other dofs are empty.

    Returns:
        The matrix, with rows for the torn dofs of all processes; the caller destroys it.
    """
    local = block_diagonal([values for _, values in blocks]).tocoo()
    row = concatenate([rows for rows, _ in blocks], np.int32)[local.row]
    shape = (torn.n, local.shape[1])
    columns = scipy.sparse.csr_array((local.data, (row, local.col)), shape=shape)
    return distributed_block_diagonal(columns, torn.A.comm)


def distributed_block_diagonal(block: scipy.sparse.csr_array, comm: PETSc.Comm) -> PETSc.Mat:
    """Create a block-diagonal matrix with one block for each process. Collective.

    Args:
        block: Block of this process, (r, c).
        comm: Communicator of the matrix.

    Returns:
        The matrix, (Σ r, Σ c) over the processes; the caller destroys it.
    """
    rows, columns = block.shape
    first_column = comm.tompi4py().scan(columns) - columns
    csr = (
        block.indptr.astype(PETSc.IntType),
        (block.indices + first_column).astype(PETSc.IntType),
        block.data,
    )
    return PETSc.Mat().createAIJ(((rows, None), (columns, None)), csr=csr, comm=comm)
