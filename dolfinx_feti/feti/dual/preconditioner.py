# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Preconditioners of the dual operator: identity, lumped, Dirichlet; M = B_D Y B_Dᵀ.

.. math:: M = \sum_i B_{D,i}\, Y_i\, B_{D,i}^⊤, \qquad
          Y_i = θ I,\; K_i,\; \begin{pmatrix} 0 & 0 \\ 0 & S_i \end{pmatrix} \; (+\; Y_Z Y_Z^⊤)

(eq. 46, Augustin_eq:feti_preconditioner). The displacement :math:`u - E_Γ B_D^⊤ r`, whose copies
agree, leaves the unbalanced force :math:`t = K E_Γ B_D^⊤ r` (docs/theory.md).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import scipy.linalg
import scipy.sparse

from dolfinx_feti.feti.subdomain.blocks import block_diagonal, on_subdomains, product_many
from dolfinx_feti.feti.subdomain.operator import Operator
from dolfinx_feti.feti.subdomain.panels import Panels
from dolfinx_feti.runtime.arrays import Array


class LinearMap:
    """The action of a matrix, which stays its owner's, on local parts of vectors: ``M @ x``."""

    def __init__(
        self,
        matrix: PETSc.Mat,
        vectors: tuple[PETSc.Vec, PETSc.Vec] | None = None,
        *,
        transposed: bool = False,
    ) -> None:
        """Take a distributed matrix, (M, N), and work vectors; its own if not given."""
        self.matrix, self._transposed = matrix, transposed
        self._x, self._y = vectors or matrix.createVecs()
        self.shape = (self._y.getLocalSize(), self._x.getLocalSize())

    @property
    def T(self) -> LinearMap:
        """The transpose Mᵀ."""
        vectors = self._y, self._x
        return LinearMap(self.matrix, vectors, transposed=not self._transposed)

    def __matmul__(self, x: Array) -> Array:
        """Return M x for the local part of a vector, (n,). Collective."""
        self._x.array[:] = x
        (self.matrix.multTranspose if self._transposed else self.matrix.mult)(self._x, self._y)
        return self._y.array_r.copy()

    def destroy(self) -> None:
        """Free the work vectors."""
        self._x.destroy()
        self._y.destroy()


class Preconditioner(ABC):
    """M = B_D Y B_Dᵀ of one matrix; a subclass says what Y does on the torn interface.

    Attributes:
        operator: K and S of every subdomain.
        B_D: Scaled jumps, (m, n).
        stabilisation: Y_Z of each subdomain, (n_Γ, q_i).
    """

    def __init__(self, operator: Operator, B_D: PETSc.Mat, Z: Sequence[Array]) -> None:
        """Take K, S, B_D and the columns Z of K₊ = K + Z Zᵀ on the dofs of each matrix."""
        self.operator = operator
        self._Γ = np.concatenate([*operator.interface, np.zeros(0, dtype=np.int32)])
        self.stabilisation, self._Y_Z = on_subdomains(
            lambda: self._stabilisation(Z), operator.torn.comm
        )
        self.B_D = LinearMap(B_D)

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

    def condense_stabilisation(self, i: int, Z: Array) -> Array:
        """Return Y_Z for Z on the dofs of subdomain i, (n_i, q) → (n_Γ, q)."""
        return Z[self.operator.on_interface[i]]

    def destroy(self) -> None:
        """Free the work vectors."""
        self.B_D.destroy()


class Identity(Preconditioner):
    """The identity preconditioner, M = θ B_D B_Dᵀ (eq. 46, Augustin_eq:feti_preconditioner).

    The paper has θ = 1. Here it puts the spectrum of M F around one, where the constraint
    preconditioner (``system``) has eigenvalues besides.

    Attributes:
        theta: Mean stiffness of an interface dof.
    """

    def __init__(self, operator: Operator, B_D: PETSc.Mat, Z: Sequence[Array]) -> None:
        """Find θ; see the base class. Collective."""
        super().__init__(operator, B_D, Z)
        k = np.abs(operator.torn.diagonal()[self._Γ])
        total, count = operator.torn.comm.allreduce(np.array([k.sum(), len(k)]))
        self.theta = total / count if total > 0.0 else 1.0

    def multiply(self, w: Array) -> Array:
        """Return θ w, (n,)."""
        return self.theta * w

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return θ W, (n_Γ, r)."""
        return self.theta * W.dense()


class Lumped(Preconditioner):
    """The lumped preconditioner, M = B_D K B_Dᵀ (eq. 49, Augustin_eq:LumpedVK): no factor."""

    def multiply(self, w: Array) -> Array:
        """Return K w, (n,)."""
        return self.operator.torn.multiply(w)  # K w

    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return K_ΓΓ W, (n_Γ, r)."""
        Γ = self.operator.interface[i]
        return product_many(self.operator.torn.K, Γ, Γ, W.dense())  # K_ΓΓ W


class Dirichlet(Preconditioner):
    r"""The Dirichlet preconditioner, M = B_D S B_Dᵀ (eq. 50, Augustin_eq:DirichletVK; eq. 51).

    The stabilisation Z has a part inside where the interior is kept, which is condensed,

    .. math:: Y_Z = (Z_Γ - K_{ΓI} X)\, C^{-⊤}, \qquad X = K_{II}^{-1} Z_I, \qquad
              C C^⊤ = I + Z_I^⊤ X.

    If I + Z_Iᵀ X is not positive definite, so that K_II is not, :math:`Y_Z = Z_Γ` takes its place.
    """

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

    def condense_stabilisation(self, i: int, Z: Array) -> Array:
        """Return Y_Z for Z on the dofs of subdomain i, (n_i, q) → (n_Γ, q)."""
        S, inside = self.operator, ~self.operator.on_interface[i]
        if Z.shape[1] == 0 or not np.any(inside):
            return Z[~inside]
        X = S.interior_factors[i].solve(Z[inside])  # X = K_II⁻¹ Z_I
        try:
            C = np.linalg.cholesky(np.eye(Z.shape[1]) + Z[inside].T @ X)
        except np.linalg.LinAlgError:  # K_II itself is indefinite
            return Z[~inside]
        Y = Z[~inside] - product_many(S.torn.K, S.interface[i], S.interior[i], X)
        return scipy.linalg.solve_triangular(C, Y.T, lower=True).T  # (Z_Γ − K_ΓI X) C⁻ᵀ
