# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The assembled matrix on its free dofs, scaled by its diagonal d, and what it does to motions.

.. math:: \hat A = d^{-1/2} A\, d^{-1/2}, \qquad \hat w = d^{1/2} w, \qquad
          \hat A\, \hat w = d^{-1/2} A\, w

which makes forces and motions independent of units. A motion w is a single-valued field on the torn
dofs, zero on Dirichlet dofs; several motions are columns, (n, k).
"""

from __future__ import annotations

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.rounding import EPS, product_rounding_squares


class ScaledMatrix:
    """The assembled matrix, scaled by its diagonal.

    Attributes:
        root_share: Square root of 1/multiplicity of each torn dof, (n,): with this weight, a norm
            over all torn dofs counts each assembled dof once.
        root_diagonal: :math:`d^{1/2}`, (n,).
    """

    def __init__(self, torn: Torn) -> None:
        """Assemble the diagonal; zeros, which cannot be divided by, become its mean. Collective."""
        self._torn = torn
        d = torn.tear(torn.assemble(np.abs(torn.diagonal())))
        mean = torn.comm.allreduce(d.sum()) / max(torn.comm.allreduce(torn.n), 1)
        self.root_share = np.sqrt(1.0 / torn.tear(torn.multiplicity()))
        self.root_diagonal = np.sqrt(np.where(d > 0.0, d, mean or 1.0))

    def diagonal_quotient(self) -> float:
        """Return the quotient of the largest and the smallest diagonal entry of A. Collective."""
        comm = self._torn.comm
        smallest = min(comm.allgather(self.root_diagonal.min(initial=np.inf)))
        largest = max(comm.allgather(self.root_diagonal.max(initial=0.0)))
        return float((largest / smallest) ** 2) if largest > 0.0 else 1.0

    def sizes(self, W: Array) -> Array:
        r"""Return columns whose norms over all processes are :math:`\|\hat w\|`, (n, k)."""
        return (self.root_share * self.root_diagonal)[:, None] * W

    def forces(self, W: Array) -> Array:
        r"""Return columns whose norms over all processes are :math:`\|\hat A \hat w\|`, (n, k).

        Collective.
        """
        torn = self._torn
        image = np.empty_like(W)
        for j in range(W.shape[1]):
            image[:, j] = torn.tear(torn.assemble(torn.multiply(W[:, j])))
        image[torn.dirichlet_copies] = 0.0
        return image * (self.root_share / self.root_diagonal)[:, None]

    def force_rounding(self, W: Array) -> Array:
        r"""Estimate the norms of the rounding errors of :math:`\hat A \hat w`, (k,). Collective.

        Both the product and the entries of :math:`\hat w` have rounding errors.
        """
        torn = self._torn
        weight = (self.root_share / self.root_diagonal) ** 2
        squares = np.empty((2, W.shape[1]))
        for j in range(W.shape[1]):
            of_force = torn.tear(
                torn.assemble(product_rounding_squares(torn.K, W[:, j]))
            )  # squares, (n,)
            squares[0, j] = (of_force * weight)[~torn.dirichlet_copies].sum()
        squares[1] = EPS**2 * (self.sizes(W) ** 2).sum(axis=0)
        of_product, of_motion = np.sqrt(total_of(squares, torn.comm))
        return np.asarray(of_product + of_motion)
