# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Blocks cut out of the local matrix, and dense blocks put into a distributed one.

Whatever is done per subdomain can fail on one process alone. :func:`named` adds the number of
the subdomain to the error; :func:`on_subdomains` makes it one error on all processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.errors import FactorError, SetUpError, SingularBlockError, SingularError
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.collective import on_all, reason
from dolfinx_feti.runtime.petsc_library import product
from dolfinx_feti.torn.matrix import Torn

T = TypeVar("T")


def block_diagonal(blocks: Sequence[Array]) -> scipy.sparse.csr_array:
    """Return dense blocks, (r_i, c_i), as the diagonal of a sparse matrix; zeros are stored."""
    # The empty block makes the result a sparse array, also where there is no other.
    return scipy.sparse.block_diag([*blocks, scipy.sparse.coo_array((0, 0))], format="csr")


class named:  # noqa: N801
    """Context that lets errors of the work inside name the subdomain, by its number.

    Whatever that raises, but a ``MemoryError``, becomes a ``FactorError``; the caller reduces. (A
    generator would leave a reference cycle through the traceback.)
    """

    def __init__(self, subdomain: int) -> None:
        """Take the number of the subdomain over all processes."""
        self._subdomain = subdomain

    def __enter__(self) -> None:
        """Begin the work."""

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        """Name the subdomain in an error."""
        if isinstance(error, Exception):
            known = isinstance(error, FactorError | MemoryError)
            name = "" if isinstance(error, FactorError) else f"{type(error).__name__}: "
            kind = type(error) if known else FactorError
            raise kind(f"subdomain {self._subdomain}: {name}{reason(error)}") from error


def on_subdomains(work: Callable[[], T], comm: MPI.Comm) -> T:
    """Do work on the subdomains of each process; an error on one is one on all. Collective.

    Raises:
        SetUpError: With the error of the first process that met one; a SingularError if a block
            is singular.
    """
    try:
        return on_all(work, comm)
    except Exception as error:
        remedy = "look at coefficients and supports, or take other subdomains"
        if isinstance(error, MemoryError):
            remedy = "take more processes, or smaller subdomains"
        kind = SingularError if isinstance(error, SingularBlockError) else SetUpError
        raise kind(f"Work on a subdomain failed ({reason(error)}): {remedy}.") from error


def index_set(rows: Indices) -> PETSc.IS:
    """Turn rows into an index set; the caller destroys it."""
    return PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=PETSc.COMM_SELF)


def as_slice(rows: Indices) -> slice | Indices:
    """Turn consecutive rows into a slice, which numpy copies without an index."""
    if len(rows) and rows[-1] - rows[0] + 1 == len(rows):
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows


def sparse_block(K: PETSc.Mat, rows: Indices, columns: Indices) -> scipy.sparse.csr_array:
    """Copy the block ``K[rows, columns]``."""
    sets = [index_set(dofs) for dofs in (rows, columns)]
    block = K.createSubMatrix(*sets)
    indptr, indices, values = block.getValuesCSR()
    for owned in (block, *sets):
        owned.destroy()
    return scipy.sparse.csr_array((values, indices, indptr), shape=(len(rows), len(columns)))


def product_many(
    K: PETSc.Mat, rows: Indices, columns: Indices, X: Array, *, transpose: bool = False
) -> Array:
    """Return ``K[rows, columns] X``, or that of Kᵀ, for a dense X, (len(columns), r)."""
    if 0 in (len(rows), len(columns), X.shape[1]):
        return np.zeros((len(rows), X.shape[1]))
    row_set, column_set = map(index_set, (columns, rows) if transpose else (rows, columns))
    block = K.createSubMatrix(row_set, column_set)
    Y = product(block, X, transpose=transpose)
    for owned in (row_set, column_set, block):
        owned.destroy()
    return Y


def own_columns(torn: Torn, rows: Sequence[Indices], blocks: Sequence[Array]) -> PETSc.Mat:
    """Give each block columns of its own, consecutive, in one matrix, (n_torn, Σ c_i). Collective.

    The values, (rows, c_i), are those of torn dofs, no dof twice; all other rows are empty.
    """
    local = block_diagonal(blocks).tocoo()
    row = np.concatenate([np.zeros(0, dtype=np.int32), *rows])[local.row]
    size = local.shape[1]
    start = torn.comm.scan(size) - size
    whole = scipy.sparse.csr_array((local.data, (row, local.col)), shape=(torn.n, size))
    pattern = (a.astype(PETSc.IntType) for a in (whole.indptr, whole.indices + start))
    csr = (*pattern, whole.data)
    return PETSc.Mat().createAIJ(((torn.n, None), (size, None)), csr=csr, comm=torn.A.comm)
