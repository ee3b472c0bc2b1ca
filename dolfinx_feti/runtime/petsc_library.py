# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Functions of PETSc, and of what it is linked with, that petsc4py does not wrap; products."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.arrays import Array, Indices

_Handle, _Pointer, _Number = ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int
_Numbers, _Doubles = ctypes.POINTER(ctypes.c_int), ctypes.POINTER(ctypes.c_double)
_ROWS = (_Handle, *[_Number] * 3, *[_Pointer] * 4)
_ACCESS = (
    ("MatGetRowIJ", _ROWS),
    ("MatRestoreRowIJ", _ROWS),
    ("MatSeqAIJGetArrayRead", (_Handle, _Pointer)),
    ("MatSeqAIJRestoreArrayRead", (_Handle, _Pointer)),
)


class Rows(NamedTuple):
    """A sparse matrix row by row: where each begins, (n + 1,), columns and values of entries."""

    indptr: Indices
    indices: Indices
    values: Array


@functools.cache
def function(name: str, arguments: tuple[Any, ...]) -> Any:
    """Look up a function that returns a code in what petsc4py has loaded; None if there is none.

    Its arguments have these types, of ctypes.
    """
    try:
        symbol = getattr(ctypes.CDLL(PETSc.__file__), name)
    except (AttributeError, OSError):
        return None
    symbol.argtypes, symbol.restype = list(arguments), ctypes.c_int
    return symbol


def reads_in_place() -> bool:
    """Tell whether :func:`rows_of` yields a matrix's own arrays, and not copies."""
    available = all(function(*each) for each in _ACCESS)
    return available and PETSc.IntType().itemsize == 4


@contextmanager
def rows_of(K: PETSc.Mat) -> Iterator[Rows]:
    """Yield the arrays of a sequential AIJ matrix, its own if :func:`reads_in_place`.

    Raises:
        RuntimeError: The matrix is not SeqAIJ.
    """
    n = K.getSize()[0]
    if n == 0 or not reads_in_place():
        indptr, indices, values = K.getValuesCSR()
        yield Rows(indptr.astype(np.int32), indices.astype(np.int32), values)
        return
    rows, restore_rows, array, restore_array = (function(*each) for each in _ACCESS)
    size, done = ctypes.c_int(), ctypes.c_int()
    i, j, a = _Numbers(), _Numbers(), _Doubles()
    pattern = (K.handle, 0, 0, 0, *map(ctypes.byref, (size, i, j, done)))
    if rows(*pattern) or not done.value or array(K.handle, ctypes.byref(a)):
        raise RuntimeError("PETSc does not hand out the rows of a matrix; it has to be SeqAIJ")
    try:
        indptr = np.ctypeslib.as_array(i, (n + 1,))
        if indptr[-1] == 0:
            yield Rows(indptr, np.zeros(0, dtype=np.int32), np.zeros(0))
        else:
            shape = (int(indptr[-1]),)
            yield Rows(indptr, np.ctypeslib.as_array(j, shape), np.ctypeslib.as_array(a, shape))
    finally:
        restore_array(K.handle, ctypes.byref(a))
        restore_rows(*pattern)


def product(K: PETSc.Mat, x: Array, *, transpose: bool = False) -> Array:
    """Return K x, or Kᵀ x, for a sequential matrix and a vector, (n,), or columns, (n, r)."""
    y = np.zeros((K.getSize()[1 if transpose else 0], *x.shape[1:]))
    if not y.size:
        return y
    if y.ndim == 1:
        both = np.ascontiguousarray(x), y
        pair = [PETSc.Vec().createWithArray(a, comm=PETSc.COMM_SELF) for a in both]
        (K.multTranspose if transpose else K.mult)(*pair)
    else:
        X = PETSc.Mat().createDense(x.shape, array=np.asfortranarray(x), comm=PETSc.COMM_SELF)
        X.assemble()
        pair = [X, K.transposeMatMult(X) if transpose else K.matMult(X)]
        y = pair[1].getDenseArray().copy()
    for owned in pair:
        owned.destroy()
    return y


def pattern_state(K: PETSc.Mat) -> tuple[int, ...]:
    """Return what changes with the pattern of a matrix.

    That is, how often it has changed, the number of entries and, of SeqAIJ, where PETSc keeps them.
    """
    count, entries = ctypes.c_int64(), int(K.getInfo()["nz_used"])
    changes = function("MatGetNonzeroState", (_Handle, _Pointer))
    if changes is not None:
        changes(K.handle, ctypes.byref(count))
    if not K.getType().startswith("seqaij") or K.getSize()[0] == 0 or not reads_in_place():
        return (count.value, entries)
    with rows_of(K) as arrays:
        return (count.value, entries, *(array.ctypes.data for array in arrays))
