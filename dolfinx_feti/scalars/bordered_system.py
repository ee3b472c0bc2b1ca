# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""One bordered system: its product, its residual, and how accurate each column of X has to be.

.. math:: A\, x + B\, s = b, \quad C^⊤ x + D\, s = d
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.scalars.border import Border, without_zeros
from dolfinx_feti.torn.matrix import read_dirichlet_mask

__all__ = ["FIRST_RTOL", "BorderedSystem", "create_bordered_system", "norms_of_columns"]

#: Largest relative residual ‖B_k − A X_k‖/‖B_k‖ of a column, however small s_k is. The columns that
#: are left from an earlier matrix are first corrected up to it: the s that follows determines how
#: accurate each of them has to be. A choice, not measured.
FIRST_RTOL = 1e-2


@dataclass(frozen=True, slots=True)
class BorderedSystem:
    """One bordered system; A has the springs, and the border their forces.

    Attributes:
        A: Torn matrix.
        is_free: Mask of the dofs without a prescribed value, (N,).
        b: First right-hand side, zero on Dirichlet dofs, (N,).
        border: B, with zeros on Dirichlet dofs, C and D.
        d: Second right-hand side, (m,).
        b_norm: ‖b‖.
        B_norms: Norms of the columns B_k, (m,).
        comm: Communicator.
    """

    A: PETSc.Mat
    is_free: Mask
    b: Array
    border: Border
    d: Array
    b_norm: float
    B_norms: Array
    comm: MPI.Comm

    def scale(self, s: Array) -> float:
        """Return ‖b‖ + Σ ‖B_k‖ |s_k|, which relative residuals refer to."""
        return self.b_norm + float(np.abs(s) @ self.B_norms)

    def product(self, X: Array) -> Array:
        """Return A X with zeros on Dirichlet dofs, (N, k). Collective."""
        Y = np.zeros_like(X)
        with Lifetime() as owned:
            x, y = map(owned.own, self.A.createVecs())
            for k in range(X.shape[1]):
                x.array[:] = X[:, k]
                self.A.mult(x, y)
                Y[:, k] = np.where(self.is_free, y.array_r, 0.0)
        return Y

    def residual(self, x: Array, s: Array) -> tuple[Array, Array]:
        """Return b − A x − B s, (N,), and d − Cᵀ x − D s, (m,). Collective."""
        r = self.b - (self.product(x[:, None])[:, 0] + self.border.B @ s)
        c = self.d - total_of(self.border.C.T @ x, self.comm) - self.border.D @ s
        return r, c

    def allowed_residuals(self, s: Array, *, rtol: float, atol: float) -> Array:
        """Return the largest ‖B_k − A X_k‖ with which x and s meet the tolerances, (m,).

        Each of the m columns may contribute a share 1/m of the tolerance.

        Args:
            s: The scalars, (m,).
            rtol: Relative tolerance.
            atol: Absolute tolerance.
        """
        allowed = max(rtol * self.scale(s), atol) / without_zeros(len(s) * np.abs(s))
        return np.fmin(allowed, FIRST_RTOL * self.B_norms)


def create_bordered_system(A: PETSc.Mat, b: Array, border: Border, d: Array) -> BorderedSystem:
    """Create a bordered system. Collective.

    Args:
        A: Torn matrix, with the springs.
        b: First right-hand side, with any values on Dirichlet dofs, (N,).
        border: B, C and D of m scalars, of which the last k are the forces of the springs.
        d: Second right-hand side of the scalars without these forces, (m − k,).
    """
    comm = A.comm.tompi4py()
    is_free = ~read_dirichlet_mask(A)
    b = np.where(is_free, b, 0.0)
    B = np.where(is_free[:, None], border.B, 0.0)
    return BorderedSystem(
        A=A,
        is_free=is_free,
        b=b,
        border=replace(border, B=B),
        d=border.with_springs(d),
        b_norm=float(norms_of_columns(b[:, None], comm)[0]),
        B_norms=norms_of_columns(B, comm),
        comm=comm,
    )


def norms_of_columns(X: Array, comm: MPI.Comm) -> Array:
    """Return the norms of columns over all processes, (k,)."""
    return np.sqrt(total_of((X**2).sum(axis=0), comm))
