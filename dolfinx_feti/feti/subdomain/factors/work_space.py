# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Packed triangles, and the work space that factorisations and products share.

LAPACK's packed format stores the lower triangle column by column, (n (n + 1) / 2,), in half the
memory of the square. BLAS of level 3 needs the square: the triangle is unpacked into a work space.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt
import scipy.linalg.lapack as lapack

from dolfinx_feti.runtime.arrays import Array, Single
from dolfinx_feti.runtime.native import address_of

Real = TypeVar("Real", np.float32, np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class PackedTriangle(Generic[Real]):
    """The lower triangle of a matrix, (n, n), in packed format; its entries do not change.

    Attributes:
        entries: The entries in double or single precision, (n (n + 1) / 2,).
        n: Number of rows.
    """

    entries: npt.NDArray[Real]
    n: int

    def memory(self) -> float:
        """Return the memory of the entries in MiB."""
        return self.entries.nbytes / 2**20


class WorkSpace:
    """Memory that the dense and sparse blocks of one process use in turn.

    It grows to the largest request. A returned array is valid until the next call of any method.
    Several objects share the space: a method that requests an array uses it before it returns, and
    does not store it. Not thread-safe.
    """

    def __init__(self) -> None:
        self._entries = np.empty(0)
        #: Triangle that the space contains, unpacked; None if it contains something else.
        self._unpacked: PackedTriangle[np.float32] | PackedTriangle[np.float64] | None = None

    def entries(self, count: int) -> Array:
        """Return memory for the caller to overwrite, (count,), with arbitrary values."""
        self._unpacked = None
        if len(self._entries) < count:
            self._entries = np.empty(0)  # freed before more is allocated
            self._entries = np.empty(count)
        return self._entries[:count]

    def unpack_copy(self, triangle: PackedTriangle[Real]) -> npt.NDArray[Real]:
        """Unpack a triangle for a caller that overwrites it.

        Returns:
            The triangle, (n, n) in Fortran's order; entries above the diagonal are arbitrary.
        """
        n = triangle.n
        square = self.entries(n * n).view(triangle.entries.dtype)[: n * n]
        unpack(triangle.entries, n, square)
        return square.reshape((n, n), order="F")

    def unpack(self, triangle: PackedTriangle[Real]) -> npt.NDArray[Real]:
        """Unpack a triangle for a caller that only reads it, like :meth:`unpack_copy`.

        If the space still contains this triangle, it is not unpacked again: a factor that solves
        several times in a row unpacks L only once.
        """
        n = triangle.n
        if self._unpacked is not triangle:
            self.unpack_copy(triangle)
            self._unpacked = triangle
        square = self._entries.view(triangle.entries.dtype)[: n * n]
        return square.reshape((n, n), order="F")


def pack(S: Array) -> Array:
    """Return the lower triangle of a matrix, (n, n), in packed format, (n (n + 1) / 2,)."""
    return lapack.dtrttp(S, uplo="L")[0] if len(S) else np.zeros(0)


def pack_single(S: Single) -> Single:
    """Return the lower triangle of a matrix like :func:`pack`, in single precision."""
    return lapack.strttp(S, uplo="L")[0] if len(S) else np.zeros(0, dtype=np.float32)


def unpack(packed: npt.NDArray[Real], n: int, square: npt.NDArray[Real]) -> None:
    """Write a packed triangle, (n (n + 1) / 2,), into a square, (at least n²,), by columns.

    Both are in double or in single precision. SciPy's dtpttr would create the square and fill it
    with zeros first, which takes ten times as long.
    """
    order = ctypes.c_int(n)
    info = ctypes.c_int(0)
    n_address = ctypes.addressof(order)
    info_address = ctypes.addressof(info)
    tpttr = _tpttr(packed.dtype.char)
    tpttr(b"L", n_address, packed.ctypes.data, square.ctypes.data, n_address, info_address)


@functools.cache
def _tpttr(precision: str) -> Callable[..., None]:
    """Return LAPACK's xTPTTR for the type code ``d`` or ``f`` of NumPy."""
    prototype = ctypes.CFUNCTYPE(None, ctypes.c_char_p, *[ctypes.c_void_p] * 5)
    return prototype(address_of({"d": "dtpttr", "f": "stpttr"}[precision]))
