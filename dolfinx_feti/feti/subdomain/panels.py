# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Block-sparse columns: panels, each with a few nonzero rows; and products with them.

.. math:: W = (W_1, W_2, …), \qquad S\, W_p = S_{:, r_p} (W_p)_{r_p}, \qquad
          W_p^⊤ Y = (W_p)_{r_p}^⊤ Y_{r_p}, \qquad (S\, W)^⊤ z

W is (n, c), where n is :math:`n_{Γ,i}` of the subdomain; :math:`r_p` are the rows of panel p. The
coarse columns of a neighbour are such a panel: they vanish except on the dofs that the two
subdomains share. :math:`S\, W` is dense, and may be stored in single precision for the last
product. The products are computed in C (``panels.c``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.native import address_of, load_with_header, pointer


def load_panels(comm: MPI.Comm) -> Any:
    """Load the code, which is compiled at first use. Collective."""
    source = Path(__file__).with_name("panels.c")
    return load_with_header(source, comm, flags=("-O3", "-fopenmp-simd"))


@dataclass(frozen=True, slots=True)
class Panels:
    """W, (n, c), panel by panel.

    Attributes:
        code: The module that :func:`load_panels` returns.
        n: Number of rows of W.
        starts: Index in ``rows`` of the first row of each panel, and the end, (panels + 1,).
        rows: Rows of each panel, (Σ rows of a panel,); a panel has each row once at most.
        widths: Number of columns of each panel, (panels,).
        values: Values of the panels on their rows, one panel after the other, row by row,
            (Σ rows of a panel × columns of it,).
    """

    code: Any
    n: int
    starts: Indices
    rows: Indices
    widths: Indices
    values: Array

    def __post_init__(self) -> None:
        """Check that the arrays fit: C does not check its indices."""
        fault = self._fault()
        if fault:
            raise ValueError(f"{len(self.widths)} panels do not fit {self.n} rows: {fault}")

    def _fault(self) -> str:
        """Return how the arrays do not fit each other; an empty text if they do."""
        rows = np.diff(self.starts)
        if len(rows) != len(self.widths):
            return f"starts has {len(self.starts)} entries, not one more than there are panels"
        if self.starts[0] != 0 or self.starts[-1] != len(self.rows):
            return f"starts goes from {self.starts[0]} to {self.starts[-1]} of {len(self.rows)}"
        if rows.min(initial=0) < 0:
            return "starts decreases"
        if self.widths.min(initial=0) < 0:
            return "a width is negative"
        if len(self.values) != rows @ self.widths:
            return f"{len(self.values)} values for {rows @ self.widths} entries"
        if self.rows.min(initial=0) < 0 or self.rows.max(initial=-1) >= self.n:
            return f"rows go from {self.rows.min()} to {self.rows.max()}"
        return ""

    @property
    def shape(self) -> tuple[int, int]:
        """Return n and c."""
        return self.n, int(self.widths.sum())

    def dense(self) -> Array:
        """Return W, (n, c)."""
        dense_transposed = np.zeros(self.shape[::-1])
        sizes = np.diff(self.starts)  # rows of each panel
        # For each entry of ``rows``: columns of its panel, the first of them, place of its values.
        width = np.repeat(self.widths, sizes)
        first_column = np.repeat(np.cumsum(self.widths) - self.widths, sizes)
        first_value = np.cumsum(width) - width
        for j in range(int(self.widths.max(initial=0))):
            has_column = width > j
            values = self.values[first_value[has_column] + j]
            dense_transposed[first_column[has_column] + j, self.rows[has_column]] = values
        return dense_transposed.T

    def premultiply(self, S: Array) -> Array:
        """Return S W, (n, c), for a symmetric S, (n, n), stored by rows or by columns."""
        if S.shape != (self.n, self.n):
            raise ValueError(f"a matrix of shape {S.shape} does not fit {self.n} rows")
        product_transposed = np.empty(self.shape[::-1])  # (S W)ᵀ
        work = np.empty((self.n, self.n))  # the columns of S that a panel needs
        S = S if S.flags.c_contiguous else S.T
        self.code.lib.panels_premultiply(
            self._struct(),
            self._pointer(S),
            self._pointer(product_transposed),
            self._pointer(work),
            self._gemm,
        )
        return product_transposed.T

    def multiply_transposed(self, Y: Array, *, is_symmetric: bool = False) -> Array:
        """Return Wᵀ Y, (c, r), for dense columns.

        Args:
            Y: The columns, (n, r).
            is_symmetric: Whether the result is known to be symmetric, with r = c. Then only half of
                it is computed.
        """
        if len(Y) != self.n or (is_symmetric and Y.shape[1] != self.shape[1]):
            raise ValueError(f"columns of shape {Y.shape} do not fit panels of shape {self.shape}")
        result = np.empty((self.shape[1], Y.shape[1]))  # Wᵀ Y
        columns = np.ascontiguousarray(Y.T)
        work = np.empty(columns.shape)  # the rows of Y that a panel needs
        self.code.lib.panels_multiply_transposed(
            self._struct(),
            len(columns),
            self._pointer(columns),
            self._pointer(result),
            self._pointer(work),
            is_symmetric,
            self._gemm,
        )
        return result

    def squares(self) -> Array:
        """Return the squares of the norms of all columns, (c,)."""
        return np.asarray((self.dense() ** 2).sum(axis=0))

    @property
    def _gemm(self) -> Any:
        """The routine DGEMM of BLAS."""
        return self.code.ffi.cast("dgemm_routine", address_of("dgemm"))

    def _struct(self) -> Any:
        """Return W as a ``panels *``, which refers to the arrays of this object."""
        return self.code.ffi.new(
            "panels *",
            {
                "n": self.n,
                "count": len(self.widths),
                "starts": self._pointer(self.starts),
                "rows": self._pointer(self.rows),
                "widths": self._pointer(self.widths),
                "values": self._pointer(self.values),
            },
        )

    def _pointer(self, array: npt.NDArray[Any]) -> Any:
        """Return a pointer to the entries of an array, row by row."""
        return pointer(self.code, array)


def rows_product(code: Any, Y: npt.NDArray[np.floating], z: Array) -> Array:
    """Return Y z with sums in double precision, for the rows Y = (S W)ᵀ.

    Args:
        code: The module that :func:`load_panels` returns.
        Y: The rows in single or double precision, (c, n).
        z: A vector, (n,).

    Returns:
        The product, (c,).
    """
    if Y.dtype == np.float64:
        return np.asarray(Y @ z)
    c, n = Y.shape
    if z.shape != (n,):
        raise ValueError(f"a matrix of {n} columns does not fit a vector of shape {z.shape}")
    e = np.empty(c)
    z = np.ascontiguousarray(z)
    code.lib.rows_product(c, n, pointer(code, Y), pointer(code, z), pointer(code, e))
    return e
