# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The identity preconditioner, Y = θ I (eq. 46, Augustin_eq:feti_preconditioner).

The paper has θ = 1. Here θ is the mean stiffness of an interface dof, which puts the spectrum of
M F around one, where the constraint preconditioner (``system``) has eigenvalues besides.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.dual.preconditioner.base import Preconditioner
from dolfinx_feti.feti.gluing.weights import Weights
from dolfinx_feti.feti.subdomain.operator import Operator
from dolfinx_feti.feti.subdomain.panels import Panels

__all__ = ["Identity"]

Array = npt.NDArray[np.float64]


class Identity(Preconditioner):
    """M = θ B_D B_Dᵀ.

    Attributes:
        theta: Mean stiffness of an interface dof.
    """

    energetic = False

    def __init__(self, operator: Operator, weights: Weights, Z: Sequence[Array]) -> None:
        """Find θ; see the base class. Collective."""
        super().__init__(operator, weights, Z)
        k = np.abs(operator.torn.diagonal()[self._Γ])
        total, count = operator.torn.comm.allreduce(np.array([k.sum(), len(k)]))
        self.theta = total / count if total > 0.0 else 1.0

    def multiply(self, w: Array) -> Array:
        """Return θ w, (n,)."""
        return self.theta * w

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return θ W, (n_Γ, r)."""
        return self.theta * W.dense()
