# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The assembled interface operator A and its preconditioner.

.. math:: A = T^⊤ S\, T, \qquad z = Π\, M r + V A_0^{-1} V^⊤ r + W H^{-1} W^⊤ r, \qquad
          M = T^⊤ δ\, K_ρ^{-1} δ\, T

with V, W and the projection Π of ``deflation`` (Mandel, Balancing domain decomposition, 1993;
Fragakis, Papadrakakis, The mosaic of high performance domain decomposition methods, 2003). An
assembled vector x is stored by its copies T x on the interfaces of the subdomains of a process,
(n_Γ,); scalar products weight the copies with δ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dolfinx_feti.feti.interface.copies import Copies
from dolfinx_feti.feti.primal.deflation import DeflationSpace
from dolfinx_feti.runtime.arrays import Array


@dataclass(frozen=True, slots=True)
class PrimalSystem:
    """A and its preconditioner; vectors are stored by copies, (n_Γ,).

    Attributes:
        deflation: The coarse space V, extended by W, and its projection Π.
        multiply_local: Applies S of every subdomain, (n_Γ,) → (n_Γ,). Not collective.
        solve_local: Applies :math:`K_ρ^{-1}` of every subdomain, restricted to the interface,
            (n_Γ,) → (n_Γ,). Not collective.
    """

    deflation: DeflationSpace
    multiply_local: Callable[[Array], Array]
    solve_local: Callable[[Array], Array]

    @property
    def copies(self) -> Copies:
        """Copies of the interface dofs."""
        return self.deflation.copies

    def apply(self, x: Array) -> Array:
        """Return A x, (n_Γ,). Collective."""
        return self.copies.sum(self.multiply_local(x))  # T Tᵀ S T x

    def residual(self, f: Array, x: Array) -> Array:
        """Return b − A x, (n_Γ,), with b = Tᵀ f for a torn load f, (n_Γ,). Collective."""
        return self.copies.sum(f - self.multiply_local(x))  # T Tᵀ (f − S T x)

    def precondition(self, r: Array) -> tuple[Array, float]:
        """Return z = Π M r + V A₀⁻¹ Vᵀ r + W H⁻¹ Wᵀ r, (n_Γ,), and rᵀ z. Collective.

        If r is orthogonal to V and W, the last two terms are zero but for rounding errors. Without
        them these errors would remain in the iterates, as Π removes everything along V and W.
        """
        w = self.solve_local(self.copies.delta * r)  # w = K_ρ⁻¹ δ T r
        return self.deflation.correct(self.copies.average(w), r)

    def norm(self, r: Array) -> float:
        """Return ‖r‖ of the assembled vector. Collective."""
        return float(np.sqrt(self.copies.dots((r, r))[0]))
