# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The dense matrix :math:`S_i` in packed format: products, and copies for a factorisation.

.. math:: S X, \qquad S_ρ = S + ρ\, R R^⊤ + \operatorname{diag} σ

Products with one or a few columns read the packed triangle; others unpack it into a work space.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg.blas as blas

from dolfinx_feti.errors import FactorError
from dolfinx_feti.feti.subdomain.factors.work_space import PackedTriangle, WorkSpace, unpack
from dolfinx_feti.feti.subdomain.panels import Panels
from dolfinx_feti.runtime.arrays import Array, Single

#: Largest number of columns for which a product or solve reads the packed triangle, once for each
#: column, instead of unpacking it. Both ways take the same time with 4 columns for 300 rows, 5 for
#: 1000, and 6 to 8 for 2000 rows. With 3 or 12 instead of 6, products with numbers of columns in
#: between take up to 1.8 times as long.
MAX_PACKED_COLUMNS = 6

#: Rows of a tile that is transposed at once. Two tiles of 96² doubles, 144 KiB, fit into the
#: second-level cache of a core. With 48 or 192 rows the time changes by less than 15 %.
TILE = 96

#: Mask of the entries below the diagonal of a tile.
BELOW_DIAGONAL = np.tri(TILE, k=-1, dtype=bool)


class PackedMatrix:
    """A dense symmetric matrix S, (n, n), in packed format.

    Attributes:
        values: The lower triangle, (n (n + 1) / 2,).
        n: Number of rows.
        work: Work space of the products, and of the factors of S.
    """

    def __init__(self, values: Array, n: int, work: WorkSpace) -> None:
        """Refer to the entries without copying them; they must not change later.

        Raises:
            FactorError: An entry is NaN or Inf.
        """
        if not np.isfinite(values).all():
            raise FactorError(
                "a Schur complement has entries that are NaN or Inf: the interior of the subdomain "
                "is singular, or its matrix is not finite"
            )
        self.values = values
        self.n = n
        self.work = work
        self._triangle = PackedTriangle(values, n)

    def multiply(self, t: Array) -> Array:
        """Return S t, (n,)."""
        return blas.dspmv(self.n, 1.0, self.values, t, lower=1) if self.n else np.zeros(0)

    def multiply_many(self, X: Array) -> Array:
        """Return S X for dense columns, (n, r)."""
        if X.size == 0:
            return np.zeros(X.shape)
        if X.shape[1] <= MAX_PACKED_COLUMNS:
            return np.column_stack([self.multiply(x) for x in X.T])
        S = self.work.unpack(self._triangle)
        return blas.dsymm(1.0, S, np.asfortranarray(X), lower=1)

    def multiply_panels(self, W: Panels) -> Array:
        """Return S W for block-sparse columns, (n, r)."""
        if self.n == 0:
            return W.dense()
        S = _mirror(self.work.unpack_copy(self._triangle))  # C reads rows of the square
        return W.premultiply(S)

    def unpack_regularised(self, R: Array, rho: float, shift: Array | None = None) -> Array:
        """Return S + ρ R Rᵀ + diag(shift) in the work space, for the caller to factor in place.

        Args:
            R: Columns, (n, k).
            rho: Stiffness ρ.
            shift: Addend of the diagonal, (n,); None for zero.

        Returns:
            The lower triangle, (n, n) in Fortran's order, valid until the work space is used again.
        """
        X = self.work.unpack_copy(self._triangle)
        if shift is not None:
            X[np.diag_indices(self.n)] += shift
        if R.shape[1] == 0:
            return X
        return blas.dsyrk(rho, R, beta=1.0, c=X, lower=1, overwrite_c=1)

    def unpack_regularised_in_single_precision(self, R: Array, rho: float) -> Single:
        """Return S/ρ + R Rᵀ in the work space, like :meth:`unpack_regularised`.

        The division by ρ, a mean stiffness, keeps entries of any unit within the range of floats.
        """
        packed = (self.values / rho).astype(np.float32)
        X = self.work.unpack_copy(PackedTriangle(packed, self.n))
        if R.shape[1] == 0:
            return X
        return blas.ssyrk(1.0, R.astype(np.float32), beta=1.0, c=X, lower=1, overwrite_c=1)

    def copy_in_single_precision(self, square: Single) -> Single:
        """Write the lower triangle of S in single precision into memory of the caller.

        Args:
            square: The memory, of at least n² entries.

        Returns:
            A view of it, (n, n) in Fortran's order; entries above the diagonal are arbitrary.
        """
        unpack(self.values.astype(np.float32), self.n, square)
        return square[: self.n**2].reshape((self.n, self.n), order="F")

    def memory(self) -> float:
        """Return the memory of the entries in MiB."""
        return self._triangle.memory()


def _mirror(L: Array) -> Array:
    """Copy the lower triangle of a matrix in Fortran's order, (n, n), to the upper one in place.

    Returns:
        The same memory as a symmetric matrix row by row, (n, n) in C's order.
    """
    n = len(L)
    A = L.T  # the entries are above its diagonal, and are copied below it
    for first in range(0, n, TILE):
        end = min(first + TILE, n)
        A[end:, first:end] = A[first:end, end:].T  # the rows below the tile
        tile = A[first:end, first:end]  # on the diagonal
        rows = end - first
        np.copyto(tile, tile.T.copy(), where=BELOW_DIAGONAL[:rows, :rows])
    return A
