# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Static condensation of fields that no two cells share, such as the pressure of P2–P0 elements.

.. math:: K = K_{uu} - K_{up} K_{pp}^{-1} K_{pu}, \quad r = r_u - K_{up} K_{pp}^{-1} r_p, \quad
          Δp = -K_{pp}^{-1}(r_p + K_{pu} Δu)

(eq. 29 of the paper for one field; docs/theory.md), with one block (n, n) of :math:`K_{pp}` for
each cell. A cell has d dofs of u and n dofs of all condensed fields, field by field.

With multipliers λ the residual of p is :math:`r_p(u, p) - r_p(0, λ)`. In the energy
:math:`p (J - 1) - p^2/(2κ)` that is :math:`J - 1 - (p - λ)/κ`: where p equals λ, J is 1 for any κ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.fem.assembly import LocalMatrix
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.condensation.cell_inverse import SingularCellError, invert
from dolfinx_feti.fem.condensation.cellwise_forms import CellwiseForms
from dolfinx_feti.fem.condensation.condensed_fields import CondensedFields
from dolfinx_feti.fem.condensation.mixed_tangent import (
    block_of_user,
    check_blocks,
    derive_tangent,
    tangent_of_user,
)
from dolfinx_feti.fem.condensation.multipliers import Multipliers
from dolfinx_feti.fem.decomposition import TornSpace
from dolfinx_feti.runtime.arrays import Array, Indices
from dolfinx_feti.runtime.native import load, pointer

#: Upper bound of Newton steps in each cell for the equations of the fields at a fixed u. They
#: converge quadratically, in five steps or so. The bound is reached in states where the equations
#: have no solution; the fields then have the values of the last step.
MAX_LOCAL_STEPS = 20

#: The local steps end when they change no field by more than this share of its largest value. The
#: change of the next step would be its square, 1e-20, which is below rounding.
LOCAL_RTOL = 1e-10

SOURCE = Path(__file__).with_name("condensation.c")
DECLARATIONS = "\n".join(
    path.read_text(encoding="utf-8")
    for path in (SOURCE.parents[1] / "csr_matrix.h", SOURCE.with_suffix(".h"))
)


@dataclass(frozen=True, slots=True)
class CellMatrices:
    """Matrices of the owned cells that condensation needs, at one state.

    Attributes:
        K_up: (cells, d, n).
        slope: K_pp⁻¹ K_pu, (cells, n, d).
        excess: K_pp⁻¹ r_p, (cells, n, 1).
    """

    K_up: Array
    slope: Array
    excess: Array


@dataclass(frozen=True, slots=True)
class _MixedMatrices:
    """The mixed tangent in each owned cell, and the residual of the fields with multipliers.

    Attributes:
        K_up: (cells, d, n).
        K_pu: (cells, n, d).
        K_pp: (cells, n, n).
        r_p: r_p(u, p) − r_p(0, λ), (cells, n, 1).
    """

    K_up: Array
    K_pu: Array
    K_pp: Array
    r_p: Array


@dataclass(frozen=True, slots=True)
class ConstraintProducts:
    """Products of the blocks of an incompressible field, summed over the cells of a process.

    The equation of the field is c g(u), such as c (J − 1). K_up is the force of the field, the
    derivative of g(u), so that K_pu = c K_upᵀ. Summed over all processes, the products determine
    c = mixed / square. ``stiffness`` is the trace of what condensation of this field alone adds to
    K; it is compared with the trace of the tangent to choose a modulus κ. M is −K_pp of the field,
    without blocks that couple it with other fields: its equation contains none of them. For a
    pressure in kPa the units are:

    Attributes:
        mixed: K_upᵀ : K_pu [mm⁴].
        square: K_up : K_up [mm⁴].
        stiffness: tr K_up M⁻¹ K_pu [mN/mm].
    """

    mixed: float
    square: float
    stiffness: float


class Condensation:
    """Condensed fields with their equations, cell by cell.

    The present state is that of the Functions u and the fields. :meth:`assemble` returns the
    matrices at this state; :meth:`condense`, :meth:`residual` and :meth:`increment` use them. The
    equations contain no multipliers until :meth:`create_multipliers` is called.

    Attributes:
        fields: The fields.
        n_constraints: Number of constraints on u on this process: the dofs of all fields whose
            equations contain u. A pressure is such a field; a dilation is not.
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
        tangent: Sequence[Sequence[ufl.Form | None]] | None = None,
        compression: Sequence[ufl.Form | None] | None = None,
    ) -> None:
        """Derive and compile the blocks of the tangent. Collective.

        Args:
            F_u: Residual tested with v.
            F_p: Residual of each field.
            u: The unknown.
            fields: The fields.
            space: Torn space of u.
            compiler: Compiler of the forms.
            tangent: Blocks of the tangent in u and the fields, (1 + fields, 1 + fields), None for
                a zero block. If no tangent is given, it is derived from the residuals.
            compression: The term −γ p q that ``problems.unknowns.compression`` added to the
                residual of each incompressible field p, and None for the other fields. Multipliers
                replace p in these terms only, see :meth:`set_multipliers`.

        Raises:
            ValueError: A field is in no residual, the residuals do not determine it, or they couple
                two cells.
        """
        V = u.function_space
        mesh = V.mesh
        if tangent is None:
            mixed = derive_tangent(F_u, F_p, u, fields)
        else:
            mixed = tangent_of_user(tangent, u, fields)
        check_blocks(mixed, [F_u, *F_p], fields)
        self.fields = tuple(fields)
        self._u = u
        self._compiler = compiler
        self._numbering = CondensedFields(fields)
        # A user's tangent need not be the derivative: one step may not solve a linear equation.
        self._has_linear_equations = tangent is None and mixed.is_constant_in_fields(fields)
        self._tangent = mixed
        self._forms = CellwiseForms([*mixed.forms(), *F_p], mesh, compiler)
        self._contains_u = np.array([not block.is_zero for block in mixed.K_pu])  # (fields,)
        n_cells = len(self._numbering.entries)
        self.n_constraints = n_cells * int(np.dot(self._numbering.widths, self._contains_u))

        # multipliers
        self._compression: CellwiseForms | None = None
        if compression is not None and any(term is not None for term in compression):
            pairs = zip(compression, fields, strict=True)
            terms = [block_of_user(term, p.function_space).form for term, p in pairs]
            self._compression = CellwiseForms(terms, mesh, compiler)
        self._multipliers: Multipliers | None = None

        # matrix
        self._bs = V.dofmap.index_map_bs
        self._nodes = space.V_torn.dofmap.list[:n_cells]
        self._module = load(SOURCE, DECLARATIONS, mesh.comm)

    # -- state ------------------------------------------------------------------------------------

    def values(self) -> Array:
        """Return a copy of the dofs of all fields with their ghosts, field by field, (size,)."""
        return self._numbering.values()

    def set_values(self, values: Array) -> None:
        """Set the dofs of all fields, (size,), as in :meth:`values`."""
        self._numbering.set_values(values)

    def relax(self) -> None:
        """Solve the equations of the fields in each owned cell, at the present u. Not collective.

        The steps are p ← p − K_pp⁻¹ r_p. They end after :data:`MAX_LOCAL_STEPS`, whether the
        equations are solved or not: the rest of r_p is part of the condensed residual
        (:meth:`residual`), which Newton's method reduces.
        """
        steps = 1 if self._has_linear_equations else MAX_LOCAL_STEPS
        for _ in range(steps):
            mixed = self._assemble_mixed()
            step = (self._inverse(mixed.K_pp) @ mixed.r_p)[:, :, 0]
            values = self.values()
            values[self._numbering.entries] -= step
            self.set_values(values)
            changes = self._largest_of_fields(step)
            sizes = self._largest_of_fields(values[self._numbering.entries])
            if np.all(changes <= LOCAL_RTOL * sizes):
                break

    def _largest_of_fields(self, cell_values: Array) -> Array:
        """Return the largest absolute value of each field, (fields,), of (cells, n) values."""
        return np.array(
            [np.abs(of_field).max(initial=0.0) for of_field in self._numbering.split(cell_values)]
        )

    # -- multipliers ------------------------------------------------------------------------------

    def create_multipliers(self, constraint_sizes: Sequence[float] | None = None) -> None:
        """Create multipliers λ = 0 of the fields.

        Args:
            constraint_sizes: Size |c| of the constraint in each field's equation c g(u), such as 2
                for 2 (J − 1); 1 for all if not given.

        Raises:
            ValueError: A field is no scalar, as pressures are.

        Note:
            Collective.
        """
        for p in self.fields:
            if p.ufl_shape:
                raise ValueError(
                    "A volume tolerance turns condensed pressures into multipliers, but "
                    f"'{p.name}' has the shape {p.ufl_shape}: leave volume_tolerance out, and give "
                    "the pressure a large bulk modulus, −p²/(2κ)."
                )
        self._multipliers = Multipliers(
            self._numbering,
            self._compiler,
            is_constraint=self._contains_u,
            constraint_sizes=constraint_sizes,
        )

    def set_multipliers(self, values: Array) -> float:
        """Set the multipliers λ, and return by how much they change the volume of a cell.

        From now on the residual of the fields is r_p(u, p) − r_p(0, λ). If the problem has
        compression terms, r_p(0, λ) consists of these terms alone, evaluated at λ. If p solves its
        equation with the old λ, then with λ = p as the new one r_p(0, λ) changes by −g(u), the
        constraint, such as J − 1.

        Args:
            values: λ, (size,), as in :meth:`values`.

        Returns:
            The largest change of the mean of r_p(0, λ) in a cell of this process, over all fields
            whose equations contain u, each relative to its constraint size.

        Raises:
            RuntimeError: :meth:`create_multipliers` was not called before.
        """
        if self._multipliers is None:
            raise RuntimeError("set_multipliers needs create_multipliers before the first call.")
        return self._multipliers.change_residual(self._residual_without_displacement(values))

    def _residual_without_displacement(self, values: Array) -> Array:
        """Return r_p(0, λ), or the compression terms at λ, (cells, n, 1).

        u and the fields are set to 0 and λ during the assembly, and restored afterwards.
        """
        u = self._u.x.array.copy()
        p = self.values()
        try:
            self.set_values(values)
            if self._compression is not None:
                return np.concatenate(self._compression.assemble(), axis=1)[:, :, None]
            self._u.x.array[:] = 0.0
            _, residuals = self._assemble_forms()
            return residuals
        finally:
            self._u.x.array[:] = u
            self.set_values(p)

    def multiplier_potential(self) -> float:
        """Return −p·r_p(0, λ) on this process [mN mm], which multipliers add to the potential."""
        if self._multipliers is None:
            return 0.0
        p = self.values()[self._numbering.entries]
        return -float(np.vdot(self._multipliers.residual[:, :, 0], p))

    def constraint_products(self, index: int) -> ConstraintProducts:
        """Return products of the blocks of the incompressible field with an index."""
        mixed = self._assemble_mixed()
        columns = self._numbering.columns(index)
        K_up = mixed.K_up[:, :, columns]
        K_pu = mixed.K_pu[:, columns]
        M = -mixed.K_pp[:, columns, columns]
        slope = np.linalg.solve(M, K_pu) if len(M) else K_pu  # M⁻¹ K_pu
        return ConstraintProducts(
            mixed=float(np.einsum("cdn,cnd->", K_up, K_pu)),  # K_upᵀ : K_pu
            square=float((K_up**2).sum()),
            stiffness=float(np.einsum("cdn,cnd->", K_up, slope)),  # tr K_up M⁻¹ K_pu
        )

    # -- equations --------------------------------------------------------------------------------

    def assemble(self) -> CellMatrices:
        """Assemble the matrices of all cells at the present state.

        Raises:
            ValueError: K_pp is singular in a cell.
        """
        mixed = self._assemble_mixed()
        inverse = self._inverse(mixed.K_pp)
        return CellMatrices(mixed.K_up, inverse @ mixed.K_pu, inverse @ mixed.r_p)

    def condense(self, K: LocalMatrix, matrices: CellMatrices) -> None:
        """Condense the fields into a local matrix in place, K ← K − K_up K_pp⁻¹ K_pu.

        Args:
            K: Assembled matrix K_uu; its entries are changed.
            matrices: What :meth:`assemble` returned at the state of K.
        """
        module = self._module
        n = self._numbering.entries.shape[1]
        K_up = pointer(module, matrices.K_up)
        slope = pointer(module, matrices.slope)
        module.lib.subtract_products(K.c_struct(module), n, K_up, slope)
        K.mat.stateIncrease()

    def residual(self, matrices: CellMatrices, n_torn: int) -> Array:
        """Return what the fields add to the condensed residual, −K_up K_pp⁻¹ r_p, (n_torn,).

        Args:
            matrices: What :meth:`assemble` returned at the present state.
            n_torn: Number of torn dofs of u on this process.
        """
        correction = -matrices.K_up @ matrices.excess
        sums = np.bincount(self.dofs().ravel(), correction.ravel(), minlength=n_torn)
        return sums.astype(np.float64)  # without any cell, NumPy returns integers

    def increment(self, matrices: CellMatrices, du: Array) -> Array:
        """Return Δp = −K_pp⁻¹ (r_p + K_pu Δu), (size,); zero for ghosts.

        Args:
            matrices: What :meth:`assemble` returned at the state of the step.
            du: Torn increment Δu, (n_torn,).
        """
        dp = np.zeros(self._numbering.size)
        slope_du = matrices.slope @ du[self.dofs()][:, :, None]
        dp[self._numbering.entries] = -(matrices.excess + slope_du)[:, :, 0]
        return dp

    def dofs(self) -> Indices:
        """Return the torn dofs of u in each owned cell, as in the rows of K_up, (cells, d)."""
        n_cells, nodes = self._nodes.shape
        dofs = self._nodes[:, :, None] * self._bs + np.arange(self._bs, dtype=np.int32)
        return dofs.reshape(n_cells, nodes * self._bs)

    def _assemble_mixed(self) -> _MixedMatrices:
        """Assemble the mixed tangent and the residual of the fields."""
        tangent, residuals = self._assemble_forms()
        K_up, K_pu, K_pp = self._tangent.split(tangent)
        if self._multipliers is not None:
            residuals = residuals - self._multipliers.residual
        return _MixedMatrices(
            K_up=np.block(K_up),
            K_pu=np.block([[block] for block in K_pu]),
            K_pp=np.block(K_pp),
            r_p=residuals,
        )

    def _assemble_forms(self) -> tuple[list[Array], Array]:
        """Assemble the blocks and the residual of the fields, without multipliers.

        Returns:
            Arrays of the blocks, in the order of ``MixedTangent.forms``, and r_p(u, p), (cells, n,
            1).
        """
        arrays = self._forms.assemble()
        n_fields = len(self.fields)
        return arrays[:-n_fields], np.concatenate(arrays[-n_fields:], axis=1)[:, :, None]

    def _inverse(self, K_pp: Array) -> Array:
        """Return K_pp⁻¹, (cells, n, n).

        Raises:
            ValueError: K_pp is singular in a cell; the message names the field and the place.
        """
        try:
            return invert(K_pp)
        except SingularCellError as error:
            raise ValueError(self._singular_message(error.cell, error.column)) from error

    def _singular_message(self, cell: int, column: int) -> str:
        """Return the message for a singular K_pp.

        Args:
            cell: The cell.
            column: Column of K_pp whose field is not determined.
        """
        p = self._numbering.field_of_column(column)
        mesh = p.function_space.mesh
        cells = np.array([cell], dtype=np.int32)
        midpoint = dolfinx.mesh.compute_midpoints(mesh, mesh.topology.dim, cells)[0]
        where = ", ".join(f"{x:.4g}" for x in midpoint[: mesh.geometry.dim])
        return (
            f"condense: the block of '{p.name}' is singular in cell {cell} of process "
            f"{mesh.comm.rank}, around ({where}). The equations there do not determine the field. "
            "A pressure needs a term without u, such as −p²/(2κ). A dilation θ, as in "
            "Ψ(θ) + p (J − θ), needs the same element as p. Two pressures that occur only as "
            "their sum p + q need a term of their own each, such as −p²/(2κ) − q²/(2κ)."
        )
