# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The Dirichlet preconditioner, Y = S (eq. 50, Augustin_eq:DirichletVK; eq. 51).

.. math:: S = K_{ΓΓ} - K_{ΓI} K_{II}^{-1} K_{IΓ}

S is either formed already, where the interior is eliminated (``matrices``), or applied with a
factor of :math:`K_{II}`. Props Z (``base``) have a part inside then, and are condensed with it,

.. math:: Y_Z = (Z_Γ - K_{ΓI} X)\, C^{-⊤}, \qquad X = K_{II}^{-1} Z_I, \qquad
          C C^⊤ = I + Z_I^⊤ X.

If I + Z_Iᵀ X is not positive definite, so that K_II is not, :math:`Y_Z = Z_Γ` takes its place; for
an unsymmetric K its symmetric part is taken.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.linalg

from dolfinx_feti.events import event
from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.panels import Panels
from dolfinx_feti.feti.preconditioner.base import Preconditioner
from dolfinx_feti.feti.subdomain.blocks import index_set, product_many
from dolfinx_feti.feti.subdomain.matrices import SubdomainMatrices
from dolfinx_feti.feti.subdomain.sparse.factors import Factors
from dolfinx_feti.feti.subdomain.sparse.regularised import create_factors
from dolfinx_feti.torn import Torn

__all__ = ["Dirichlet", "ImplicitDirichlet"]

Array = npt.NDArray[np.float64]


class Dirichlet(Preconditioner):
    """M = B_D S B_Dᵀ with the Schur complements of the subdomains' matrices."""

    def multiply(self, w: Array) -> Array:
        """Return S w, (n,)."""
        with event("FETISchurProduct"):
            return self.matrices.multiply(w)  # S w

    def multiply_many(self, i: int, W: Array) -> Array:
        """Return S_i W, (n_Γ, r)."""
        return self.matrices.multiply_many(i, W)

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return S_i W for columns that fall into panels, (n_Γ, r)."""
        return self.matrices.multiply_panels(i, W)

    def unbalanced(self, w: Array, t: Array) -> Array:
        """Return K E_Γ w = S w, which is t."""
        return t  # K E_Γ w = S w

    def condense(self, f: Array) -> Array:
        """Move a load to the interface, f_Γ − K_ΓI K_II⁻¹ f_I, (n,)."""
        return self.matrices.condense(f)

    def complete(self, u: Array, f: Array) -> Array:
        """Complete u on the interface by K_II⁻¹ (f_I − K_IΓ u_Γ) inside, (n,)."""
        return self.matrices.extend(u, f)


class ImplicitDirichlet(Dirichlet):
    """M = B_D S B_Dᵀ, with S applied by a factor of K_II.

    Besides one interior factor for each subdomain it keeps the interface rows of K, (n_Γ, n).
    """

    factors: Factors

    def __init__(
        self,
        torn: Torn,
        gluing: Gluing,
        matrices: SubdomainMatrices,
        *,
        symmetric: bool,
        prefix: str,
    ) -> None:
        """Prepare the interior factorisations; see the base class."""
        super().__init__(torn, gluing, matrices, symmetric=symmetric, prefix=prefix)
        self.factors = create_factors(torn, self.interior, prefix=prefix, symmetric=symmetric)
        self._rows_Γ = index_set(self._Γ)
        self._all = index_set(np.arange(torn.n, dtype=np.int32))
        self._rows: PETSc.Mat | None = None
        self._columns: PETSc.Mat | None = None

    def update(self, props: list[Array]) -> None:
        """Factor K_II, keep the interface rows of K and condense the props; see the base class."""
        for i in range(len(self.interior)):
            self.factors.update_block(i)
        self._rows = self.torn.K.createSubMatrix(self._rows_Γ, self._all, self._rows)  # K_Γ
        if not self.symmetric:
            self._columns = self.torn.K.createSubMatrix(self._all, self._rows_Γ, self._columns)
        self._prop([self._condensed(i, Z) for i, Z in enumerate(props)])

    def multiply(self, w: Array) -> Array:
        """Return S w, (n,), by one solve with K_II."""
        Γ, t = self._Γ, np.zeros_like(w)
        with event("FETISchurProduct"):
            y = self._interface_columns(w[Γ])  # y = K w
            x = np.zeros_like(y)
            self.factors.solve(y, x)  # x = K_II⁻¹ K_IΓ w
            t[Γ] = y[Γ] - _mult(self._rows, x)  # S w = K_ΓΓ w − K_ΓI x
        return t

    def multiply_many(self, i: int, W: Array) -> Array:
        """Return S_i W, (n_Γ, r)."""
        Γ, I = self.interface[i], self.interior[i]  # noqa: E741
        K = self.torn.K
        X = self.factors.solve_many(i, product_many(K, I, Γ, W))  # K_II⁻¹ K_IΓ W
        return product_many(K, Γ, Γ, W) - product_many(K, Γ, I, X)

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return S_i W for columns that fall into panels, (n_Γ, r)."""
        return self.multiply_many(i, W.dense())

    def extend(self, w: Array) -> Array:
        """Extend an interface displacement harmonically, (n,)."""
        x = np.zeros_like(w)
        self.factors.solve(self._interface_columns(w[self._Γ]), x)
        return w - x  # harmonic: −K_II⁻¹ K_IΓ w inside

    def condense(self, f: Array) -> Array:
        """Move a load to the interface, f_Γ − K_ΓI K_II⁻¹ f_I, (n,)."""
        x, t = np.zeros_like(f), np.zeros_like(f)
        self.factors.solve(f, x)
        t[self._Γ] = f[self._Γ] - _mult(self._rows, x)
        return t

    def complete(self, u: Array, f: Array) -> Array:
        """Complete u on the interface by K_II⁻¹ (f_I − K_IΓ u_Γ) inside, (n,)."""
        u = u.copy()
        self.factors.solve(f - self._interface_columns(u[self._Γ]), u)
        return u

    def to_interface(self, i: int, X: Array) -> Array:
        """Condense forces on subdomain i to its interface, (n_i, r) → (n_Γ, r)."""
        inside = ~self.on_interface[i]
        Γ, I = self.interface[i], self.interior[i]  # noqa: E741
        Y = self.factors.solve_many(i, X[inside])
        return X[~inside] - product_many(self.torn.K, Γ, I, Y)  # X_Γ − K_ΓI K_II⁻¹ X_I

    def _condensed(self, i: int, Z: Array) -> Array:
        """Condense props on all dofs of subdomain i to its interface, (n_i, q) → (n_Γ, q)."""
        inside = ~self.on_interface[i]
        if Z.shape[1] == 0 or not np.any(inside):
            return Z[~inside]
        Γ, I = self.interface[i], self.interior[i]  # noqa: E741
        X = self.factors.solve_many(i, Z[inside])  # X = K_II⁻¹ Z_I
        try:
            C2 = np.eye(Z.shape[1]) + Z[inside].T @ X
            C = np.linalg.cholesky(0.5 * (C2 + C2.T))
        except np.linalg.LinAlgError:  # K_II itself is indefinite
            return Z[~inside]
        Y = Z[~inside] - product_many(self.torn.K, Γ, I, X)
        return scipy.linalg.solve_triangular(C, Y.T, lower=True).T  # (Z_Γ − K_ΓI X) C⁻ᵀ

    def _interface_columns(self, w: Array) -> Array:
        """Return K w for w on the interface, (n_Γ,) → (n,)."""
        if self.symmetric:
            return _mult(self._rows, w, transpose=True)
        return _mult(self._columns, w)

    def destroy(self) -> None:
        """Free work vectors, factors and rows."""
        super().destroy()
        for owned in (self._rows_Γ, self._all, self._rows, self._columns):
            if owned is not None:
                owned.destroy()


def _mult(K: PETSc.Mat, x: Array, *, transpose: bool = False) -> Array:
    """Return K x, or Kᵀ x, for a sequential matrix."""
    y = np.zeros(K.getSize()[1 if transpose else 0])
    x_vec = PETSc.Vec().createWithArray(np.ascontiguousarray(x), comm=PETSc.COMM_SELF)
    y_vec = PETSc.Vec().createWithArray(y, comm=PETSc.COMM_SELF)
    (K.multTranspose if transpose else K.mult)(x_vec, y_vec)
    x_vec.destroy()
    y_vec.destroy()
    return y
