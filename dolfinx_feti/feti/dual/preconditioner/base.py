# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""What the preconditioners of the dual operator have in common: M = B_D Y B_Dᵀ.

.. math:: M = \sum_i B_{D,i}\, Y_i\, B_{D,i}^⊤, \qquad
          Y_i = θ I,\; K_i,\; \begin{pmatrix} 0 & 0 \\ 0 & S_i \end{pmatrix}, \qquad
          S_i = K_{ΓΓ} - K_{ΓI} K_{II}^{-1} K_{IΓ}

(eq. 46, Augustin_eq:feti_preconditioner); the paper writes :math:`M^{-1}` for this matrix. A file
of its own holds each Y. Where a subdomain buckles alone, Y_i is that of the stabilised one,
:math:`K_+ = K + Z Z^⊤` (``pseudoinverse``): :math:`Y_Z Y_Z^⊤` is added, with :math:`Y_Z = Z_Γ` or,
where Y eliminates the interior, Z condensed to the interface (``dirichlet``).

With the jump r = B u − c, the displacement :math:`u - E_Γ B_D^⊤ r`, whose copies agree, leaves the
*unbalanced force* :math:`t = K E_Γ B_D^⊤ r`, so that :math:`\|T^⊤ t\|` is the residual of the
*assembled* system. :math:`E_Γ` extends w harmonically to the interior for the Dirichlet
preconditioner and where the interior is eliminated, by zero otherwise.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy.sparse

from dolfinx_feti.feti.dual.linear_map import LinearMap
from dolfinx_feti.feti.gluing.weights import Weights
from dolfinx_feti.feti.subdomain.blocks import block_diagonal, on_subdomains
from dolfinx_feti.feti.subdomain.operator import Operator
from dolfinx_feti.feti.subdomain.panels import Panels

__all__ = ["Preconditioner"]

Array = npt.NDArray[np.float64]


class Preconditioner(ABC):
    """M = B_D Y B_Dᵀ of one matrix; a subclass says what Y does on the torn interface.

    Attributes:
        operator: K and S of every subdomain.
        B_D: Scaled jumps, (m, n).
        energetic: Whether Y is the energy of an extended interface displacement, E_Γᵀ K E_Γ.
        stabilisation: Y_Z of each subdomain, (n_Γ, q_i).
    """

    energetic = True

    def __init__(self, operator: Operator, weights: Weights, Z: Sequence[Array]) -> None:
        """Take K, S, B_D and the columns Z of K₊ = K + Z Zᵀ on the dofs of each matrix."""
        self.operator = operator
        self.B_D = LinearMap(weights.B_D)
        self._Γ = np.concatenate([*operator.interface, np.zeros(0, dtype=np.int32)])
        self.stabilisation, self._Y_Z = on_subdomains(
            lambda: self._stabilisation(Z), operator.torn.comm
        )

    def _stabilisation(self, Z: Sequence[Array]) -> tuple[list[Array], scipy.sparse.csr_array]:
        """Return Y_Z of each subdomain, and of all together."""
        blocks = [self.condense_stabilisation(i, Z_i) for i, Z_i in enumerate(Z)]
        return blocks, block_diagonal(blocks)

    def apply(self, r: Array) -> tuple[Array, Array]:
        """Return z = M r, (m,), and the unbalanced force t, (n,), of a jump r, (m,). Collective."""
        w = self.B_D.T @ r  # w = B_Dᵀ r
        t = self.multiply(w)  # t = Y w
        force = t.copy()
        if self._Y_Z.shape[1]:
            force[self._Γ] += self._Y_Z @ (self._Y_Z.T @ w[self._Γ])
        return self.B_D @ force, self.unbalanced(w, t)  # z = B_D (Y + Y_Z Y_Zᵀ) w

    def image(self, i: int, W: Panels) -> Array:
        """Return (Y_i + Y_Z Y_Zᵀ) W for columns on the interface, (n_Γ, r) → (n_Γ, r)."""
        Y, Y_Z = self.multiply_panels(i, W), self.stabilisation[i]
        return Y + Y_Z @ W.overlap(Y_Z).T if Y_Z.shape[1] else Y

    @abstractmethod
    def multiply(self, w: Array) -> Array:
        """Return Y w, (n,) → (n,), for a w that is zero off the interface."""

    @abstractmethod
    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return Y_i W for block-sparse columns on the interface, (n_Γ, r) → (n_Γ, r)."""

    def unbalanced(self, w: Array, t: Array) -> Array:
        """Return the force K E_Γ w, (n,), where t = Y w is known."""
        operator = self.operator
        return operator.multiply(w) if operator.eliminated else operator.torn.multiply(w)

    def extend(self, w: Array) -> Array:
        """Extend an interface displacement to the interior, E_Γ w, (n,)."""
        return w

    def to_interface(self, i: int, X: Array) -> Array:
        """Move forces X on subdomain i to its interface, E_Γᵀ X, (n_i, r) → (n_Γ, r)."""
        return X[self.operator.on_interface[i]]

    def condense_stabilisation(self, i: int, Z: Array) -> Array:
        """Return Y_Z for Z on the dofs of subdomain i, (n_i, q) → (n_Γ, q)."""
        return self.to_interface(i, Z)

    def destroy(self) -> None:
        """Free the work vectors."""
        self.B_D.destroy()
