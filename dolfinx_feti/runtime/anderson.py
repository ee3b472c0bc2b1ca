# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Anderson's acceleration of a fixed-point iteration U = g(U).

The next iterate is a combination of the last ones. With the differences :math:`Δ\mathcal U` of the
iterates and :math:`Δ\mathcal F` of their residuals F = g(U) − U, the coefficients γ minimise the
linearised residual,

.. math:: γ = \arg\min \|F - Δ\mathcal F\, γ\|, \qquad
    U ← U + F - (Δ\mathcal U + Δ\mathcal F)\, γ

(H. F. Walker and P. Ni, SIAM Journal on Numerical Analysis 49, 2011, formula 2.2 with β = 1). The
normal equations are solved: of the distributed vectors they need scalar products only. They are
scaled to a unit diagonal first, because the differences shrink by orders of magnitude as the
iteration converges.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from dolfinx_feti.runtime.arrays import Array

#: Number of differences that are combined. A memory bound: two vectors for each.
DEPTH = 20

#: Largest eigenvalue of the scaled normal equations, relative to the largest of all, that counts as
#: rounding. Eigenvalues are squares of singular values of Δ𝓕 with unit columns: differences that
#: depend on others to 1e-6 are dropped.
EIGENVALUE_RTOL = 1e-12


class Anderson:
    """The acceleration of one fixed point, on vectors distributed over processes."""

    def __init__(self, comm: MPI.Comm, n_owned: int) -> None:
        """Create an acceleration without iterates.

        Args:
            comm: Communicator.
            n_owned: Number of entries that this process owns, the first ones of its vectors. Scalar
                products sum over these, not over ghosts.
        """
        self._comm = comm
        self._n_owned = n_owned
        self._iterates: list[tuple[Array, Array]] = []  # the last ones, (U, F), oldest first

    def next(self, U: Array, F: Array) -> Array:
        """Return the next iterate, (n,); U + F at the first call, without differences. Collective.

        Args:
            U: The last iterate, (n,), ghosts included.
            F: Its residual g(U) − U, (n,).
        """
        self._iterates = [*self._iterates[-DEPTH:], (U.copy(), F.copy())]  # DEPTH differences
        changes_of_U = np.diff([iterate for iterate, _ in self._iterates], axis=0)  # (Δ𝓤)ᵀ
        changes_of_F = np.diff([residual for _, residual in self._iterates], axis=0)  # (Δ𝓕)ᵀ
        owned = changes_of_F[:, : self._n_owned]  # (differences, n_owned)
        A = self._comm.allreduce(owned @ owned.T)  # Δ𝓕ᵀ Δ𝓕
        b = self._comm.allreduce(owned @ F[: self._n_owned])  # Δ𝓕ᵀ F
        scale = 1.0 / np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
        inverse = np.linalg.pinv(scale[:, None] * A * scale, EIGENVALUE_RTOL)
        γ = scale * (inverse @ (scale * b))
        return U + F - γ @ (changes_of_U + changes_of_F)  # U + F − (Δ𝓤 + Δ𝓕) γ
