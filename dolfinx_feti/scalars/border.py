# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The border that m scalars add to a matrix A, and block elimination with it.

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

__all__ = ["BlockElimination", "Border", "without_zeros"]

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
        spring_count: Number k of the last scalars, which are forces of springs (``springs``). The
            right-hand sides of their equations are zero.
    """

    B: Array
    C: Array
    D: Array
    spring_count: int = 0

    @property
    def count(self) -> int:
        """Number of the other scalars, m − k."""
        return len(self.D) - self.spring_count

    @classmethod
    def zero(cls, N: int, m: int) -> Border:
        """Return a border of zeros for N dofs and m scalars."""
        return cls(np.zeros((N, m)), np.zeros((N, m)), np.zeros((m, m)))

    def with_springs(self, d: Array) -> Array:
        """Return values of the other scalars, (m − k,), with zeros for the springs, (m,)."""
        return np.concatenate([d, np.zeros(self.spring_count)])

    def without_springs(self, s: Array) -> Array:
        """Return the values s, (m,), of the other scalars, (m − k,)."""
        return s[: self.count]


class BlockElimination:
    """Block elimination in a bordered system, with X = A⁻¹ B or an approximation of it.

    Given y = A⁻¹ b, the solution is

        (D − Cᵀ X) s = d − Cᵀ y,    x = y − X s.

    S = D − Cᵀ X is stored in its singular value decomposition, on all processes.

    Attributes:
        border: B, C and D.
        X: A⁻¹ B, (N, m).
        is_singular: Whether S is singular, and the bordered matrix with it.
    """

    def __init__(self, border: Border, X: Array, comm: MPI.Comm) -> None:
        """Compute and factor S. Collective.

        Args:
            border: B, C and D.
            X: A⁻¹ B, (N, m).
            comm: Communicator.
        """
        self.border = border
        self.X = X
        self._comm = comm
        S = border.D - total_of(border.C.T @ X, comm)  # S = D − Cᵀ X
        self._row_scales = np.ones(len(S))
        self._column_scales = np.ones(len(S))
        for _ in range(SCALING_SWEEPS):
            size = np.abs(self._scaled(S))
            self._row_scales /= np.sqrt(without_zeros(size.max(axis=1)))
            self._column_scales /= np.sqrt(without_zeros(size.max(axis=0)))
        U, σ, Vt = on_all(lambda: np.linalg.svd(self._scaled(S)), comm)
        self._U = U
        self._singular_values = σ
        self._Vt = Vt
        self.is_singular = not (np.isfinite(σ).all() and σ[-1] > SINGULAR_RTOL * σ[0])

    def _scaled(self, S: Array) -> Array:
        """Return S with scaled rows and columns, (m, m)."""
        return np.asarray(self._row_scales[:, None] * S * self._column_scales)

    def solve(self, y: Array, d: Array) -> tuple[Array, Array]:
        """Return the solution for y = A⁻¹ b and d. Collective.

        Args:
            y: A⁻¹ b or an approximation of it, (N,).
            d: Second right-hand side, (m,).

        Returns:
            x, (N,), and s, (m,). If S is singular (``is_singular``), these are y and zeros, which
            solve nothing.
        """
        s = self.solve_for_scalars(y, d)
        return y - self.X @ s, s  # x = y − X s

    def solve_for_scalars(self, y: Array, d: Array) -> Array:
        """Return s of :meth:`solve` alone, (m,). Collective."""
        return self._solve_complement(d - total_of(self.border.C.T @ y, self._comm))

    def error_of_scalars(self, ds: Array, s: Array, x: Array) -> float:
        r"""Return the estimated error η of the scalars for a correction of them. Collective.

        It is the largest :math:`|δs_k|` relative to the size of s_k,

        .. math:: |s_k| + \sum_l |S^{-1}|_{kl} \Bigl(\sum_j C_{jl}^2 x_j^2\Bigr)^{1/2}.

        The second term matters if s_k is about zero because contributions of x cancel: s_k is
        accurate to their rounding only. The forces of springs do not count.

        Args:
            ds: Correction δs of the scalars without springs, (m − k,).
            s: These scalars, or their largest sizes among several iterates.
            x: x, or the largest sizes of x_j among several iterates, (N,).
        """
        if not len(ds):
            return 0.0
        row_sizes = np.sqrt(total_of((self.border.C**2).T @ x**2, self._comm))  # (Σ_j C_jl² x_j²)^½
        size = np.abs(s) + self.border.without_springs(self._absolute_inverse() @ row_sizes)
        ratio = np.full(len(ds), np.inf)
        np.divide(np.abs(ds), size, out=ratio, where=size > 0.0)
        ratio[ds == 0.0] = 0.0
        return float(ratio.max())

    def _solve_complement(self, d: Array) -> Array:
        """Return S⁻¹ d, (m,); zeros if S is singular."""
        if self.is_singular:
            return np.zeros(len(d))
        z = self._U.T @ (self._row_scales * d)
        return np.asarray(self._column_scales * (self._Vt.T @ (z / self._singular_values)))

    def _absolute_inverse(self) -> Array:
        """Return the absolute values of the entries of S⁻¹, (m, m)."""
        columns = [self._solve_complement(unit) for unit in np.eye(len(self._singular_values))]
        return np.abs(np.array(columns).T)


def without_zeros(x: npt.ArrayLike) -> Array:
    """Return an array with ones in place of zeros."""
    return np.where(np.asarray(x) == 0.0, 1.0, x)
