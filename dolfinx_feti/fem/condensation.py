# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Static condensation of an element-wise constant pressure: P_k–P_0 elements.

Newton's step for the pair (u, p) with p constant on each cell,

.. math:: \begin{pmatrix} K_{uu} & K_{up} \\ K_{pu} & K_{pp} \end{pmatrix}
          \begin{pmatrix} Δu \\ Δp \end{pmatrix} = -\begin{pmatrix} r_u \\ r_p \end{pmatrix},

has a diagonal :math:`K_{pp}`, so that p is condensed cell by cell
(eq. 29, Augustin_eq:volumetricVariationDis) without any fill-in:

.. math:: K = K_{uu} - K_{up} K_{pp}^{-1} K_{pu}, \quad r = r_u - K_{up} K_{pp}^{-1} r_p, \quad
          Δp = -K_{pp}^{-1}(r_p + K_{pu} Δu).

The last equation updates the pressure by its own linearised equation, so that Newton's iterates are
those of the mixed problem. For the perturbed Lagrangian p (J − 1) − p²/(2κ),
:math:`K_{pp} = -|τ|/κ` on a cell τ.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti.fem.assembly import LocalMatrix, require_no_coupling, torn_form
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import TornSpace, into_cells, tear
from dolfinx_feti.runtime.native import load, pointer

__all__ = ["Blocks", "Condensation"]

Array = npt.NDArray[np.float64]

SOURCE = Path(__file__).with_name("condensation.c")
DECLARATION = """
int add_outer_products(int, int, int, int, const int *, const double *, const double *,
                       const int64_t *, const int *, double *);
"""


@dataclass(frozen=True, slots=True)
class Blocks:
    """What belongs to the pressure at one state (u, p), cell by cell.

    Attributes:
        k_up: K_upᵀ, (cells, dofs of a cell).
        k_pu: K_pu, of the same shape.
        k_pp: Diagonal of K_pp, (cells,).
        r_p: Residual of the pressure, (cells,).
    """

    k_up: Array
    k_pu: Array
    k_pp: Array
    r_p: Array


class Condensation:
    """The blocks of the mixed tangent that belong to the pressure, cell by cell.

    Attributes:
        p: The pressure.
    """

    def __init__(
        self,
        F_u: ufl.Form,
        F_p: ufl.Form,
        u: dolfinx.fem.Function,
        p: dolfinx.fem.Function,
        *,
        space: TornSpace,
        compiler: Compiler,
    ) -> None:
        """Derive and compile the blocks.

        A row of K_pu or K_upᵀ is a linear form of its cell, where q and Δp are one.

        Args:
            F_u: Residual r_u, tested with v in V.
            F_p: Residual r_p, tested with q in Q.
            u: Displacement.
            p: Pressure, piecewise constant.
            space: Torn V.
            compiler: How the blocks are compiled.

        Raises:
            ValueError: p does not occur in the residuals, they leave it undetermined, or couple the
                pressures of two cells.

        Note:
            Collective.
        """
        V, Q = u.function_space, p.function_space
        coefficients = (set(F_u.coefficients()), set(F_p.coefficients()))
        if not all(p in names for names in coefficients):
            raise ValueError(
                f"condense is '{p.name}', which does not occur in the energy (or in both "
                "residuals): pass the pressure of a mixed energy Π(u, p)."
            )
        require_no_coupling(F_p)  # or a row of K_pu is no linear form of a cell
        self.p = p
        one = ufl.as_ufl(1.0)
        q, dp = F_p.arguments()[0], ufl.TrialFunction(Q)
        with_one = ufl.replace(F_p, {q: one})
        K_up = ufl.replace(ufl.derivative(F_u, p, dp), {dp: one})
        K_pu = ufl.derivative(with_one, u, ufl.TestFunction(V))
        K_pp = ufl.derivative(with_one, p, ufl.TestFunction(Q))
        _require_blocks(p, K_up=K_up, K_pu=K_pu, K_pp=K_pp)
        each = into_cells(V.mesh)
        cells = tear(V, each)
        self._rows = tuple(torn_form(form, (cells,), compiler) for form in (K_up, K_pu))
        self._K_pp, self._r_p = compiler.form(K_pp), compiler.form(F_p)
        self._bs = V.dofmap.index_map_bs
        self._pressure_dof = Q.dofmap.list[: each.count, 0]
        self._node = np.sort(space.V_torn.dofmap.list[: each.count], axis=1)  # as in ``cells``
        self._code = load(SOURCE, DECLARATION, V.mesh.comm)

    def assemble(self) -> Blocks:
        """Assemble all blocks at the present (u, p)."""
        k_up, k_pu = (self._of_dofs(form) for form in self._rows)
        return Blocks(k_up, k_pu, self._of_cells(self._K_pp), self._of_cells(self._r_p))

    def add_to(self, K: LocalMatrix, blocks: Blocks) -> None:
        """Add the condensed block, K ← K − K_up K_pp⁻¹ K_pu.

        Raises:
            ValueError: K has no place for it.
        """
        left = -blocks.k_up / blocks.k_pp[:, None]  # −K_up K_pp⁻¹
        indptr, indices, values = K.csr.indptr, K.csr.indices, K.csr.data
        arrays = (self._node, left, blocks.k_pu, indptr, indices, values)
        n = (len(indptr) - 1) // self._bs
        sizes = (*self._node.shape, self._bs, n)
        if self._code.lib.add_outer_products(*sizes, *(pointer(self._code, a) for a in arrays)):
            raise ValueError(f"K, of {n} nodes, does not couple all nodes of every cell")
        K.mat.stateIncrease()

    def residual(self, blocks: Blocks, n_torn: int) -> Array:
        """Return −K_up K_pp⁻¹ r_p on the torn dofs, (n_torn,)."""
        cell = -blocks.k_up * (blocks.r_p / blocks.k_pp)[:, None]
        return np.bincount(self._dofs().ravel(), cell.ravel(), minlength=n_torn).astype(np.float64)

    def relaxed(self) -> Array:
        """Return the pressure that satisfies its own equation at the current u, p − K_pp⁻¹ r_p."""
        p = self.p.x.array.copy()
        p[self._pressure_dof] -= self._of_cells(self._r_p) / self._of_cells(self._K_pp)
        return p

    def increment(self, blocks: Blocks, du: Array) -> Array:
        """Return Δp = −K_pp⁻¹ (r_p + K_pu Δu) at the dofs of Q.

        Args:
            blocks: Of the state where the increment begins.
            du: Torn displacement increment, (n_torn,).
        """
        dp = np.zeros(len(self.p.x.array))
        slope = np.einsum("ij,ij->i", blocks.k_pu, du[self._dofs()])
        dp[self._pressure_dof] = -(blocks.r_p + slope) / blocks.k_pp
        return dp

    def _dofs(self) -> npt.NDArray[np.int32]:
        """Return the torn dofs of each cell, as in the rows of K_pu, (cells, dofs of a cell)."""
        n, k = self._node.shape
        dofs = self._node[:, :, None] * self._bs + np.arange(self._bs, dtype=np.int32)
        return dofs.reshape(n, k * self._bs)

    def _of_dofs(self, form: dolfinx.fem.Form) -> Array:
        """Assemble a linear form of each cell, (cells, dofs of a cell)."""
        n, k = self._node.shape
        rows = np.zeros(n * k * self._bs)
        dolfinx.fem.assemble_vector(rows, form)
        return rows.reshape(n, k * self._bs)

    def _of_cells(self, form: dolfinx.fem.Form) -> Array:
        """Assemble a linear form on Q, (cells,)."""
        values = np.zeros(len(self.p.x.array))
        dolfinx.fem.assemble_vector(values, form)
        return values[self._pressure_dof]


def _require_blocks(p: dolfinx.fem.Function, **blocks: ufl.Form) -> None:
    for name, block in blocks.items():
        if ufl.algorithms.expand_derivatives(block).empty():
            raise ValueError(
                f"condense is '{p.name}', but {name} is zero: condensation needs an energy with a "
                "term in both u and p and a term in p², such as p (J − 1) − p²/(2κ)."
            )
