# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Functions of PETSc and of the libraries that it is linked with, which petsc4py does not wrap.

:func:`csr_of` reads the arrays of a matrix, :func:`pattern_version` shows whether its pattern has
changed, :func:`product` multiplies numpy arrays with it.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.arrays import Array, Indices

_Handle = ctypes.c_void_p
_Pointer = ctypes.c_void_p
_Int = ctypes.c_int

#: Arguments of MatGetRowIJ and MatRestoreRowIJ: matrix, shift, symmetric, compressed, and addresses
#: of four results.
_ROW_IJ_ARGUMENTS = (_Handle, _Int, _Int, _Int, _Pointer, _Pointer, _Pointer, _Pointer)

#: Arguments of MatSeqAIJGetArrayRead and MatSeqAIJRestoreArrayRead: matrix, address of a result.
_ARRAY_ARGUMENTS = (_Handle, _Pointer)


class CSRMatrix(NamedTuple):
    """A sparse matrix by compressed rows, (n, n).

    Attributes:
        indptr: Place of the first entry of each row, (n + 1,).
        indices: Column of each entry, (entries,).
        values: The entries, (entries,).
    """

    indptr: Indices
    indices: Indices
    values: Array


@functools.cache
def c_function(name: str, arguments: tuple[Any, ...]) -> Any:
    """Return a C function from the libraries that petsc4py has loaded.

    Args:
        name: Name of the function, which returns an error code.
        arguments: Types of its arguments, of ctypes.

    Returns:
        The function; None if the libraries lack it.
    """
    try:
        symbol = getattr(ctypes.CDLL(PETSc.__file__), name)
    except (AttributeError, OSError):
        return None
    symbol.argtypes = list(arguments)
    symbol.restype = ctypes.c_int
    return symbol


class _RowAccess(NamedTuple):
    """Functions of PETSc that begin and end the access to the arrays of a SeqAIJ matrix."""

    get_rows: Any
    restore_rows: Any
    get_values: Any
    restore_values: Any


def _row_access() -> _RowAccess | None:
    """Return PETSc's functions for the arrays of a matrix; None if PETSc lacks one."""
    access = _RowAccess(
        c_function("MatGetRowIJ", _ROW_IJ_ARGUMENTS),
        c_function("MatRestoreRowIJ", _ROW_IJ_ARGUMENTS),
        c_function("MatSeqAIJGetArrayRead", _ARRAY_ARGUMENTS),
        c_function("MatSeqAIJRestoreArrayRead", _ARRAY_ARGUMENTS),
    )
    return None if None in access else access


def reads_in_place() -> bool:
    """Return True if :func:`csr_of` yields the arrays of the matrix itself, not copies."""
    return _row_access() is not None and PETSc.IntType().itemsize == 4


@contextmanager
def csr_of(K: PETSc.Mat) -> Iterator[CSRMatrix]:
    """Context with a sequential AIJ matrix by compressed rows.

    The arrays are read-only views into the matrix, valid inside of the context. They are copies if
    PETSc offers no views or has 64-bit indices (:func:`reads_in_place`).

    Raises:
        RuntimeError: The matrix is not SeqAIJ.
    """
    access = _row_access()
    if K.getSize()[0] == 0 or access is None or not reads_in_place():
        indptr, indices, values = K.getValuesCSR()
        yield CSRMatrix(indptr.astype(np.int32), indices.astype(np.int32), values)
        return
    with _row_views(K, access) as csr:
        yield csr


@contextmanager
def _row_views(K: PETSc.Mat, access: _RowAccess) -> Iterator[CSRMatrix]:
    """Context with read-only views into a SeqAIJ matrix of at least one row."""
    n = ctypes.c_int()
    is_done = ctypes.c_int()
    indptr_address = ctypes.POINTER(ctypes.c_int)()
    indices_address = ctypes.POINTER(ctypes.c_int)()
    values_address = ctypes.POINTER(ctypes.c_double)()
    results = [ctypes.byref(result) for result in (n, indptr_address, indices_address, is_done)]
    arguments = (K.handle, 0, 0, 0, *results)  # no shift, not symmetrised, not by inodes
    if access.get_rows(*arguments) or not is_done.value:
        raise _not_seqaij(K)
    try:
        if access.get_values(K.handle, ctypes.byref(values_address)):
            raise _not_seqaij(K)
        try:
            indptr: Indices = np.ctypeslib.as_array(indptr_address, (n.value + 1,))
            indices: Indices = np.zeros(0, dtype=np.int32)
            values: Array = np.zeros(0)
            entries = int(indptr[-1])
            if entries:  # otherwise the addresses may be null
                indices = np.ctypeslib.as_array(indices_address, (entries,))
                values = np.ctypeslib.as_array(values_address, (entries,))
            for array in (indptr, indices, values):
                array.flags.writeable = False
            yield CSRMatrix(indptr, indices, values)
        finally:
            access.restore_values(K.handle, ctypes.byref(values_address))
    finally:
        access.restore_rows(*arguments)


def _not_seqaij(K: PETSc.Mat) -> RuntimeError:
    """Return the error of a matrix whose arrays PETSc does not give access to."""
    return RuntimeError(
        f"rows can be read only from a SeqAIJ matrix, and this one is {K.getType()}"
    )


def product(K: PETSc.Mat, x: Array, *, transpose: bool = False) -> Array:
    """Return the product of a sequential matrix.

    Args:
        K: The matrix, (m, n).
        x: One vector, (n,), or several columns, (n, r).
        transpose: Multiply with the transpose, for x of m rows.

    Returns:
        K x, (m,) or (m, r); or Kᵀ x, (n,) or (n, r).
    """
    y = np.zeros((K.getSize()[1 if transpose else 0], *x.shape[1:]))
    if not y.size:
        return y
    if y.ndim == 1:
        x_vec = PETSc.Vec().createWithArray(np.ascontiguousarray(x), comm=PETSc.COMM_SELF)
        y_vec = PETSc.Vec().createWithArray(y, comm=PETSc.COMM_SELF)
        if transpose:
            K.multTranspose(x_vec, y_vec)
        else:
            K.mult(x_vec, y_vec)
        x_vec.destroy()
        y_vec.destroy()
        return y
    X = PETSc.Mat().createDense(x.shape, array=np.asfortranarray(x), comm=PETSc.COMM_SELF)
    X.assemble()
    Y = K.transposeMatMult(X) if transpose else K.matMult(X)
    y = Y.getDenseArray().copy()
    X.destroy()
    Y.destroy()
    return y


def pattern_version(K: PETSc.Mat) -> tuple[int, ...]:
    """Return numbers that change whenever the pattern of a sequential matrix changes.

    The pattern itself is not compared. The numbers are PETSc's count of changes, the number of
    entries and, for SeqAIJ, the addresses of the arrays, which differ if another matrix replaces K.
    """
    count = ctypes.c_int64()
    entries = int(K.getInfo()["nz_used"])
    changes = c_function("MatGetNonzeroState", (_Handle, _Pointer))
    if changes is not None:
        changes(K.handle, ctypes.byref(count))
    if not K.getType().startswith("seqaij") or K.getSize()[0] == 0 or not reads_in_place():
        return (count.value, entries)
    with csr_of(K) as arrays:
        return (count.value, entries, *(array.ctypes.data for array in arrays))
