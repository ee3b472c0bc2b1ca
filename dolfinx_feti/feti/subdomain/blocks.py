# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Blocks cut out of the local matrix, and dense blocks put into a distributed one.

Whatever is done per subdomain can fail on one process alone. :func:`named` adds the number of
the subdomain to the error; ``setup`` makes it one error on all processes.
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.sparse

from dolfinx_feti.collective import reason
from dolfinx_feti.errors import FactorError
from dolfinx_feti.torn import Torn

__all__ = ["block_columns", "index_set", "named", "own_columns", "product_many", "sparse_block"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]


class named:  # noqa: N801
    """Context that lets errors of the work inside name the subdomain.

    Whatever the work raises (LAPACK, ARPACK, SciPy, MUMPS, memory) becomes a ``FactorError``. Not
    collective: the caller reduces.
    """

    def __init__(self, subdomain: int) -> None:
        """Take the number of the subdomain over all processes."""
        self._subdomain = subdomain

    def __enter__(self) -> None:
        """Begin the work."""

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        """Name the subdomain in an error.

        Raises:
            FactorError: The work has raised an error.
        """
        if isinstance(error, Exception):
            kind = "" if isinstance(error, FactorError) else f"{type(error).__name__}: "
            text = f"subdomain {self._subdomain}: {kind}{reason(error)}"
            raise FactorError(text) from error


def index_set(rows: Indices) -> PETSc.IS:
    """Turn rows into an index set; the caller destroys it."""
    return PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=PETSc.COMM_SELF)


def sparse_block(K: PETSc.Mat, rows: Indices, columns: Indices) -> scipy.sparse.csr_array:
    """Copy the block ``K[rows, columns]``."""
    sets = [index_set(dofs) for dofs in (rows, columns)]
    block = K.createSubMatrix(*sets)
    indptr, indices, values = block.getValuesCSR()
    for owned in (block, *sets):
        owned.destroy()
    return scipy.sparse.csr_array((values, indices, indptr), shape=(len(rows), len(columns)))


def product_many(K: PETSc.Mat, rows: Indices, columns: Indices, X: Array) -> Array:
    """Return ``K[rows, columns] X`` for a dense X, (len(columns), r)."""
    if 0 in (len(rows), len(columns), X.shape[1]):
        return np.zeros((len(rows), X.shape[1]))
    row_set, column_set = index_set(rows), index_set(columns)
    block = K.createSubMatrix(row_set, column_set)
    dense = PETSc.Mat().createDense(X.shape, array=np.asfortranarray(X), comm=PETSc.COMM_SELF)
    dense.assemble()
    image = block.matMult(dense)
    Y = image.getDenseArray().copy()
    for owned in (row_set, column_set, block, dense, image):
        owned.destroy()
    return Y


def block_columns(
    torn: Torn,
    rows: Sequence[Indices],
    blocks: Sequence[tuple[Array, Indices]],
    sizes: tuple[int, int],
) -> PETSc.Mat:
    """Put dense blocks into one distributed matrix, (n_torn, K); rows not named are empty.

    Args:
        torn: The torn matrix.
        rows: Torn dofs of each block, no dof twice.
        blocks: For each block its values, (rows, columns), and its columns, ascending.
        sizes: Number of columns of this process and of all.

    Note:
        Collective.
    """
    width = np.zeros(torn.n, dtype=np.int64)
    for dofs, (_, columns) in zip(rows, blocks, strict=True):
        width[dofs] = len(columns)
    first = np.concatenate(([0], np.cumsum(width)))
    values, column = np.empty(first[-1]), np.empty(first[-1], dtype=PETSc.IntType)
    for dofs, (block, columns) in zip(rows, blocks, strict=True):
        at = first[dofs][:, None] + np.arange(len(columns))
        values[at], column[at] = block, columns
    csr = (first.astype(PETSc.IntType), column, values)
    return PETSc.Mat().createAIJ(((torn.n, None), sizes), csr=csr, comm=torn.A.comm)


def own_columns(torn: Torn, rows: Sequence[Indices], blocks: Sequence[Array]) -> PETSc.Mat:
    """Give each block columns of its own, consecutive: one distributed matrix, (n_torn, Σ c_i).

    Args:
        torn: The torn matrix.
        rows: Torn dofs of each block, no dof twice.
        blocks: Their values, (rows, c_i).

    Note:
        Collective.
    """
    count = np.array([block.shape[1] for block in blocks], dtype=np.int64)
    size = int(count.sum())
    first = torn.comm.scan(size) - size + np.cumsum(count) - count
    ends = zip(first, first + count, strict=True)
    numbers: list[Indices] = [np.arange(*pair, dtype=np.int32) for pair in ends]
    columns = list(zip(blocks, numbers, strict=True))
    return block_columns(torn, rows, columns, (size, torn.comm.allreduce(size)))
