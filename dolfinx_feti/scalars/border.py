# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The border that m scalars add to a matrix A, and the Schur complement S of A.

.. math:: \begin{pmatrix} A & B \\ C^⊤ & D \end{pmatrix}, \qquad S = D - C^⊤ X, \quad A X = B

B and C, (N, m), have the rows of this process; D and S, (m, m), are on all processes. The scalars
may have any units: S is scaled to rows and columns of size one before it is factored.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all, total_of

__all__ = ["Border", "BorderComplement", "without_zeros"]

#: Smallest singular value of the scaled S, relative to the largest, at which the bordered matrix
#: counts as regular. Rounding leaves 1e-15 in a singular one. With X at the default tolerance of
#: 1e-8, an S as close to a singular one as this has no accurate digit.
SINGULAR_RTOL = 1e-12

#: Sweeps that scale rows and columns of S in turn. The first one scales all to about one. The
#: others bring them closer to one, at a cost that does not count for a matrix of this size.
SCALING_SWEEPS = 5


@dataclass(frozen=True, slots=True)
class Border:
    """What m scalars add to a matrix, with the rows of B and C of this process.

    Attributes:
        B: Columns, (N, m); rows of Dirichlet dofs count as zero.
        C: Rows of the equations, transposed, (N, m).
        D: Corner, (m, m).
    """

    B: Array
    C: Array
    D: Array

    def pad(self, d: Array) -> Array:
        """Return d, (up to m,), filled up with zeros, (m,).

        The scalars without an entry are the last ones. They are the forces of springs, whose
        equations have a zero right-hand side (``springs``).
        """
        return np.concatenate([d, np.zeros(len(self.D) - len(d))])


class BorderComplement:
    """S = D − Cᵀ X in its singular value decomposition, on all processes.

    Attributes:
        is_singular: Whether the bordered matrix is singular.
    """

    def __init__(self, border: Border, X: Array, comm: MPI.Comm) -> None:
        """Compute and factor S. Collective.

        Args:
            border: B, C and D.
            X: A⁻¹ B, (N, m).
            comm: Communicator.
        """
        S = border.D - total_of(border.C.T @ X, comm)  # S = D − Cᵀ X
        self._rows = np.ones(len(S))
        self._columns = np.ones(len(S))
        for _ in range(SCALING_SWEEPS):
            size = np.abs(self._scaled(S))
            self._rows /= np.sqrt(without_zeros(size.max(axis=1)))
            self._columns /= np.sqrt(without_zeros(size.max(axis=0)))
        U, σ, Vt = on_all(lambda: np.linalg.svd(self._scaled(S)), comm)
        self._U = U
        self._singular_values = σ
        self._Vt = Vt
        self.is_singular = not (np.isfinite(σ).all() and σ[-1] > SINGULAR_RTOL * σ[0])

    def _scaled(self, S: Array) -> Array:
        """Return S with scaled rows and columns, (m, m)."""
        return np.asarray(self._rows[:, None] * S * self._columns)

    def solve(self, d: Array) -> Array:
        """Return S⁻¹ d, (m,); zeros if S is singular."""
        if self.is_singular:
            return np.zeros(len(d))
        z = self._U.T @ (self._rows * d)
        return np.asarray(self._columns * (self._Vt.T @ (z / self._singular_values)))

    def absolute_inverse(self) -> Array:
        """Return the absolute values of the entries of S⁻¹, (m, m)."""
        columns = [self.solve(unit) for unit in np.eye(len(self._singular_values))]
        return np.abs(np.array(columns).T)


def without_zeros(x: npt.ArrayLike) -> Array:
    """Return an array with ones in place of zeros."""
    return np.where(np.asarray(x) == 0.0, 1.0, x)
