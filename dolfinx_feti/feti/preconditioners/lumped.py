# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The lumped preconditioner, M = B_D K B_Dᵀ.

(eq. 49.) It needs no factors of K_II.
"""

from __future__ import annotations

from dolfinx_feti.feti.preconditioners.base import Preconditioner
from dolfinx_feti.feti.subdomain.blocks import multiply_block
from dolfinx_feti.feti.subdomain.panels import Panels
from dolfinx_feti.runtime.arrays import Array


class Lumped(Preconditioner):
    """The lumped preconditioner, Y = K, of which M only uses the block K_ΓΓ."""

    def multiply(self, w: Array) -> Array:
        """Return K w, (n,)."""
        return self.operator.torn.multiply(w)  # K w

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return K_ΓΓ W, (n_{Γ,i}, k)."""
        Γ = self.operator.by_subdomain[i].subdomain.interface
        return multiply_block(self.operator.torn.K, Γ, Γ, W.dense())  # K_ΓΓ W

    def unbalanced_force(self, w: Array, Yw: Array) -> Array:
        """Return K E_Γ w, (n,), which is K w = Y w if the interior is kept."""
        if self.operator.is_interior_eliminated:
            return super().unbalanced_force(w, Yw)
        return Yw
