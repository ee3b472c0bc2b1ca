# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The lumped preconditioner, Y = K (eq. 49, Augustin_eq:LumpedVK): no factor, one product.

Of a displacement that is zero off the interface, K forms the energy :math:`w^⊤ K_{ΓΓ} w`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinx_feti.feti.dual.preconditioner.base import Preconditioner
from dolfinx_feti.feti.subdomain.blocks import product_many
from dolfinx_feti.feti.subdomain.panels import Panels

__all__ = ["Lumped"]

Array = npt.NDArray[np.float64]


class Lumped(Preconditioner):
    """M = B_D K B_Dᵀ."""

    def multiply(self, w: Array) -> Array:
        """Return K w, (n,)."""
        return self.operator.torn.multiply(w)  # K w

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return K_ΓΓ W, (n_Γ, r)."""
        Γ = self.operator.interface[i]
        return product_many(self.operator.torn.K, Γ, Γ, W.dense())  # K_ΓΓ W
