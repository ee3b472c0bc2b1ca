# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""What the preconditioners of the dual operator have in common: M = B_D Y B_Dᵀ.

.. math:: M = \sum_i B_{D,i}\, Y_i\, B_{D,i}^⊤, \qquad
          Y_i = θ I,\; K_i,\; \begin{pmatrix} 0 & 0 \\ 0 & S_i \end{pmatrix}, \qquad
          S_i = K_{ΓΓ} - K_{ΓI} K_{II}^{-1} K_{IΓ}

(eq. 46, Augustin_eq:feti_preconditioner); the paper writes :math:`M^{-1}` for this matrix. A file
of its own holds each Y: ``identity``, ``lumped``, ``dirichlet``.

Under prestress a subdomain may buckle where the whole body does not. Then Y_i has negative
eigenvalues, M is indefinite, and the coarse matrix :math:`G^⊤ M G + D` may come close to a singular
one. So all but the plain ``none`` take the propped subdomain :math:`K_+ = K + Z Z^⊤`
(``pseudoinverse``): to Y_i they add

.. math:: Y_Z Y_Z^⊤, \qquad Y_Z = Z_Γ

or, where Y eliminates the interior, the props condensed to the interface (``dirichlet``). A wall at
30 mmHg needs a quarter to a half of the iterations with it.

With the jump r = B u − c, the displacement :math:`u - E_Γ B_D^⊤ r`, whose copies agree, leaves the
*unbalanced force* :math:`t = K E_Γ B_D^⊤ r`, so that :math:`\|T^⊤ t\|` is the residual of the
*assembled* system. :math:`E_Γ` extends an interface displacement to the interior: harmonically for
the Dirichlet preconditioner and wherever the interior is eliminated, by zero otherwise. The
Dirichlet preconditioner has this force at hand, for the others it costs a product with K.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt
import scipy.sparse

from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.linear_map import LinearMap
from dolfinx_feti.feti.panels import Panels
from dolfinx_feti.feti.subdomain.matrices import SubdomainMatrices
from dolfinx_feti.feti.subdomain.sparse.factors import Factors
from dolfinx_feti.torn import Torn

__all__ = ["Preconditioner"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]


class Preconditioner(ABC):
    """M = B_D Y B_Dᵀ; a subclass says what Y does on the torn interface.

    Attributes:
        torn: The torn matrix.
        matrices: The matrix of each subdomain, K on its free dofs or S on the interface.
        glued: Torn dofs of the interface, (n_Γ,).
        on_interface: Mask of the glued ones among the dofs of the matrix of each subdomain.
        interface: Glued free dofs Γ of each subdomain.
        interior: The other dofs I of each subdomain on which its matrix lives.
        factors: Interior factors, if the preconditioner has any.
        energetic: Whether Y is the energy of an extended interface displacement, E_Γᵀ K E_Γ.
        props: The props Y_Z of each subdomain, (n_Γ, q_i); after :meth:`update`.
    """

    factors: Factors | None = None
    energetic = True

    def __init__(
        self,
        torn: Torn,
        gluing: Gluing,
        matrices: SubdomainMatrices,
        *,
        symmetric: bool,
        prefix: str,
    ) -> None:
        """Sort the dofs into interface and interior.

        Args:
            torn: The torn matrix.
            gluing: Its jump operators.
            matrices: The matrix of each subdomain, K on its free dofs or S on the interface.
            symmetric: Whether K is symmetric.
            prefix: Options prefix of the interior factorisations.
        """
        self.torn = torn
        self.matrices = matrices
        self.symmetric = symmetric
        self.prefix = prefix
        self.glued = gluing.glued
        self._B_D = gluing.B_D
        self.B_D = LinearMap(gluing.B_D)
        glued = np.zeros(torn.n, dtype=bool)
        glued[gluing.glued] = True
        self.on_interface = [glued[rows] for rows in matrices.dofs]
        pairs = list(zip(matrices.dofs, self.on_interface, strict=True))
        self.interface = [rows[on] for rows, on in pairs]
        self.interior = [rows[~on] for rows, on in pairs]
        self._Γ = np.concatenate([*self.interface, np.zeros(0, dtype=np.int32)])

    def weigh(self) -> None:  # noqa: B027
        """Take the weights of the current K, if there are any.

        Note:
            Collective.
        """

    def update(self, props: list[Array]) -> None:
        """Take over the current K.

        Args:
            props: Columns Z of K₊ = K + Z Zᵀ for each subdomain, on the dofs of its matrix.

        Raises:
            FactorError: A factorisation failed. Not collective: the caller reduces.
        """
        self._prop([Z[on] for Z, on in zip(props, self.on_interface, strict=True)])

    def apply(self, r: Array) -> tuple[Array, Array]:
        """Apply the preconditioner to a jump.

        Args:
            r: Local part of the jump, (m,).

        Returns:
            z = M r, (m,), and the force t that the averaged displacement leaves unbalanced, (n,).

        Note:
            Collective.
        """
        w = self.B_D.T @ r  # w = B_Dᵀ r
        t = self.multiply(w)  # t = Y w
        return self.B_D @ (t + self._held(w)), self.unbalanced(w, t)  # z = B_D (Y + Y_Z Y_Zᵀ) w

    @property
    def multiple(self) -> float | None:
        """θ, if M = θ I without scaled jumps; None otherwise."""
        return None

    def image(self, i: int, W: Panels) -> Array:
        """Return Y_i W with props for columns on the interface, (n_Γ, r) → (n_Γ, r)."""
        Y_Z = self.props[i]
        return self.multiply_panels(i, W) + Y_Z @ W.overlap(Y_Z).T

    @abstractmethod
    def multiply(self, w: Array) -> Array:
        """Return Y w without props, (n,) → (n,), for a w that is zero off the interface."""

    @abstractmethod
    def multiply_many(self, i: int, W: Array) -> Array:
        """Return Y_i W without props for columns on the interface, (n_Γ, r) → (n_Γ, r)."""

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return what :meth:`multiply_many` does for columns that fall into panels."""
        return self.multiply_many(i, W.dense())

    def unbalanced(self, w: Array, t: Array) -> Array:
        """Return the force K E_Γ w, (n,), where t = Y w is known."""
        return self.matrices.multiply(w)

    def extend(self, w: Array) -> Array:
        """Extend an interface displacement to the interior, E_Γ w, (n,)."""
        return w

    def to_interface(self, i: int, X: Array) -> Array:
        """Move forces X on subdomain i to its interface, E_Γᵀ X, (n_i, r) → (n_Γ, r)."""
        return X[self.on_interface[i]]

    def _prop(self, props: list[Array]) -> None:
        """Hold the subdomains by the props Y_Z, (n_Γ, q_i) each."""
        self.props = props
        together = scipy.sparse.block_diag(props, format="csr") if props else (0, 0)
        self._all_props = scipy.sparse.csr_array(together)

    def _held(self, w: Array) -> Array:
        """Return the force of the props, (n,)."""
        t = np.zeros_like(w)
        if self._all_props.shape[1]:
            Y_Z = self._all_props
            t[self._Γ] = Y_Z @ (Y_Z.T @ w[self._Γ])  # Y_Z Y_Zᵀ w
        return t

    def destroy(self) -> None:
        """Free the work vectors and factors."""
        self.B_D.destroy()
        if self.factors is not None:
            self.factors.destroy()
