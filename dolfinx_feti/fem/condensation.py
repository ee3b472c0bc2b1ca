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

import itertools
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from dolfinx_feti.fem.assembly import assemble, create_local_matrix, torn_form
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import Decomposition, TornSpace

__all__ = ["Blocks", "Condensation", "pressure_patterns"]

Array = npt.NDArray[np.float64]

#: Largest degree of a pressure pattern.
DEGREE = 4

#: Number of cells whose element matrices are in memory at once.
CHUNK = 4096


@dataclass(frozen=True, slots=True)
class Blocks:
    """What belongs to the pressure at one state (u, p), cell by cell.

    Attributes:
        k_up: K_upᵀ, (cells, torn dofs of a cell).
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
        pressure_space: TornSpace,
        n_cells: int,
        compiler: Compiler | None = None,
    ) -> None:
        """Derive and compile the blocks.

        Args:
            F_u: Residual r_u, tested with v in V.
            F_p: Residual r_p, tested with q in Q.
            u: Displacement.
            p: Pressure, piecewise constant.
            space: Torn V.
            pressure_space: Torn Q.
            n_cells: Number of owned cells.
            compiler: How the blocks are compiled; with dolfinx's options if not given.

        Raises:
            ValueError: p does not occur in the residuals, or they leave it undetermined.
        """
        V, Q = u.function_space, p.function_space
        coefficients = (set(F_u.coefficients()), set(F_p.coefficients()))
        if not all(p in names for names in coefficients):
            raise ValueError(
                f"condense is '{p.name}', which does not occur in the energy (or in both "
                "residuals): pass the pressure of a mixed energy Π(u, p)."
            )
        self.p = p
        self._pressure_dof = pressure_space.dof
        spaces = (pressure_space, space)
        K_up = ufl.derivative(F_u, p, ufl.TrialFunction(Q))
        K_pu = ufl.derivative(F_p, u, ufl.TrialFunction(V))
        K_pp = ufl.derivative(F_p, p, ufl.TrialFunction(Q))
        _require_blocks(p, K_up=K_up, K_pu=K_pu, K_pp=K_pp)
        rectangular = (ufl.adjoint(K_up), K_pu)
        self._forms = tuple(torn_form(form, spaces, compiler) for form in rectangular)
        self._K_pp = torn_form(K_pp, (pressure_space, pressure_space), compiler)
        self._r_p = torn_form(F_p, (pressure_space,), compiler)
        self._rectangular = create_local_matrix(pressure_space, space, n_cells)
        self._square = create_local_matrix(pressure_space, pressure_space, n_cells)
        indptr, indices = self._rectangular.getRowIJ()
        width = indptr[1] if len(indptr) > 1 else 1
        self._columns = indices.reshape(-1, width).copy()

    @property
    def rows(self) -> PETSc.Mat:
        """K_pu as it was last assembled, sequential, (cells, torn dofs)."""
        return self._rectangular

    def assemble(self) -> Blocks:
        """Assemble all blocks at the present (u, p)."""
        k_up, k_pu = (self._rows(form) for form in self._forms)
        return Blocks(k_up, k_pu, self._diagonal(), self._residual())

    def add_to(self, K: PETSc.Mat, blocks: Blocks) -> None:
        """Add the condensed block, K ← K − K_up K_pp⁻¹ K_pu."""
        for first in range(0, len(blocks.k_pp), CHUNK):
            part = slice(first, first + CHUNK)
            left = -blocks.k_up[part] / blocks.k_pp[part, None]
            values = left[:, :, None] * blocks.k_pu[part][:, None, :]
            dofs = self._columns[part]
            K.setValuesRCV(dofs, dofs, values.reshape(len(dofs), -1), True)
        K.assemble()

    def residual(self, blocks: Blocks, n_torn: int) -> Array:
        """Return −K_up K_pp⁻¹ r_p on the torn dofs, (n_torn,)."""
        cell = -blocks.k_up * (blocks.r_p / blocks.k_pp)[:, None]
        return np.bincount(self._columns.ravel(), cell.ravel(), minlength=n_torn).astype(np.float64)

    def relaxed(self) -> Array:
        """Return the pressure that satisfies its own equation at the current u, p − K_pp⁻¹ r_p."""
        p = self.p.x.array.copy()
        p[self._pressure_dof] -= self._residual() / self._diagonal()
        return p

    def increment(self, blocks: Blocks, du: Array) -> Array:
        """Return Δp = −K_pp⁻¹ (r_p + K_pu Δu) at the dofs of Q.

        Args:
            blocks: Of the state where the increment begins.
            du: Torn displacement increment, (n_torn,).
        """
        dp = np.zeros(len(self.p.x.array))
        slope = np.einsum("ij,ij->i", blocks.k_pu, du[self._columns])
        dp[self._pressure_dof] = -(blocks.r_p + slope) / blocks.k_pp
        return dp

    def _diagonal(self) -> Array:
        """Assemble the diagonal of K_pp."""
        assemble(self._square, self._K_pp)
        return self._square.getDiagonal().array_r.copy()

    def _residual(self) -> Array:
        """Assemble r_p."""
        r_p = np.zeros(len(self._columns))
        dolfinx.fem.assemble_vector(r_p, self._r_p)
        return r_p

    def _rows(self, form: dolfinx.fem.Form) -> Array:
        assemble(self._rectangular, form)
        _, _, values = self._rectangular.getValuesCSR()
        return values.reshape(self._columns.shape)

    def destroy(self) -> None:
        """Free the matrices."""
        self._rectangular.destroy()
        self._square.destroy()


def pressure_patterns(decomposition: Decomposition) -> Array:
    """Return the monomials up to :data:`DEGREE` on the cells of each subdomain, (cells, patterns).

    The constant, the coordinates of the cells' midpoints from their mean over the subdomain, at
    most one in size, and products of them: in three dimensions 1, 4, 10, 20, 35 patterns up to
    degree 0, 1, 2, 3, 4.
    """
    mesh, subdomain = decomposition.mesh, decomposition.subdomain
    gdim, tdim = mesh.geometry.dim, mesh.topology.dim
    cells = np.arange(len(subdomain), dtype=np.int32)
    x = dolfinx.mesh.compute_midpoints(mesh, tdim, cells)[:, :gdim]
    count = np.maximum(np.bincount(subdomain, minlength=decomposition.count), 1)
    for column in x.T:
        mean = np.bincount(subdomain, column, minlength=decomposition.count) / count
        column -= mean[subdomain]
    size = np.zeros(decomposition.count)
    np.maximum.at(size, subdomain, np.abs(x).max(axis=1, initial=0.0))
    x /= np.where(size > 0.0, size, 1.0)[subdomain, None]
    degrees = range(DEGREE + 1)
    factors = (itertools.combinations_with_replacement(range(gdim), degree) for degree in degrees)
    return np.column_stack([x[:, list(of)].prod(axis=1) for of in itertools.chain(*factors)])


def _require_blocks(p: dolfinx.fem.Function, **blocks: ufl.Form) -> None:
    for name, block in blocks.items():
        if ufl.algorithms.expand_derivatives(block).empty():
            raise ValueError(
                f"condense is '{p.name}', but {name} is zero: condensation needs an energy with a "
                "term in both u and p and a term in p², such as p (J − 1) − p²/(2κ)."
            )
