# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The assembled matrix on its free dofs, scaled by its diagonal d, and what it does to motions.

.. math:: \hat A = d^{-1/2} A\, d^{-1/2}, \qquad \hat w = d^{1/2} w, \qquad
          \hat A\, \hat w = d^{-1/2} A\, w

which makes forces and motions independent of units. A motion w is a single-valued field on the torn
dofs, zero on Dirichlet dofs; several motions are columns, (n, k).

A scaled motion or force is stored on the torn dofs, too. In addition it is divided by the square
root of the multiplicity of each dof. Norms and products over the torn dofs of all processes are
then those of assembled vectors, which have each dof once.
"""

from __future__ import annotations

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import total_of
from dolfinx_feti.torn.matrix import Torn
from dolfinx_feti.torn.rounding import EPS, product_rounding_squares


class ScaledAssembledMatrix:
    r"""The matrix :math:`\hat A`.

    Attributes:
        root_share: Square root of 1/multiplicity of each torn dof, (n,).
        root_diagonal: :math:`d^{1/2}`, (n,).
        motion_weight: What a motion w is multiplied by to scale it, (n, 1).
        force_weight: What a force A w is multiplied by to scale it, (n, 1).
    """

    def __init__(self, torn: Torn) -> None:
        """Assemble the diagonal; zeros, which cannot be divided by, become its mean. Collective."""
        self._torn = torn
        d = torn.tear(torn.assemble(np.abs(torn.diagonal())))
        mean = torn.comm.allreduce(d.sum()) / max(torn.comm.allreduce(torn.n), 1)
        self.root_share = np.sqrt(1.0 / torn.tear(torn.multiplicity()))
        self.root_diagonal = np.sqrt(np.where(d > 0.0, d, mean or 1.0))
        self.motion_weight = (self.root_share * self.root_diagonal)[:, None]
        self.force_weight = (self.root_share / self.root_diagonal)[:, None]

    def diagonal_quotient(self) -> float:
        """Return the quotient of the largest and the smallest diagonal entry of A. Collective.

        Zero entries are left out: the constructor has replaced them by the mean.
        """
        comm = self._torn.comm
        smallest = min(comm.allgather(self.root_diagonal.min(initial=np.inf)))
        largest = max(comm.allgather(self.root_diagonal.max(initial=0.0)))
        return float((largest / smallest) ** 2) if largest > 0.0 else 1.0

    def scale_motions(self, W: Array) -> Array:
        r"""Return the scaled motions :math:`\hat w`, (n, k)."""
        return self.motion_weight * W

    def scaled_forces(self, W: Array) -> Array:
        r"""Return the scaled forces :math:`\hat A \hat w` of motions w, (n, k). Collective."""
        torn = self._torn
        forces = np.empty_like(W)
        for j in range(W.shape[1]):
            forces[:, j] = torn.tear(torn.assemble(torn.multiply(W[:, j])))  # A w
        forces[torn.is_dirichlet_copy] = 0.0
        return forces * self.force_weight

    def force_rounding(self, W: Array) -> Array:
        r"""Estimate the norms of the rounding errors of :math:`\hat A \hat w`, (k,). Collective.

        Both the product and the entries of :math:`\hat w` have rounding errors.
        """
        torn = self._torn
        weight_squares = self.force_weight[:, 0] ** 2
        squares = np.empty((2, W.shape[1]))
        for j in range(W.shape[1]):
            error_squares = torn.assemble(product_rounding_squares(torn.K, W[:, j]))
            scaled_squares = torn.tear(error_squares) * weight_squares
            squares[0, j] = scaled_squares[~torn.is_dirichlet_copy].sum()
        squares[1] = EPS**2 * (self.scale_motions(W) ** 2).sum(axis=0)
        of_product, of_motion = np.sqrt(total_of(squares, torn.comm))
        return np.asarray(of_product + of_motion)
