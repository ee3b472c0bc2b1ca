# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The weights δ of the copies of a dof, and the scaled jump operator B_D, of one matrix.

The scaled jump operator of the preconditioners weighs a copy by the *other* side's stiffness k,

.. math:: δ_i = k_i / \sum_j k_j, \qquad (B_D)_{ij} = (δ_j, -δ_i),

or k = 1 for multiplicity: :math:`u - B_D^⊤ B u` averages copies. A Dirichlet row has weight one.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.gluing.jump import Gluing
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.torn.matrix import Torn

__all__ = ["Weights", "create_weights"]


#: Least share of a copy in the stiffness of its dof.
LEAST = 1e-12


@dataclass(frozen=True, slots=True)
class Weights:
    """The weights of the copies.

    Attributes:
        delta: Weight δ of every torn dof, (n,); the copies of a dof sum to one.
        B_D: Scaled jumps, of the shape and pattern of B.
    """

    delta: Array
    B_D: PETSc.Mat

    def destroy(self) -> None:
        """Free the matrix."""
        self.B_D.destroy()


def create_weights(torn: Torn, gluing: Gluing, k: Array) -> Weights:
    """Weigh the copies of each dof by stiffnesses k ≥ 0, (n,). Collective."""
    total = torn.tear(torn.assemble(k))
    k = np.where(total > 0.0, np.maximum(k, LEAST * total), 1.0)  # no share is zero
    delta = np.asarray(k / torn.tear(torn.assemble(k)))  # δᵢ = kᵢ / Σⱼ kⱼ
    return Weights(delta, gluing.create_jumps(torn, gluing.scaled(torn.gather(delta))))
