# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The Dirichlet preconditioner, M = B_D S B_Dᵀ.

(eq. 50; eq. 51.) If the interior is kept, the stabilisation Z has rows on interior dofs, which are
eliminated,

.. math:: Y_Z = (Z_Γ - K_{ΓI} X)\, C^{-⊤}, \qquad X = K_{II}^{-1} Z_I, \qquad
          C C^⊤ = I + Z_I^⊤ X,

so that :math:`S + Y_Z Y_Z^⊤` is the Schur complement of :math:`K + Z Z^⊤`. If
:math:`I + Z_I^⊤ X` is not positive definite, :math:`K_{II}` is indefinite and there is no C. Then
:math:`Y_Z = Z_Γ`, as for the other preconditioners. The choice changes M and thus the iterations,
but not the solution.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from dolfinx_feti.feti.preconditioners.base import Preconditioner
from dolfinx_feti.feti.subdomain.blocks import multiply_block
from dolfinx_feti.feti.subdomain.panels import Panels
from dolfinx_feti.runtime.arrays import Array


class Dirichlet(Preconditioner):
    """The Dirichlet preconditioner, Y = S, with the harmonic extension E_Γ."""

    needs_interior_factors = True

    def multiply(self, w: Array) -> Array:
        """Return S w, (n,)."""
        return self.operator.multiply(w)  # S w

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return S_i W, (n_{Γ,i}, k)."""
        return self.operator.by_subdomain[i].multiply_panels(W)

    def unbalanced_force(self, w: Array, Yw: Array) -> Array:
        """Return K E_Γ w, (n,), which is S w = Y w."""
        return Yw

    def extend(self, w: Array) -> Array:
        """Extend an interface displacement harmonically to the interior, E_Γ w, (n,)."""
        operator = self.operator
        if operator.is_interior_eliminated:
            return w
        return operator.extend(w, np.zeros_like(w))

    def condense_stabilisation(self, i: int, Z: Array) -> Array:
        """Return Y_Z of subdomain i, (n_{Γ,i}, q), with the interior rows of Z eliminated.

        Args:
            i: Number of the subdomain on this process.
            Z: Columns of its stabilisation, (n_i, q); (n_{Γ,i}, q) if the interior is eliminated.
        """
        if self.operator.is_interior_eliminated:
            return Z
        S_i = self.operator.by_subdomain[i]
        subdomain = S_i.subdomain
        Z_Γ = Z[subdomain.is_on_interface]
        Z_I = Z[~subdomain.is_on_interface]
        if Z.shape[1] == 0 or len(Z_I) == 0:
            return Z_Γ
        X = S_i.solve_interior(Z_I)  # X = K_II⁻¹ Z_I
        try:
            C = np.linalg.cholesky(np.eye(Z.shape[1]) + Z_I.T @ X)  # C Cᵀ = I + Z_Iᵀ X
        except np.linalg.LinAlgError:  # K_II is indefinite
            return Z_Γ
        K_ΓI_X = multiply_block(self.operator.torn.K, subdomain.interface, subdomain.interior, X)
        return scipy.linalg.solve_triangular(
            C, (Z_Γ - K_ΓI_X).T, lower=True
        ).T  # (Z_Γ − K_ΓI X) C⁻ᵀ
