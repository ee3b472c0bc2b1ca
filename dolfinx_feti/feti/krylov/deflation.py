# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Deflation of the primal method by Ritz vectors of earlier solves.

Under pressure a few soft, nearly buckling fields of the whole wall have small eigenvalues; they
change little from one matrix to the next. Their Ritz vectors Z of one solve, made A-orthogonal to
the averaged coarse space V for the present matrix, :math:`Z ← Π Z`, extend the projection and the
start:

.. math:: z ← Π z - Z H^{-1} (A Z)^⊤ z, \qquad x_0 = V A_0^{-1} V^⊤ b + Z H^{-1} Z^⊤ b, \qquad
          H = Z^⊤ A Z.

A negative eigenvalue of H is a direction of negative curvature.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.coarse.averaged import AveragedSpace
from dolfinx_feti.feti.copies import Copies

__all__ = ["DeflatedSpace"]

Array = npt.NDArray[np.float64]

#: Energy below which a combination of directions of unit energy is dropped.
DEPENDENT = 1e-10


class DeflatedSpace:
    """The averaged coarse space with directions of earlier solves.

    Attributes:
        Z: The directions by their copies, with :math:`Z^⊤ A Z` = diag(±1), (n, r).
        AZ: Their images by copies, (n, r).
    """

    def __init__(
        self,
        space: AveragedSpace,
        copies: Copies,
        Z: Array,
        multiply: Callable[[Array], Array],
    ) -> None:
        """Fit the directions to the present matrix.

        Args:
            space: The averaged coarse space of the present matrix.
            copies: Copies of the interface dofs.
            Z: Directions by their copies, (n, r).
            multiply: Applies S of every subdomain, (n,) → (n,).

        Note:
            Collective.
        """
        self._space, self._copies = space, copies
        Z = _columns(space.project, Z)
        AZ = _columns(lambda z: copies.sum(multiply(z)), Z)
        H = self._products(Z, AZ)
        size = np.sqrt(np.abs(H.diagonal()))
        scale = np.divide(1.0, size, where=size > 0.0, out=np.zeros_like(size))
        values, Q = np.linalg.eigh(scale[:, None] * 0.5 * (H + H.T) * scale)
        kept = np.abs(values) > DEPENDENT
        Q = scale[:, None] * Q[:, kept] / np.sqrt(np.abs(values[kept]))
        self._sign = np.sign(values[kept])
        self.Z, self.AZ = Z @ Q, AZ @ Q

    def start(self, r: Array) -> Array:
        """Return V A₀⁻¹ Vᵀ r + Z H⁻¹ Zᵀ r of an assembled residual, by copies, (n,). Collective."""
        return self._space.start(r) + self.Z @ (self._sign * self._products(self.Z, r))

    def project(self, z: Array) -> Array:
        """Return Π z − Z H⁻¹ (A Z)ᵀ z, of and by copies, (n,). Collective."""
        return self._space.project(z) - self.Z @ (self._sign * self._products(self.AZ, z))

    def negative_direction(self) -> Array | None:
        """Return the copies of a field v with vᵀ A v < 0, (n,); None if none is known."""
        negative = np.flatnonzero(self._sign < 0.0)
        if len(negative):
            return np.array(self.Z[:, negative[0]])
        return self._space.negative_direction()

    def _products(self, X: Array, Y: Array) -> Array:
        """Return the scalar products of assembled columns, Xᵀ Y. Collective."""
        local = (X.T * self._copies.delta) @ Y
        return np.asarray(self._copies.comm.allreduce(local))


def _columns(apply: Callable[[Array], Array], X: Array) -> Array:
    """Apply a map to each column, (n, r) → (n, r)."""
    return np.column_stack([apply(x) for x in X.T]) if X.shape[1] else X
