# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Preconditioners of the dual operator: none, identity, lumped, Dirichlet.

.. math:: M = \sum_i B_{D,i}\, Y_i\, B_{D,i}^⊤, \qquad
          Y_i = θ I,\; K_i,\; \begin{pmatrix} 0 & 0 \\ 0 & S_i \end{pmatrix}, \qquad
          S_i = K_{ΓΓ} - K_{ΓI} K_{II}^{-1} K_{IΓ}

(eq. 46, Augustin_eq:feti_preconditioner, eq. 49, Augustin_eq:LumpedVK, eq. 50,
Augustin_eq:DirichletVK); the paper writes
:math:`M^{-1}` for this matrix and has θ = 1. Here θ is the mean stiffness of an interface dof; it
puts the spectrum of M F around one: the constraint preconditioner (``dual``) has eigenvalues one
besides, and where they lie far outside, rounding errors grow without bound.

Under prestress a subdomain may buckle where the whole body does not. Then Y_i has negative
eigenvalues, M is indefinite, and the coarse matrix :math:`G^⊤ M G + D` may come close to a singular
one. So all but the plain ``none`` take the propped subdomain :math:`K_+ = K + Z Z^⊤`
(``pseudoinverse``): to Y_i they add

.. math:: Y_Z Y_Z^⊤, \qquad Y_Z = Z_Γ, \quad\text{with the interior}\quad
          Y_Z = (Z_Γ - K_{ΓI} X)\, C^{-⊤}, \quad X = K_{II}^{-1} Z_I, \quad
          C C^⊤ = I + Z_I^⊤ X

(the first one also where K_II is indefinite, which it never was; C Cᵀ made symmetric if K is not).
A wall at 30 mmHg takes a quarter to a half of the iterations for it.

With the jump r = B u − c, the force :math:`t = Y B_D^⊤ r`, without props, is what the averaged
displacement :math:`u - E_Γ B_D^⊤ r` leaves out of balance, so that :math:`\|T^⊤ t\|` is the
residual of the *assembled* system (:math:`E_Γ` extends an interface displacement to the interior:
harmonically for the Dirichlet preconditioner and wherever the interior is eliminated, by zero
otherwise).
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.sparse

from dolfinx_feti.feti.gluing import Gluing
from dolfinx_feti.feti.subdomain.blocks import block_columns, index_set, product_many
from dolfinx_feti.feti.subdomain.factors import BlockFactors
from dolfinx_feti.feti.subdomain.matrices import SubdomainMatrices
from dolfinx_feti.torn import Torn

__all__ = ["PRECONDITIONERS", "Preconditioner", "create_preconditioner"]

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]


class Preconditioner(ABC):
    """M = B_D Y B_Dᵀ; a subclass says what Y does on the torn interface.

    Attributes:
        interface: Glued free dofs Γ of each subdomain.
        interior: The other free dofs I of each subdomain.
        factors: Interior factors, if the preconditioner has any.
        energetic: Whether Y is the energy of an extended interface displacement, E_Γᵀ K E_Γ.
        props: The props Y_Z of each subdomain, (n_Γ, q_i); after :meth:`update`.
    """

    factors: BlockFactors | None = None

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
        """Prepare the work vectors.

        Args:
            torn: The torn matrix.
            gluing: Its jump operators.
            matrices: The matrix of each subdomain, K on its free dofs or S on the interface.
            symmetric: Whether K is symmetric.
            prefix: Options prefix of the interior factorisations.
        """
        self.torn = torn
        self.matrices = matrices
        self.glued = gluing.glued
        self.B_D = gluing.B_D
        glued = np.zeros(torn.n, dtype=bool)
        glued[gluing.glued] = True
        self._on_interface = [glued[rows] for rows in matrices.dofs]
        pairs = list(zip(matrices.dofs, self._on_interface, strict=True))
        self.interface = [rows[on] for rows, on in pairs]
        self.interior = [rows[~on] for rows, on in pairs]
        self._Γ = np.concatenate([*self.interface, np.zeros(0, dtype=np.int32)])
        self.symmetric = symmetric
        self.prefix = prefix
        self._w = self.B_D.createVecRight()
        self._t = self.B_D.createVecRight()

    def update(self, props: list[Array]) -> None:
        """Take over the current K.

        Args:
            props: Columns Z of K₊ = K + Z Zᵀ for each subdomain, on the dofs of its matrix.

        Raises:
            FactorError: A factorisation failed. Not collective: the caller reduces.
        """
        self._prop([Z[on] for Z, on in zip(props, self._on_interface, strict=True)])

    def weigh(self) -> None:  # noqa: B027
        """Take over the weights of the current K, if there are any. Collective."""

    def mult(self, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Apply the preconditioner to a jump r, z = M r, and keep the force of w = B_Dᵀ r."""
        self.B_D.multTranspose(r, self._w)  # w = B_Dᵀ r
        w, t = self._w.array_r, np.zeros(self.torn.n)
        self.apply(w, t)
        self._t.array[:] = t + self._held(w)
        self.B_D.mult(self._t, z)  # z = B_D Y w
        self._t.array[:] = t

    def product(self, G: PETSc.Mat) -> PETSc.Mat:
        """Form the sparse product M G, (m, K); the caller destroys it."""
        W = self.B_D.transposeMatMult(G)  # W = B_Dᵀ G
        indptr, indices, data = W.getValuesCSR()
        shape = (self.torn.n, G.getSize()[1])
        columns = scipy.sparse.csr_array((data, indices, indptr), shape=shape)
        blocks = [self._image(i, columns[rows]) for i, rows in enumerate(self.interface)]
        YW = block_columns(self.torn, self.interface, blocks, G.getSizes()[1])
        MG = self.B_D.matMult(YW)  # M G = B_D Y B_Dᵀ G
        W.destroy()
        YW.destroy()
        return MG

    def _image(self, i: int, W: scipy.sparse.csr_array) -> tuple[Array, Indices]:
        """Apply Y_i to the non-zero columns of W, (n_Γ, K); return them and their numbers."""
        support = np.unique(W.indices)
        columns = W[:, support].toarray()
        image = self.apply_many(i, columns)
        image += self.props[i] @ (self.props[i].T @ columns)
        return image, support

    @abstractmethod
    def apply(self, w: Array, t: Array) -> None:
        """Apply t = Y w without props, both (n,), w zero off the interface, t zero on entry."""

    @abstractmethod
    def apply_many(self, i: int, W: Array) -> Array:
        """Apply Y_i without props to columns on the interface, (n_Γ, r) → (n_Γ, r)."""

    def to_interface(self, i: int, X: Array) -> Array:
        """Move forces X on subdomain i to its interface, E_Γᵀ X, (n_i, r) → (n_Γ, r)."""
        return X[self._on_interface[i]]

    def _prop(self, props: list[Array]) -> None:
        """Hold the subdomains by the props Y_Z, (n_Γ, q_i) each."""
        self.props = props
        together = scipy.sparse.block_diag(props, format="csr") if props else (0, 0)
        self._all_props = scipy.sparse.csr_array(together)

    def _held(self, w: Array) -> Array:
        """Return the force of the props, (n,)."""
        t = np.zeros_like(w)
        if self._all_props.shape[1]:
            Y = self._all_props
            t[self._Γ] = Y @ (Y.T @ w[self._Γ])  # Y_Z Y_Zᵀ w
        return t

    def extend(self, w: Array) -> Array:
        """Extend an interface displacement to the interior, E_Γ w, (n,)."""
        return w

    def imbalance(self, r: PETSc.Vec) -> Array:
        """Return the torn force K E_Γ B_Dᵀ r, (n,), for the jump r that was last preconditioned."""
        self.B_D.multTranspose(r, self._w)
        return self.matrices.multiply(self._w.array_r)

    def destroy(self) -> None:
        """Free the work vectors and factors."""
        self._w.destroy()
        self._t.destroy()
        if self.factors is not None:
            self.factors.destroy()


class Identity(Preconditioner):
    """Y = θ I (eq. 46, Augustin_eq:feti_preconditioner)."""

    energetic = False

    theta = 1.0

    def weigh(self) -> None:
        k = np.abs(self.torn.diagonal()[self.glued])
        total, count = self.torn.comm.allreduce(np.array([k.sum(), len(k)]))
        self.theta = total / count if total > 0.0 else 1.0

    def apply(self, w: Array, t: Array) -> None:
        t[:] = self.theta * w

    def apply_many(self, i: int, W: Array) -> Array:
        return self.theta * W


class Unpreconditioned(Identity):
    """M = θ I, without scaled jumps."""

    def mult(self, r: PETSc.Vec, z: PETSc.Vec) -> None:
        r.copy(z)
        z.scale(self.theta)

    def product(self, G: PETSc.Mat) -> PETSc.Mat:
        MG = G.copy()
        MG.scale(self.theta)
        return MG


class Lumped(Preconditioner):
    """Y = K (eq. 49, Augustin_eq:LumpedVK): no factor, one product with the local matrix."""

    def apply(self, w: Array, t: Array) -> None:
        t[:] = self.torn.multiply(w)  # t = K w

    def apply_many(self, i: int, W: Array) -> Array:
        Γ = self.interface[i]
        return product_many(self.torn.K, Γ, Γ, W)  # K_ΓΓ W


class Dirichlet(Preconditioner):
    """Y = S (eq. 50, Augustin_eq:DirichletVK), the Schur complement, formed already."""

    def apply(self, w: Array, t: Array) -> None:
        t[:] = self.matrices.multiply(w)  # t = S w

    def apply_many(self, i: int, W: Array) -> Array:
        return self.matrices.multiply_many(i, W)

    def imbalance(self, r: PETSc.Vec) -> Array:
        return self._t.array_r


class ImplicitDirichlet(Dirichlet):
    """Y = S, applied with a factor of K_II.

    Besides one interior factor a subdomain it keeps the interface rows of K, (n_Γ, n).
    """

    factors: BlockFactors

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
        self.factors = BlockFactors(torn.K, self.interior, prefix=prefix, symmetric=symmetric)
        self._rows_Γ = index_set(self._Γ)
        self._all = index_set(np.arange(torn.n, dtype=np.int32))
        self._rows: PETSc.Mat | None = None
        self._columns: PETSc.Mat | None = None

    def update(self, props: list[Array]) -> None:
        self.factors.update()
        self._rows = self.torn.K.createSubMatrix(self._rows_Γ, self._all, self._rows)  # K_Γ
        if not self.symmetric:
            self._columns = self.torn.K.createSubMatrix(self._all, self._rows_Γ, self._columns)
        self._prop([self._condensed(i, Z) for i, Z in enumerate(props)])

    def apply(self, w: Array, t: Array) -> None:
        Γ = self._Γ
        y = self._interface_columns(w[Γ])  # y = K w
        x = np.zeros_like(y)
        self.factors.solve(y, x)  # x = K_II⁻¹ K_IΓ w
        t[Γ] = y[Γ] - _mult(self._rows, x)  # S w = K_ΓΓ w − K_ΓI x

    def apply_many(self, i: int, W: Array) -> Array:
        Γ, I = self.interface[i], self.interior[i]  # noqa: E741
        K = self.torn.K
        X = self.factors.solve_many(i, product_many(K, I, Γ, W))  # K_II⁻¹ K_IΓ W
        return product_many(K, Γ, Γ, W) - product_many(K, Γ, I, X)

    def extend(self, w: Array) -> Array:
        x = np.zeros_like(w)
        self.factors.solve(self._interface_columns(w[self._Γ]), x)
        return w - x  # harmonic: −K_II⁻¹ K_IΓ w inside

    def _condensed(self, i: int, Z: Array) -> Array:
        """Condense props on all dofs of subdomain i to its interface, (n_i, q) → (n_Γ, q)."""
        inside = ~self._on_interface[i]
        if Z.shape[1] == 0 or not np.any(inside):
            return Z[~inside]
        Γ, I = self.interface[i], self.interior[i]  # noqa: E741
        X = self.factors.solve_many(i, Z[inside])  # K_II⁻¹ Z_I
        try:
            C2 = np.eye(Z.shape[1]) + Z[inside].T @ X
            C = np.linalg.cholesky(0.5 * (C2 + C2.T))
        except np.linalg.LinAlgError:  # K_II itself is indefinite
            return Z[~inside]
        Y = Z[~inside] - product_many(self.torn.K, Γ, I, X)
        return scipy.linalg.solve_triangular(C, Y.T, lower=True).T  # (Z_Γ − K_ΓI X) C⁻ᵀ

    def to_interface(self, i: int, X: Array) -> Array:
        inside = ~self._on_interface[i]
        Γ, I = self.interface[i], self.interior[i]  # noqa: E741
        Y = self.factors.solve_many(i, X[inside])
        return X[~inside] - product_many(self.torn.K, Γ, I, Y)  # X_Γ − K_ΓI K_II⁻¹ X_I

    def _interface_columns(self, w: Array) -> Array:
        if self.symmetric:
            return _mult(self._rows, w, transpose=True)
        return _mult(self._columns, w)

    def destroy(self) -> None:
        super().destroy()
        for owned in (self._rows_Γ, self._all, self._rows, self._columns):
            if owned is not None:
                owned.destroy()


PRECONDITIONERS: dict[str, type[Preconditioner]] = {
    "dirichlet": ImplicitDirichlet,
    "identity": Identity,
    "lumped": Lumped,
    "none": Unpreconditioned,
}


def create_preconditioner(
    kind: str,
    torn: Torn,
    gluing: Gluing,
    matrices: SubdomainMatrices,
    *,
    symmetric: bool,
    prefix: str,
) -> Preconditioner:
    """Choose the preconditioner, and for S the way it is applied; see :class:`Preconditioner`."""
    choice = PRECONDITIONERS[kind]
    if kind == "dirichlet" and matrices.condensed:
        choice = Dirichlet
    return choice(torn, gluing, matrices, symmetric=symmetric, prefix=prefix)


def _mult(K: PETSc.Mat, x: Array, *, transpose: bool = False) -> Array:
    y = np.zeros(K.getSize()[1 if transpose else 0])
    x_vec = PETSc.Vec().createWithArray(np.ascontiguousarray(x), comm=PETSc.COMM_SELF)
    y_vec = PETSc.Vec().createWithArray(y, comm=PETSc.COMM_SELF)
    (K.multTranspose if transpose else K.mult)(x_vec, y_vec)
    x_vec.destroy()
    y_vec.destroy()
    return y
