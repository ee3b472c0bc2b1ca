# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The torn tangent of a Newton step, perhaps with a shift: :math:`K' + σ \operatorname{diag}|k|`.

k is the diagonal of the local matrix on the torn dofs, before fields are condensed into it.
Each copy of a dof is shifted in proportion to its stiffness, so that σ has no unit.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_feti.fem import assembly
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.condensation.condensation import CellMatrices, Condensation
from dolfinx_feti.fem.decomposition import TornSpace
from dolfinx_feti.fem.near_kernel import attach_near_kernel
from dolfinx_feti.fem.split_form import split_torn_form
from dolfinx_feti.fem.torn_matrix import create_matrix_on_torn_space, set_dirichlet_dofs
from dolfinx_feti.problems.equations.torn_dofs import TornDofs
from dolfinx_feti.problems.forms import Forms
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.lifetime import Lifetime
from dolfinx_feti.torn.connectivity import diagonal_places
from dolfinx_feti.torn.matrix import set_condensed_pressures
from dolfinx_feti.torn.rounding import product_rounding_squares


class TangentId:
    """Identity of the tangent that a torn matrix holds; it has no data.

    Each assembly, and each change of the shift, creates another object.
    """


class TornTangent:
    """Owner of the torn matrix A and its entries.

    Attributes:
        A: Torn matrix (MATIS).
        id: Identity of the tangent that A holds.
        blocks: Blocks of the condensed fields in it; None without such fields.
        shift: σ.
        diagonal: k, the diagonal of K before fields are condensed into it, (n,).
    """

    def __init__(
        self,
        forms: Forms,
        space: TornSpace,
        dofs: TornDofs,
        condensation: Condensation | None,
        compiler: Compiler,
    ) -> None:
        """Compile the form J and allocate the matrix. Collective."""
        V = space.V
        self._V = V
        self._comm = V.mesh.comm
        self._dofs = dofs
        self._condensation = condensation
        self._form = split_torn_form(forms.J, space, compiler)
        self._K = assembly.create_local_matrix(space, compiler)
        self._diagonal_places = diagonal_places(self._K.mat)  # in the values of K; none is missing
        self.diagonal: Array = np.zeros(len(self._diagonal_places))
        #: The user's null space while A has a shift and is therefore regular; else None, and the
        #: null space is attached to A.
        self._detached_null_space: PETSc.NullSpace | None = None
        self.A = create_matrix_on_torn_space(space, self._K.mat, [], self.diagonal, forms.symmetric)
        if condensation is not None:
            set_condensed_pressures(self.A, condensation.n_constraints)
        self._near_kernel: PETSc.NullSpace | None = None  # that this object has attached to A
        self.id = TangentId()
        self.shift = 0.0
        self.blocks: CellMatrices | None = None

    def prescribe(self, dirichlet: Mask) -> None:
        """Set the Dirichlet dofs of A, (owned,). Collective."""
        set_dirichlet_dofs(self.A, dirichlet)

    def assemble(self, owned_u: Array, blocks: CellMatrices | None = None) -> None:
        """Assemble the tangent and its near kernel at the present state. Collective.

        Args:
            owned_u: Displacement that the rotations of the near kernel belong to, (owned,).
            blocks: Blocks of the condensed fields at this state; assembled if not given.

        Raises:
            ValueError: A block of condensed fields is singular in a cell.
        """
        self._restore_null_space()
        on_all(lambda: self._assemble_local(blocks), self._comm)
        bs = self._V.dofmap.index_map_bs
        previous = self._near_kernel
        self._near_kernel = attach_near_kernel(
            self.A, self._V, owned_u.reshape(-1, bs), attached=previous
        )
        if previous is not None:
            previous.destroy()

    def _assemble_local(self, blocks: CellMatrices | None) -> None:
        """Assemble K, and store its diagonal before condensation: it weighs the copies of a dof."""
        self._fill()
        self.diagonal[:] = self._K.csr.data[self._diagonal_places]
        self.A.query("stiffness").array[:] = self.diagonal  # of the scaling: a copy
        if self._condensation is not None:
            if blocks is None:
                blocks = self._condensation.assemble()
            self.blocks = blocks
            self._condensation.condense(self._K, self.blocks)

    def _fill(self) -> None:
        """Assemble K before condensation, with a new identity."""
        self.shift = 0.0
        self.id = TangentId()  # first, because the assembly may raise and leave K half filled
        assembly.assemble(self._K, self._form)

    def assemble_diagonal(self) -> Array:
        """Return the diagonal of the assembled tangent before condensation, (owned,). Collective.

        A holds no tangent of a Newton step afterwards.
        """
        self._restore_null_space()
        on_all(self._fill, self._comm)
        k = np.asarray(self._K.csr.data, dtype=np.float64)[self._diagonal_places]
        return self._dofs.assemble(k)

    def set_shift(self, sigma: float) -> None:
        """Replace the shift of the tangent by σ ≥ 0. Collective."""
        if sigma == self.shift:
            return
        if sigma == 0.0:
            self._restore_null_space()
        else:
            self._detach_null_space()
        self._K.csr.data[self._diagonal_places] += (sigma - self.shift) * np.abs(self.diagonal)
        self._K.mat.stateIncrease()
        self.shift = sigma
        self.id = TangentId()

    def _restore_null_space(self) -> None:
        """Attach the null space of the tangent to A again."""
        if self._detached_null_space is not None:
            self.A.setNullSpace(self._detached_null_space)
            self._detached_null_space.destroy()  # this reference to it; A has one of its own
            self._detached_null_space = None

    def _detach_null_space(self) -> None:
        """Detach the null space of the tangent from A: a shifted matrix is regular."""
        if self._detached_null_space is None and self.A.getNullSpace().handle:
            self._detached_null_space = self.A.getNullSpace()
            none = PETSc.NullSpace().create(comm=self.A.comm)
            self.A.setNullSpace(none)
            none.destroy()

    def remove_null_space(self, du: Array) -> Array:
        """Return an increment, (owned,), without its part in the null space. Collective.

        Only a solve with a shift leaves such a part.
        """
        if self._detached_null_space is None:
            return du
        with Lifetime() as lifetime:
            x = lifetime.own(self.A.createVecRight())
            x.array[:] = du
            self._detached_null_space.remove(x)
            return x.array_r.copy()

    def multiply(self, d: Array) -> Array:
        """Return A d, (owned,). Collective."""
        with Lifetime() as lifetime:
            x, y = map(lifetime.own, self.A.createVecs())
            x.array[:] = d
            self.A.mult(x, y)
            return y.array_r.copy()

    def divide_by_diagonal(self, r: Array) -> Array:
        """Return r_i/Σ|k_i| over the copies of dof i, (owned,); zero where k is. Collective."""
        k = self._dofs.assemble(np.abs(self.diagonal))
        return np.divide(r, k, out=np.zeros(len(r)), where=k > 0.0)

    def trace(self) -> float:
        """Return the trace of the tangent before condensation. Collective."""
        return float(self._comm.allreduce(float(self.diagonal.sum())))

    def product_rounding_squares(self, t: Array) -> Array:
        """Return ε² Σⱼ Kᵢⱼ² tⱼ² for torn values t, (n,): squared rounding errors of K t."""
        return product_rounding_squares(self._K.mat, t)

    def destroy(self) -> None:
        """Destroy the matrices."""
        self._restore_null_space()
        if self._near_kernel is not None:
            self._near_kernel.destroy()
        self.A.destroy()
        self._K.mat.destroy()
