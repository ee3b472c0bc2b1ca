# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Anderson's acceleration of a fixed point U = g(U).

Of the last differences :math:`Δ\mathcal U, Δ\mathcal F` of the iterates and of their residuals
F = g(U) − U it takes the combination that leaves the least residual,

.. math:: γ = \arg\min \|F - Δ\mathcal F\, γ\|, \qquad
    U ← U + F - (Δ\mathcal U + Δ\mathcal F)\, γ .

Source: Walker and Ni, SIAM Journal on Numerical Analysis 49 (2011), formula 2.2 with β = 1.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from dolfinx_feti.runtime.arrays import Array

#: Differences that are kept.
DEPTH = 20

#: Directions of a smaller share of the largest eigenvalue are rounding.
SMALL = 1e-12


class Anderson:
    """The last iterates of a fixed point, vectors of which each process has a part.

    The first ``owned`` entries are this process's, the others ghosts.
    """

    def __init__(self, comm: MPI.Comm, owned: int) -> None:
        self._comm, self._owned = comm, owned
        self._last: tuple[Array, Array] | None = None
        self._differences: list[tuple[Array, Array]] = []  # ΔU, ΔF

    def next(self, U: Array, F: Array) -> Array:
        """Return the next iterate from U and its residual F. Collective."""
        if self._last is not None:
            self._differences.append((U - self._last[0], F - self._last[1]))
            del self._differences[:-DEPTH]
        self._last = U.copy(), F.copy()
        new = U + F
        if self._differences:
            for share, (of_U, of_F) in zip(self._shares(F), self._differences, strict=True):
                new -= share * (of_U + of_F)
        return new

    def _shares(self, F: Array) -> Array:
        """Return γ from the normal equations of the scaled differences."""
        rows = np.stack([of_F[: self._owned] for _, of_F in self._differences])
        A, b = self._comm.allreduce(rows @ rows.T), self._comm.allreduce(rows @ F[: self._owned])
        scale = 1.0 / np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
        return scale * (np.linalg.pinv(scale[:, None] * A * scale, SMALL) @ (scale * b))
