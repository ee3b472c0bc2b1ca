# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Factors of every sparse block of a process, each by fronts, or with pivots where these fail."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.subdomain.direct import Pivots
from dolfinx_feti.feti.subdomain.sparse.factors import BlockFactors
from dolfinx_feti.feti.subdomain.sparse.fronts import FrontCode, Fronts
from dolfinx_feti.petsc_library import Rows
from dolfinx_feti.torn import Torn

__all__ = ["FrontsOrPivots"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]


class FrontsOrPivots:
    """Factors by fronts or with pivots, never both of a block; methods are those of ``Factors``.

    Attributes:
        rows: Rows of each block, a slice where they are consecutive.
    """

    def __init__(self, torn: Torn, dofs: Sequence[Indices], pivoted: BlockFactors) -> None:
        """Prepare factors; nothing is analysed yet.

        Args:
            torn: The torn matrix, symmetric.
            dofs: Torn dofs of the fronts of each block; no dof is in two of them.
            pivoted: Prepared factors with pivots; destroyed with these.
        """
        self.rows = pivoted.rows
        self._torn = torn
        self._dofs = list(dofs)
        self._pivoted = pivoted
        self._fronts: list[Fronts | None] = [None] * len(self._dofs)
        self._number = np.full(torn.n, -1, dtype=np.int32)
        for rows in self._dofs:
            self._number[rows] = np.arange(len(rows))

    def update_block(
        self, i: int, R: Array | None = None, rho: float = 1.0, *, shift: Array | None = None
    ) -> None:
        """Factor block i of the present matrix with pivots; see ``Factors``."""
        self._release(i)
        self._pivoted.update_block(i, R, rho, shift=shift)

    def solve(self, y: Array, x: Array) -> None:
        """Solve with every block: ``x[rows_i] = K_i⁻¹ y[rows_i]``, other entries untouched."""
        for i, rows in enumerate(self.rows):
            x[rows] = self._solve(i, y[rows])

    def solve_many(self, i: int, Y: Array, *, transpose: bool = False) -> Array:
        """Solve with block i for several right-hand sides, (n_i, r) → (n_i, r)."""
        return self._solve(i, Y)

    def _solve(self, i: int, y: Array) -> Array:
        """Solve with block i, (n_i,) or (n_i, r)."""
        fronts = self._factored(i)
        if fronts is not None:
            return fronts.solve(y)
        Y = y if y.ndim == 2 else y[:, None]
        return self._pivoted.solve_many(i, Y).reshape(y.shape)

    def solve_border(self, i: int) -> tuple[Array, Array]:
        """Return E/ρ, (n_i, k), and −D/ρ², (k, k), of a block with a border."""
        return self._pivoted.solve_border(i)

    def pivots(self, i: int) -> Pivots:
        """Count negative and zero eigenvalues of block i."""
        return self._pivoted.pivots(i) if self._factored(i) is None else Pivots(0, 0)

    def memory(self) -> float:
        """Return the memory of all factors of this process in MiB."""
        fronts = sum(fronts.memory() for fronts in self._fronts if fronts is not None)
        return fronts + self._pivoted.memory()

    def destroy(self) -> None:
        """Free the factors."""
        for i in range(len(self._fronts)):
            self._release(i)
        self._pivoted.destroy()

    def _analysed(self, i: int, K: Rows, interface: Indices, code: FrontCode) -> Fronts:
        """Return the fronts of block i, which are found once.

        Args:
            i: Number of the block.
            K: The torn matrix, row by row.
            interface: Which of the dofs are not eliminated, ascending.
            code: What ``load_fronts`` returns.
        """
        fronts = self._fronts[i]
        if fronts is None:
            bs = self._torn.K.getBlockSize()
            fronts = Fronts(code, K, self._dofs[i], self._number, bs, interface)
            self._fronts[i] = fronts
        return fronts

    def _factored(self, i: int) -> Fronts | None:
        """Return the fronts of block i, if they have a factor."""
        fronts = self._fronts[i]
        return fronts if fronts is not None and fronts.factored else None

    def _release(self, i: int) -> None:
        """Free the factor of block i by fronts."""
        fronts = self._fronts[i]
        if fronts is not None:
            fronts.release()
