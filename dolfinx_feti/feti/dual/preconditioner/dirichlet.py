# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The Dirichlet preconditioner, Y = S (eq. 50, Augustin_eq:DirichletVK; eq. 51).

The stabilisation Z (``base``) has a part inside where the interior is kept, which is condensed,

.. math:: Y_Z = (Z_Γ - K_{ΓI} X)\, C^{-⊤}, \qquad X = K_{II}^{-1} Z_I, \qquad
          C C^⊤ = I + Z_I^⊤ X.

If I + Z_Iᵀ X is not positive definite, so that K_II is not, :math:`Y_Z = Z_Γ` takes its place; for
an unsymmetric K its symmetric part is taken.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.linalg

from dolfinx_feti.feti.dual.preconditioner.base import Preconditioner
from dolfinx_feti.feti.subdomain.orthonormal import symmetric_part
from dolfinx_feti.feti.subdomain.panels import Panels

__all__ = ["Dirichlet"]

Array = npt.NDArray[np.float64]


class Dirichlet(Preconditioner):
    """M = B_D S B_Dᵀ."""

    def multiply(self, w: Array) -> Array:
        """Return S w, (n,)."""
        return self.operator.multiply(w)  # S w

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return S_i W for block-sparse columns, (n_Γ, r)."""
        return self.operator.multiply_panels(i, W)

    def unbalanced(self, w: Array, t: Array) -> Array:
        """Return K E_Γ w = S w, which is t."""
        return t

    def extend(self, w: Array) -> Array:
        """Extend an interface displacement harmonically, (n,)."""
        operator = self.operator
        return w if operator.eliminated else operator.extend(w, np.zeros_like(w))

    def to_interface(self, i: int, X: Array) -> Array:
        """Condense forces on subdomain i to its interface, (n_i, r) → (n_Γ, r)."""
        return self.operator.condense_many(i, X)  # X_Γ − K_ΓI K_II⁻¹ X_I

    def condense_stabilisation(self, i: int, Z: Array) -> Array:
        """Return Y_Z for Z on the dofs of subdomain i, (n_i, q) → (n_Γ, q)."""
        inside = ~self.operator.on_interface[i]
        if Z.shape[1] == 0 or not np.any(inside):
            return Z[~inside]
        X = self.operator.interior_factors[i].solve(Z[inside])  # X = K_II⁻¹ Z_I
        try:
            C2 = np.eye(Z.shape[1]) + Z[inside].T @ X
            C = np.linalg.cholesky(symmetric_part(C2))
        except np.linalg.LinAlgError:  # K_II itself is indefinite
            return Z[~inside]
        Y = self.to_interface(i, Z)
        return scipy.linalg.solve_triangular(C, Y.T, lower=True).T  # (Z_Γ − K_ΓI X) C⁻ᵀ
