# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Block-sparse columns: panels, each with a few nonzero rows.

.. math:: W = (W_1, W_2, …), \qquad S\, W_p = S_{:, r_p} (W_p)_{r_p}, \qquad
          W_p^⊤ Y = (W_p)_{r_p}^⊤ Y_{r_p}

with the rows :math:`r_p` of panel p, (n, c) in all: the coarse columns of a neighbour are zero but
on the dofs that the two share.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.gluing.copies import consecutive

__all__ = ["Panels"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]


class Panels:
    """W, (n, c), panel by panel.

    Attributes:
        shape: n and c.
    """

    def __init__(self, n: int, rows: Sequence[Integers], values: Sequence[Array]) -> None:
        """Take the panels.

        Args:
            n: Number of rows of W.
            rows: Rows of each panel, each row once, (m_p,).
            values: What each panel has on them, transposed, (c_p, m_p).
        """
        columns = consecutive([len(panel) for panel in values])
        reached = [slice(n) if len(r) == n else r for r in rows]
        self._panels = list(zip(columns, reached, values, strict=True))
        self.shape = n, sum(len(panel) for panel in values)

    def dense(self) -> Array:
        """Return W, (n, c)."""
        W = np.zeros(self.shape[::-1])
        for columns, rows, values in self._panels:
            W[columns, rows] = values
        return W.T

    def product(self, S: Array) -> Array:
        """Return S W, (n, c), for a symmetric S, (n, n), given row by row."""
        Y = np.empty(self.shape[::-1])
        for columns, rows, values in self._panels:
            np.matmul(values, S[rows], out=Y[columns])  # (S W_p)ᵀ = W_pᵀ S
        return Y.T

    def overlap(self, Y: Array) -> Array:
        """Return Wᵀ Y, (n, r) → (c, r)."""
        E = np.empty((self.shape[1], Y.shape[1]))
        for columns, rows, values in self._panels:
            np.matmul(values, Y[rows], out=E[columns])  # W_pᵀ Y
        return E

    def squares(self) -> Array:
        """Return the squares of the norms of all columns, (c,)."""
        squares = [(values**2).sum(axis=1) for _, _, values in self._panels]
        return np.concatenate([np.zeros(0), *squares])
