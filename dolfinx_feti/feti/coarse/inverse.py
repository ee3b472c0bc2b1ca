# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Rows of the inverse of a small coarse matrix, N⁻¹, on each process."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.coarse.fronts import SharedFronts
from dolfinx_feti.feti.subdomain.factors.protocol import FactorInertia
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all

#: Condition number in the maximum norm up to which the inverse is used. It multiplies the rounding
#: errors of a product, and those of a factor hardly. On a cube with rods that are 1e8 times
#: stiffer, 1e10 takes 1000 iterations instead of 54; 1e5 takes 54, too.
MAX_INVERSE_CONDITION = 1e8


class RowsOfInverse:
    """The rows of N⁻¹ of this process, for a symmetric N; a ``solver.CoarseFactor``.

    Attributes:
        kind: ``inverse``.
        processes: Number of processes that have rows.
        rows: The rows, (n_c, N_c).
        factor: The factor of N that they are computed with.
    """

    kind = "inverse"

    def __init__(self, rows: Array, factor: SharedFronts, processes: int) -> None:
        """Own the factor."""
        self.rows = rows
        self.factor = factor
        self.processes = processes

    @property
    def inertia(self) -> FactorInertia:
        """No negative eigenvalues, and no zero pivots."""
        return self.factor.inertia

    def solve_own_rows(self, b_all: Array) -> Array:
        """Return the part of N⁻¹ b of this process, (N_c,) → (n_c,)."""
        return np.asarray(self.rows @ b_all)

    def memory(self) -> float:
        """Return the memory of the factor, and of the rows of all processes, in MiB."""
        N_c = self.rows.shape[1]
        return self.factor.memory() + self.rows.itemsize * N_c**2 / 2**20

    def destroy(self) -> None:
        """Free the factor."""
        self.factor.destroy()


def accurate_inverse(N: PETSc.Mat, factor: SharedFronts) -> RowsOfInverse | None:
    """Compute the rows of N⁻¹ of this process. Collective.

    Args:
        N: Symmetric coarse matrix, (N_c, N_c).
        factor: Its factor, one of each process. The result owns it.

    Returns:
        The rows; None if N is too badly conditioned for products with N⁻¹.
    """
    comm = N.comm.tompi4py()
    rows = slice(*N.getOwnershipRange())

    def compute_rows() -> Array:
        unit = np.zeros((N.getSize()[0], rows.stop - rows.start))
        np.fill_diagonal(unit[rows], 1.0)
        return np.ascontiguousarray(factor.solve(unit).T)  # columns of N⁻¹ = N⁻ᵀ

    inverse = on_all(compute_rows, comm)
    norm = np.abs(inverse).sum(axis=1).max(initial=0.0)  # ‖N⁻¹‖∞ is the largest of all processes
    condition = norm * N.norm(PETSc.NormType.INFINITY)
    is_accurate = comm.allreduce(bool(condition <= MAX_INVERSE_CONDITION), op=MPI.LAND)
    return RowsOfInverse(inverse, factor, comm.size) if is_accurate else None
