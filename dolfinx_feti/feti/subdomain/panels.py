# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Block-sparse columns: panels, each with a few nonzero rows.

.. math:: W = (W_1, W_2, …), \qquad S\, W_p = S_{:, r_p} (W_p)_{r_p}, \qquad
          W_p^⊤ Y = (W_p)_{r_p}^⊤ Y_{r_p}

with the rows :math:`r_p` of panel p, (n, c) in all: the coarse columns of a neighbour are zero but
on the dofs that the two share. The products are C (``panels.c``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.native import address_of, load, pointer

DECLARATIONS = """
void panels_product(int, int, const int *, const int *, const int *, const double *,
                    const double *, double *, double *, void *);
void panels_overlap(int, int, const int *, const int *, const int *, const double *, int,
                    const double *, double *, double *, int, void *);
void rows_product(int, int, const float *, const double *, double *);
"""


def load_panels(comm: MPI.Comm) -> Any:
    """Load the code, which is compiled at first use. Collective."""
    source, flags = Path(__file__).with_name("panels.c"), ("-O3", "-fopenmp-simd")
    return load(source, DECLARATIONS, comm, flags=flags)


def rows_product(code: Any, Y: npt.NDArray[np.floating], z: Array) -> Array:
    """Return Y z, (c,), for Y, (c, n), in any precision, with sums in double precision."""
    if Y.dtype == np.float64:
        return np.asarray(Y @ z)
    if z.shape != (Y.shape[1],):
        raise ValueError(f"{Y.shape[1]} columns, but a vector of shape {z.shape}")
    to, e = partial(pointer, code), np.empty(len(Y))
    code.lib.rows_product(*Y.shape, to(Y), to(np.ascontiguousarray(z)), to(e))
    return e


@dataclass(frozen=True, slots=True)
class Panels:
    """W, (n, c), panel by panel.

    Attributes:
        code: What :func:`load_panels` returns.
        n: Number of rows of W.
        first: Where each panel begins among ``row``, and the end, (panels + 1,).
        row: Rows of each panel, each row once, (m,).
        count: Columns of each panel, (panels,).
        values: What the panels have on their rows, one after the other, row by row.
    """

    code: Any
    n: int
    first: Indices
    row: Indices
    count: Indices
    values: Array

    def __post_init__(self) -> None:
        """Check what C relies on."""
        rows, end = np.diff(self.first), len(self.row)
        fits = len(rows) == len(self.count) and self.first[0] == 0 and self.first[-1] == end
        fits = fits and min(rows.min(initial=0), self.count.min(initial=0)) >= 0
        fits = fits and len(self.values) == rows @ self.count
        if not fits or self.row.min(initial=0) < 0 or self.row.max(initial=-1) >= self.n:
            raise ValueError(f"{len(self.count)} panels do not fit {self.n} rows")

    @property
    def shape(self) -> tuple[int, int]:
        """Return n and c."""
        return self.n, int(self.count.sum())

    def dense(self) -> Array:
        """Return W, (n, c)."""
        W = np.zeros(self.shape[::-1])
        rows = np.diff(self.first)
        count = np.repeat(self.count, rows)  # by the entries of row
        column = np.repeat(np.cumsum(self.count) - self.count, rows)
        start = np.cumsum(count) - count
        for j in range(int(self.count.max(initial=0))):
            some = count > j
            W[column[some] + j, self.row[some]] = self.values[start[some] + j]
        return W.T

    def product(self, S: Array) -> Array:
        """Return S W, (n, c), for a symmetric S, (n, n)."""
        if S.shape != (self.n, self.n):
            raise ValueError(f"a matrix of shape {S.shape} does not fit {self.n} rows")
        Y, work = np.empty(self.shape[::-1]), np.empty((self.n, self.n))
        to, code = self._to, self.code
        S = S if S.flags.c_contiguous else S.T
        code.lib.panels_product(*self._pointers(), to(S), to(Y), to(work), self._gemm)
        return Y.T

    def overlap(self, Y: Array, *, symmetric: bool = False) -> Array:
        """Return Wᵀ Y, (n, r) → (c, r); with r = c it may be known to be ``symmetric``."""
        if len(Y) != self.n or (symmetric and Y.shape[1] != self.shape[1]):
            raise ValueError(f"columns of shape {Y.shape} do not fit panels of shape {self.shape}")
        E, columns = np.empty((self.shape[1], Y.shape[1])), np.ascontiguousarray(Y.T)
        work, to, code = np.empty(columns.shape), self._to, self.code
        arrays = to(columns), to(E), to(work)
        code.lib.panels_overlap(*self._pointers(), len(columns), *arrays, symmetric, self._gemm)
        return E

    def squares(self) -> Array:
        """Return the squares of the norms of all columns, (c,)."""
        return np.asarray((self.dense() ** 2).sum(axis=0))

    @property
    def _gemm(self) -> Any:
        return self.code.ffi.cast("void *", address_of("dgemm"))

    def _pointers(self) -> tuple[Any, ...]:
        sizes = self.n, len(self.count)
        arrays = map(self._to, (self.first, self.row, self.count))
        return *sizes, *arrays, self._to(self.values)

    def _to(self, array: npt.NDArray[Any]) -> Any:
        return pointer(self.code, array)
