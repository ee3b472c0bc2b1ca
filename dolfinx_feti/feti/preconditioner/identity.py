# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The identity preconditioner, Y = θ I (eq. 46, Augustin_eq:feti_preconditioner), and none at all.

The paper has θ = 1. Here θ is the mean stiffness of an interface dof, which puts the spectrum of
M F around one: the constraint preconditioner (``dual``) has eigenvalues one besides, and where the
others lie far from it, rounding errors grow without bound.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.preconditioner.base import Preconditioner

__all__ = ["Identity", "Unpreconditioned"]

Array = npt.NDArray[np.float64]


class Identity(Preconditioner):
    """M = θ B_D B_Dᵀ.

    Attributes:
        theta: Mean stiffness of an interface dof.
    """

    energetic = False

    theta = 1.0

    def weigh(self) -> None:
        """Find θ.

        Note:
            Collective.
        """
        k = np.abs(self.torn.diagonal()[self.glued])
        total, count = self.torn.comm.allreduce(np.array([k.sum(), len(k)]))
        self.theta = total / count if total > 0.0 else 1.0

    def multiply(self, w: Array) -> Array:
        """Return θ w, (n,)."""
        return self.theta * w

    def multiply_many(self, i: int, W: Array) -> Array:
        """Return θ W, (n_Γ, r)."""
        return self.theta * W


class Unpreconditioned(Identity):
    """M = θ I, without scaled jumps."""

    def apply(self, r: Array) -> tuple[Array, Array]:
        """Return θ r, (m,), and the unbalanced force, (n,)."""
        return self.theta * r, self.matrices.multiply(self.B_D.T @ r)

    @property
    def multiple(self) -> float:
        """θ."""
        return self.theta
