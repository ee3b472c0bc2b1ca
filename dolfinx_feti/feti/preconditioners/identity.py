# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The identity preconditioner, M = θ B_D B_Dᵀ.

(eq. 46, which has θ = 1.) θ is the mean stiffness of an interface dof, the mean of the diagonal of
K on the interface [kPa mm for a displacement]. The preconditioned dual system has two groups of
eigenvalues: those of M F, and the eigenvalue 1 from the constraint preconditioner
(``dual/system``). With this θ those of M F are around one, too. With θ = 1 they depend on the
units, and a wide gap between the groups slows the Krylov method down.
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.feti.preconditioners.base import Preconditioner
from dolfinx_feti.feti.subdomain.panels import Panels
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
from dolfinx_feti.runtime.arrays import Array


class Identity(Preconditioner):
    """The identity preconditioner, Y = θ I.

    Attributes:
        theta: Mean stiffness θ of an interface dof; 1 if no interface dof has a stiffness.
    """

    def __init__(self, operator: SchurOperator, B_D: PETSc.Mat, Z: Sequence[Array]) -> None:
        """Compute θ. Collective.

        Args:
            operator: K and S of the subdomains.
            B_D: Scaled jump operator; its owner destroys it.
            Z: Columns of the stabilisation of each subdomain; see the base class.
        """
        super().__init__(operator, B_D, Z)
        stiffness = np.abs(operator.torn.diagonal()[self._Γ])
        total, count = operator.torn.comm.allreduce(np.array([stiffness.sum(), len(stiffness)]))
        self.theta = total / count if total > 0.0 else 1.0

    def multiply(self, w: Array) -> Array:
        """Return θ w, (n,)."""
        return self.theta * w

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return θ W, (n_{Γ,i}, k)."""
        return self.theta * W.dense()
