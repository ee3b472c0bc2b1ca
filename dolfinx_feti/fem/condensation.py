# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Static condensation of fields that no two cells share, such as the pressure of P2–P0 elements.

.. math:: K = K_{uu} - K_{up} K_{pp}^{-1} K_{pu}, \quad r = r_u - K_{up} K_{pp}^{-1} r_p, \quad
          Δp = -K_{pp}^{-1}(r_p + K_{pu} Δu)

(eq. 29, Augustin_eq:volumetricVariationDis, for n = 1) with one block (n, n) of :math:`K_{pp}` for
each cell, see ``docs/theory.md``. With multipliers λ the residual of p is
:math:`r_p(u, p) - r_p(0, λ)`: only what p differs by from λ compresses the material.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.fem.assembly import LocalMatrix, cell_tensors
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.decomposition import TornSpace
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.native import load, pointer

#: Local steps in which fields with a nonlinear equation of their own come to satisfy it.
LOCAL_STEPS = 20

#: Share of the greatest value of a field below which its local steps end.
RELAXED = 1e-10

#: A block whose inverse is n times greater than the reciprocal is singular.
SINGULAR = 16 * np.finfo(np.float64).eps

SOURCE = Path(__file__).with_name("condensation.c")
DECLARATION = """
void subtract_products(int, int, int, int, const int *, const int *, const double *,
                       const double *, const int64_t *, double *);
"""


@dataclass(frozen=True, slots=True)
class Blocks:
    """Of the fields in each cell with d dofs of u and n of them, one field after the other."""

    k_up: Array  # K_up, (cells, d, n)
    slope: Array  # K_pp⁻¹ K_pu, (cells, n, d)
    excess: Array  # K_pp⁻¹ r_p, (cells, n, 1)


class Condensation:
    """The blocks of the mixed tangent that belong to the condensed fields, cell by cell.

    Attributes:
        fields: The fields.
        constraints: How many dofs on this process u is tied to: those of p, and not of a dilation.
    """

    def __init__(
        self,
        F_u: ufl.Form,
        F_p: Sequence[ufl.Form],
        u: dolfinx.fem.Function,
        fields: Sequence[dolfinx.fem.Function],
        *,
        space: TornSpace,
        compiler: Compiler,
    ) -> None:
        """Derive and compile the blocks of the residual F_u and of one F_p for each field.

        Raises a ValueError if a field does not occur in the residuals, they leave it undetermined,
        or couple two cells. Collective.
        """
        for p in fields:
            if not any(p in _expanded(F).coefficients() for F in (F_u, *F_p)):
                raise ValueError(
                    f"condense is '{p.name}', which does not occur in the energy (or in the "
                    "residuals): pass the pressure of a mixed energy Π(u, p)."
                )
        V = u.function_space
        du = ufl.TrialFunction(V)
        trials = [ufl.TrialFunction(p.function_space) for p in fields]
        K_up, *K_pp = (
            [ufl.derivative(F, p, dp) for p, dp in zip(fields, trials, strict=True)]
            for F in (F_u, *F_p)
        )
        K_pu = [ufl.derivative(F, u, du) for F in F_p]
        rows = {f"K_pp of '{p.name}'": row for p, row in zip(fields, K_pp, strict=True)}
        for block, forms in {"K_up": K_up, "K_pu": K_pu, **rows}.items():
            if all(_expanded(form).empty() for form in forms):
                names = ", ".join(f"'{p.name}'" for p in fields)
                raise ValueError(
                    f"condense is {names}, but {block} is zero: condensation needs an energy with "
                    "a term in both u and p and a term in p², such as p (J − 1) − p²/(2κ)."
                )
        self.fields = tuple(fields)
        blocks = [K for row in K_pp for K in row]
        self._linear = not any(p in _expanded(K).coefficients() for K in blocks for p in fields)
        self._tensors = cell_tensors([*K_up, *K_pu, *blocks, *F_p], V.mesh, compiler)
        cells = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
        dofs = [p.function_space.dofmap.list[:cells] for p in fields]
        self._widths = [each.shape[1] for each in dofs]
        self._first = np.cumsum([0] + [len(p.x.array) for p in fields[:-1]])
        places = [f + each for f, each in zip(self._first, dofs, strict=True)]
        self._place = np.concatenate(places, axis=1)  # in ``values``, (cells, n)
        self._u, self._compiler = u, compiler
        self._held = np.zeros((*self._place.shape, 1))  # r_p(0, λ)
        self._mean = np.zeros(self._place.shape)  # of ∫ q f in each cell, that of f
        self._tied = [not _expanded(K).empty() for K in K_pu]
        self.constraints = cells * int(np.dot(self._widths, self._tied))
        self._bs = V.dofmap.index_map_bs
        self._node = space.V_torn.dofmap.list[:cells]
        self._code = load(SOURCE, DECLARATION, V.mesh.comm)

    # -- state ------------------------------------------------------------------------------------

    def values(self) -> Array:
        """Copy the dofs of all fields with their ghosts, one field after the other."""
        return np.concatenate([p.x.array for p in self.fields])

    def set_values(self, values: Array) -> None:
        """Set the dofs of all fields, as in :meth:`values`."""
        for p, part in zip(self.fields, np.split(values, self._first[1:]), strict=True):
            p.x.array[:] = part

    def relax(self) -> None:
        """Let the fields satisfy their own equations at the present u, p ← p − K_pp⁻¹ r_p."""
        for _ in range(1 if self._linear else LOCAL_STEPS):
            _, _, K_pp, r_p = self._assembled()
            step = (self._inverse(K_pp) @ r_p)[:, :, 0]  # K_pp⁻¹ r_p
            values = self.values()
            values[self._place] -= step
            self.set_values(values)
            moved, sizes = (
                [part.max(initial=0.0) for part in self._by_field(np.abs(a))]
                for a in (step, values[self._place])
            )
            if np.all(moved <= RELAXED * np.array(sizes)):
                break

    def prepare_multipliers(self) -> None:
        """Compile what tells the mean of a cell. Collective."""
        ones = [dolfinx.fem.Function(p.function_space) for p in self.fields]
        for one in ones:
            one.interpolate(lambda x: np.ones(x.shape[1]))
        forms = [ufl.TestFunction(p.function_space) * ufl.dx for p in self.fields]
        volumes = cell_tensors(forms, self._u.function_space.mesh, self._compiler)()
        each = self._by_field(np.concatenate([one.x.array for one in ones])[self._place])
        means = [
            tied * c / (c * volume).sum(axis=1, keepdims=True)
            for tied, c, volume in zip(self._tied, each, volumes, strict=True)
        ]
        self._mean = np.concatenate(means, axis=1)

    def hold(self, values: Array) -> float:
        """Let only by how much the fields differ from λ, as in :meth:`values`, compress.

        Returns:
            The greatest change of the mean of r_p(0, λ) in a cell of this process. Where the state
            solves the equations of the fields and λ becomes p, it is that of abs(J − 1).
        """
        before, u, p = self._held, self._u.x.array.copy(), self.values()
        self._held = np.zeros_like(before)
        self._u.x.array[:] = 0.0
        self.set_values(values)
        try:
            self._held = self._assembled()[3]  # r_p(0, λ)
        finally:
            self._u.x.array[:] = u
            self.set_values(p)
        change = (self._mean * (self._held - before)[:, :, 0]).sum(axis=1)
        return float(np.abs(change).max(initial=0.0))

    def held_potential(self) -> float:
        """Return −p·r_p(0, λ) of this process, what multipliers add to the potential."""
        return -float(np.vdot(self._held[:, :, 0], self.values()[self._place]))

    # -- equations --------------------------------------------------------------------------------

    def assemble(self) -> Blocks:
        """Assemble all blocks at the present state.

        Raises:
            ValueError: K_pp is singular in a cell.
        """
        K_up, K_pu, K_pp, r_p = self._assembled()
        inverse = self._inverse(K_pp)
        return Blocks(K_up, inverse @ K_pu, inverse @ r_p)

    def subtract_from(self, K: LocalMatrix, blocks: Blocks) -> None:
        """Condense, K ← K − K_up K_pp⁻¹ K_pu."""
        indptr, values = K.csr.indptr, K.csr.data
        arrays = (self._node, K.place, blocks.k_up, blocks.slope, indptr, values)
        sizes = (*self._node.shape, self._bs, self._place.shape[1])
        self._code.lib.subtract_products(*sizes, *(pointer(self._code, a) for a in arrays))
        K.mat.stateIncrease()

    def residual(self, blocks: Blocks, n_torn: int) -> Array:
        """Return −K_up K_pp⁻¹ r_p on the torn dofs, (n_torn,)."""
        cell = -blocks.k_up @ blocks.excess
        return np.bincount(self.dofs().ravel(), cell.ravel(), minlength=n_torn).astype(np.float64)

    def increment(self, blocks: Blocks, du: Array) -> Array:
        """Return Δp = −K_pp⁻¹ (r_p + K_pu Δu), as in :meth:`values`, for a torn Δu, (n_torn,)."""
        dp = np.zeros(sum(len(p.x.array) for p in self.fields))
        slope = blocks.slope @ du[self.dofs()][:, :, None]
        dp[self._place] = -(blocks.excess + slope)[:, :, 0]
        return dp

    def dofs(self) -> Indices:
        """Return the torn dofs of each cell, as in the rows of K_up, (cells, d)."""
        n, k = self._node.shape
        dofs = self._node[:, :, None] * self._bs + np.arange(self._bs, dtype=np.int32)
        return dofs.reshape(n, k * self._bs)

    def _by_field(self, values: Array) -> list[Array]:
        """Split what belongs to all fields of a cell, (cells, n)."""
        return np.split(values, np.cumsum(self._widths)[:-1], axis=1)

    def _assembled(self) -> tuple[Array, Array, Array, Array]:
        """Assemble K_up, (cells, d, n), K_pu, K_pp and r_p(u, p) − r_p(0, λ), (cells, n, 1)."""
        n, parts = len(self.fields), self._tensors()
        K_pp = [parts[i : i + n] for i in range(2 * n, len(parts) - n, n)]
        K_pu = [[part] for part in parts[n : 2 * n]]
        residual = np.concatenate(parts[-n:], axis=1)[:, :, None] - self._held
        return np.block(parts[:n]), np.block(K_pu), np.block(K_pp), residual

    def _inverse(self, K_pp: Array) -> Array:
        """Return K_pp⁻¹, (cells, n, n); scaling its rows and columns removes all units.

        Raises:
            ValueError: K_pp is singular in a cell.
        """
        n = K_pp.shape[1]
        rows = _reciprocal(np.abs(K_pp).max(axis=2, keepdims=True, initial=0.0))
        columns = _reciprocal(np.abs(rows * K_pp).max(axis=1, keepdims=True, initial=0.0))
        A = rows * K_pp * columns
        try:
            inverse = np.linalg.inv(A)
            singular = np.abs(inverse).max(axis=(1, 2), initial=0.0) * n * SINGULAR >= 1.0
        except np.linalg.LinAlgError:  # a pivot is zero
            singular = np.linalg.matrix_rank(np.nan_to_num(A), n * SINGULAR) < n
            singular &= np.isfinite(A).all(axis=(1, 2))
        if singular.any():
            cell = int(np.argmax(singular))
            starts = (A[cell, :, :j] for j in range(1, n + 1))
            dependent = [np.linalg.matrix_rank(a, n * SINGULAR) < a.shape[1] for a in starts]
            raise ValueError(self._singular(cell, int(np.argmax(dependent))))
        return np.swapaxes(columns, 1, 2) * inverse * np.swapaxes(rows, 1, 2)

    def _singular(self, cell: int, column: int) -> str:
        """Say where K_pp is singular, and what helps."""
        p = self.fields[int(np.searchsorted(np.cumsum(self._widths), column, side="right"))]
        mesh = p.function_space.mesh
        cells = np.array([cell], dtype=np.int32)
        middle = dolfinx.mesh.compute_midpoints(mesh, mesh.topology.dim, cells)[0]
        place = ", ".join(f"{x:.4g}" for x in middle[: mesh.geometry.dim])
        return (
            f"condense: the block of '{p.name}' is singular in cell {cell} of process "
            f"{mesh.comm.rank}, around ({place}), so that the equations there do not determine it: "
            "give a pressure a term of its own, such as −p²/(2κ), and a dilation θ in Ψ(θ) + "
            "p (J − θ) the element of p."
        )


def _reciprocal(sizes: Array) -> Array:
    """Return 1 / x, and 1 for zero."""
    return 1.0 / np.where(sizes == 0.0, 1.0, sizes)


def _expanded(form: ufl.Form) -> ufl.Form:
    return ufl.algorithms.expand_derivatives(form)
