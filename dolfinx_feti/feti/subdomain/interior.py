# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Factors of the interior of every subdomain, by fronts or with pivots.

Those of :math:`K_{II}` come from its fronts (``fronts``), together with S. Where it is not positive
definite, as inside a wall that buckles, :math:`L Δ L^⊤` with pivots takes their place
(``factors``), and tells the inertia.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.subdomain.direct import Pivots
from dolfinx_feti.feti.subdomain.factors import BlockFactors
from dolfinx_feti.feti.subdomain.fronts import FrontCode, Fronts
from dolfinx_feti.petsc_library import Rows
from dolfinx_feti.torn import Torn

__all__ = ["InteriorFactors"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]


class InteriorFactors:
    """Factors of every K_II of the process; the methods are those of ``Factors``.

    Attributes:
        rows: Rows of each block, a slice where they are consecutive.
    """

    def __init__(self, torn: Torn, free: Sequence[Indices], pivoted: BlockFactors) -> None:
        """Prepare factors; nothing is analysed yet.

        Args:
            torn: The torn matrix, symmetric.
            free: Free torn dofs of each subdomain.
            pivoted: Prepared factors with pivots; destroyed with these.
        """
        self._torn = torn
        self._free = free
        self._pivoted = pivoted
        self._fronts: list[Fronts | None] = [None] * len(free)
        self._number = np.full(torn.n, -1, dtype=np.int32)
        for rows in free:
            self._number[rows] = np.arange(len(rows))
        self.rows = pivoted.rows

    def schur_complement(
        self, i: int, K: Rows, interface: Indices, code: FrontCode, work: Array
    ) -> tuple[Array | None, Array]:
        """Factor K_II of subdomain i by fronts, and form S.

        Args:
            i: Number of the subdomain.
            K: The torn matrix, row by row.
            interface: Which of its free dofs are Γ, ascending.
            code: What ``load_fronts`` returns.
            work: Work space of an earlier call, (any,).

        Returns:
            S in packed format, None if K_II is not positive definite; the work space.
        """
        fronts = self._fronts[i]
        if fronts is None:
            bs = self._torn.K.getBlockSize()
            fronts = Fronts(code, K, self._free[i], self._number, bs, interface)
            self._fronts[i] = fronts
        if len(work) < fronts.work:
            work = np.empty(fronts.work)
        return fronts.factor(K, work), work

    def update_block(
        self, i: int, R: Array | None = None, rho: float = 1.0, *, shift: Array | None = None
    ) -> None:
        """Factor block i of the present matrix with pivots; see ``BlockFactors``."""
        self._release(i)
        self._pivoted.update_block(i, R, rho, shift=shift)

    def solve(self, y: Array, x: Array) -> None:
        """Solve with every block: ``x[rows_i] = K_i⁻¹ y[rows_i]``, other entries untouched."""
        for i, rows in enumerate(self.rows):
            fronts = self._factored(i)
            if fronts is None:
                x[rows] = self._pivoted.solve_many(i, y[rows][:, None])[:, 0]
            else:
                x[rows] = fronts.solve(y[rows])

    def solve_many(self, i: int, Y: Array, *, transpose: bool = False) -> Array:
        """Solve with block i for several right-hand sides, (n_i, r) → (n_i, r)."""
        fronts = self._factored(i)
        if fronts is None:
            return self._pivoted.solve_many(i, Y, transpose=transpose)
        return fronts.solve(Y)

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

    def _factored(self, i: int) -> Fronts | None:
        fronts = self._fronts[i]
        return fronts if fronts is not None and fronts.factored else None

    def _release(self, i: int) -> None:
        fronts = self._fronts[i]
        if fronts is not None:
            fronts.release()
