# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Base class of the preconditioners of the dual system, M = B_D (Y + Y_Z Y_Zᵀ) B_Dᵀ.

.. math:: M = \sum_i B_{D,i}\, (Y_i + Y_{Z,i} Y_{Z,i}^⊤)\, B_{D,i}^⊤

(eq. 46, which has no :math:`Y_Z`). A preconditioner is a choice of :math:`Y_i`, an approximation of
the Schur complement :math:`S_i`, (n_{Γ,i}, n_{Γ,i}), on the interface of subdomain i.

A subdomain that buckles alone has an indefinite :math:`K_i`. Its *stabilisation* is
:math:`K_i + Z_i Z_i^⊤` with a few columns :math:`Z_i`, (n_i, q_i), on all dofs of the subdomain.
:math:`Y_{Z,i}`, (n_{Γ,i}, q_i), are these columns condensed to its interface. Other subdomains have
q_i = 0.

From the jump r = B u − c of a displacement u the preconditioner also computes the unbalanced force
:math:`t = K E_Γ B_D^⊤ r`: the force on the torn dofs that u leaves after its copies have been
averaged, :math:`u - E_Γ B_D^⊤ r` (docs/theory.md). The Krylov method ends by the norm of its sum
over the copies, ‖Tᵀ t‖. If Y = S, t is :math:`Y B_D^⊤ r`, which M r contains. All arrays are those
of this process: r is (m,), torn vectors are (n,).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from dolfinx_feti.feti.subdomain.block_diagonal import block_diagonal
from dolfinx_feti.feti.subdomain.failures import on_subdomains
from dolfinx_feti.feti.subdomain.panels import Panels
from dolfinx_feti.feti.subdomain.schur_operator import SchurOperator
from dolfinx_feti.runtime.arrays import Array, concatenate
from dolfinx_feti.runtime.linear_map import LinearMap


class Preconditioner(ABC):
    """M = B_D (Y + Y_Z Y_Zᵀ) B_Dᵀ of one matrix.

    A subclass defines Y twice: by :meth:`multiply` for a vector on all subdomains, and by
    :meth:`multiply_panels` for several columns on one subdomain. The tests compare both with a
    dense M. The other methods are right for every Y: they extend by zero (E_Γ w = w, Y_Z = Z on the
    interface) and compute t by a product with K. A subclass may override them to extend in a better
    way, or to save that product. One that overrides :meth:`extend` has to override
    :meth:`unbalanced_force` as well, because t = K E_Γ w contains the extension.

    Attributes:
        needs_interior_factors: Whether Y needs factors of K_II; a constant of the subclass.
        operator: K and S of the subdomains.
        B_D: Scaled jumps, with m rows and n columns on this process.
        Y_Z: Condensed columns of the stabilisation of each subdomain, (n_{Γ,i}, q_i).
    """

    needs_interior_factors: ClassVar[bool] = False

    def __init__(self, operator: SchurOperator, B_D: PETSc.Mat, Z: Sequence[Array]) -> None:
        """Condense the stabilisation to the interface. Collective.

        Args:
            operator: K and S of the subdomains.
            B_D: Scaled jump operator; its owner destroys it.
            Z: Columns of the stabilisation of each subdomain, (n_i, q_i); (n_{Γ,i}, q_i) if the
                interior is eliminated.

        Raises:
            SetUpError: A subdomain's columns could not be condensed.
        """
        self.operator = operator
        self._Γ = concatenate(operator.interfaces, np.int32)  # interface dofs of all subdomains

        def condense() -> tuple[list[Array], scipy.sparse.csr_array]:
            """Return Y_Z of each subdomain, and all of them as one block-diagonal matrix."""
            blocks = [self.condense_stabilisation(i, Z_i) for i, Z_i in enumerate(Z)]
            return blocks, block_diagonal(blocks)

        self.Y_Z, self._Y_Z_matrix = on_subdomains(condense, operator.torn.comm)
        self.B_D = LinearMap(B_D)

    @abstractmethod
    def multiply(self, w: Array) -> Array:
        """Return Y w, (n,). Not collective.

        Args:
            w: Displacement B_Dᵀ r, zero off the interface, (n,).

        Returns:
            Y w. Its entries off the interface may have any value: B_D does not read them.
        """

    @abstractmethod
    def multiply_panels(self, i: int, W: Panels) -> Array:
        """Return Y_i W, (n_{Γ,i}, k), on the interface of subdomain i.

        Args:
            i: Number of the subdomain on this process.
            W: Columns on its interface, (n_{Γ,i}, k). They are stored as dense blocks because most
                of their entries are zero; ``W.dense()`` returns them as an array.
        """

    def apply(self, r: Array) -> tuple[Array, Array]:
        """Apply the preconditioner to a jump r, (m,). Collective.

        Returns:
            M r, (m,), and the unbalanced force t, (n,), in which the stabilisation has no part.
        """
        w = self.B_D.T @ r  # w = B_Dᵀ r
        Yw = self.multiply(w)
        stabilised = Yw.copy()
        if self._Y_Z_matrix.shape[1]:
            stabilised[self._Γ] += self._Y_Z_matrix @ (self._Y_Z_matrix.T @ w[self._Γ])
        return self.B_D @ stabilised, self.unbalanced_force(w, Yw)  # B_D (Y + Y_Z Y_Zᵀ) w

    def multiply_stabilised(self, i: int, W: Panels) -> Array:
        """Return (Y_i + Y_Z Y_Zᵀ) W, (n_{Γ,i}, k); arguments as in :meth:`multiply_panels`."""
        Y = self.multiply_panels(i, W)
        Y_Z = self.Y_Z[i]
        if not Y_Z.shape[1]:
            return Y
        return Y + Y_Z @ W.multiply_transposed(Y_Z).T  # Y_i W + Y_Z (Wᵀ Y_Z)ᵀ

    def unbalanced_force(self, w: Array, Yw: Array) -> Array:
        """Return the unbalanced force t = K E_Γ w, (n,).

        If the interior is kept, it is K w, since :meth:`extend` extends by zero. If the interior is
        eliminated, it is S w: the interior values follow from a harmonic extension then.

        Args:
            w: Displacement B_Dᵀ r, zero off the interface, (n,).
            Yw: Y w, (n,). A subclass for which it equals t returns it and saves the product.
        """
        operator = self.operator
        if operator.is_interior_eliminated:
            return operator.multiply(w)
        return operator.torn.multiply(w)

    def extend(self, w: Array) -> Array:
        """Extend an interface displacement to the interior by zero, E_Γ w = w, (n,).

        If the interior is eliminated, the interior values are not used: at the end of a
        solve, ``DualFormulation`` computes them from those on the interface, harmonically.

        Args:
            w: Displacement, zero off the interface, (n,).
        """
        return w

    def condense_stabilisation(self, i: int, Z: Array) -> Array:
        """Return Y_Z of subdomain i, (n_{Γ,i}, q): the rows of Z on the interface.

        Args:
            i: Number of the subdomain on this process.
            Z: Columns of its stabilisation, (n_i, q); (n_{Γ,i}, q) if the interior is eliminated.
        """
        if self.operator.is_interior_eliminated:
            return Z
        return Z[self.operator.by_subdomain[i].subdomain.is_on_interface]

    def destroy(self) -> None:
        """Free the work vectors."""
        self.B_D.destroy()
