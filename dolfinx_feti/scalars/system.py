# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The scalars in Newton's system: assembly of their columns and rows, and its solution.

.. math:: K\, Δu + B\, Δs = -r, \quad C^⊤ Δu + D\, Δs = -c, \qquad
          B = ∂r/∂s, \quad C = ∂c/∂u, \quad D = ∂c/∂s

The equations may have any units: c_k counts as zero if \|c_k\| is small compared with its change as
u and s change by their own size, or u by the size of a cell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from petsc4py import PETSc

import numpy as np
import scipy.linalg

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.fem.assembly import assemble_owned
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.quadrature import quadrature_degrees, set_quadrature_degrees
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.collective import on_all, total_of
from dolfinx_feti.scalars.border import Border
from dolfinx_feti.scalars.bordered import BorderedSolver, solve_ksp
from dolfinx_feti.scalars.equations import (
    Coupling,
    ScalarEquation,
    derivative_in,
    values_of,
    with_trial,
)

__all__ = ["ScalarSystem"]


#: Largest |c_k| of a satisfied equation, relative to its scale: a tenth of the default tolerance of
#: Newton's method.
EQUATION_RTOL = 1e-9

#: Sine of the angle between two normalised constraints below which they count as dependent. Its
#: square is compared with an eigenvalue of their products, whose rounding errors are some 2e-16;
#: it is the root of these with a margin.
DEPENDENT_SINE = 1e-7

#: Largest derivative of an equation by the free dofs, relative to that by all dofs, that counts as
#: zero: a margin above rounding, not measured.
ROUNDING_SHARE = 1e-10

#: Smallest coefficient, in a combination of norm one that vanishes, of an equation that is named in
#: the message. It affects the message alone.
NAMED_ENTRY = 1e-3


def column_in(
    residual: ufl.Form,
    equations: Sequence[ScalarEquation],
    directions: Mapping[dolfinx.fem.Constant, Expr],
) -> ufl.Form:
    """Return B Δs = ∂r/∂s · Δs, the user's columns or derived ones.

    Args:
        residual: r(u, s; v).
        equations: All equations.
        directions: Δs, by the constant of each unknown.
    """
    degrees = quadrature_degrees(residual)
    derived: list[tuple[dolfinx.fem.Constant, Expr]] = []
    B = ufl.Form([])
    for equation in equations:
        s = equation.unknown
        if equation.tangent is None:
            derived.append((s, directions[s]))
        elif equation.tangent.column is not None:
            column = set_quadrature_degrees(equation.tangent.column, degrees)
            B = B + with_trial(column, directions[s])
    return B + derivative_in(residual, derived)


def row_in(equation: ScalarEquation, k: int, c_k: ufl.Form, u: dolfinx.fem.Function) -> ufl.Form:
    """Return the k-th row of Cᵀ, ∂c_k/∂u, the user's or derived from c_k(u, s)."""
    if equation.tangent is None:
        return ufl.derivative(c_k, u)
    row = equation.tangent.rows[k]
    return ufl.Form([]) if row is None else set_quadrature_degrees(row, quadrature_degrees(c_k))


def block_in(
    equation: ScalarEquation, k: int, c_k: ufl.Form, directions: Mapping[dolfinx.fem.Constant, Expr]
) -> ufl.Form:
    """Return the k-th row of D Δs, ∂c_k/∂s · Δs, by the user's blocks or derived from c_k(u, s)."""
    blocks = {} if equation.tangent is None else equation.tangent.blocks
    degrees = quadrature_degrees(c_k)
    derived: list[tuple[dolfinx.fem.Constant, Expr]] = []
    D = ufl.Form([])
    for s, ds in directions.items():
        if s not in blocks:
            derived.append((s, ds))
            continue
        block = blocks[s][k]
        if block is not None:
            D = D + with_trial(set_quadrature_degrees(block, degrees), ds)
    return D + derivative_in(c_k, derived)


class ScalarSystem:
    """The scalars of a problem, possibly none, and their part of Newton's system.

    Attributes:
        size: Number m of scalars.
        border: B, C and D of the last :meth:`linearise`.
        increment: Δs of the last :meth:`solve`, (m,).
    """

    def __init__(
        self,
        couplings: Sequence[Coupling],
        u: dolfinx.fem.Function,
        residual: ufl.Form,
        compiler: Compiler,
        *,
        free: Mask,
    ) -> None:
        """Compile the forms. Collective.

        Args:
            couplings: Equations, cavities and Windkessels.
            u: The unknown field.
            residual: r(u, s; v), with the work of the scalars.
            compiler: Compiler of forms.
            free: Mask of the dofs without Dirichlet condition, (N,).
        """
        self._couplings = couplings
        self._comm = compiler.comm
        self._reset(free)
        self._equations = [coupling.equation for coupling in couplings]
        c: list[ufl.Form] = []
        for equation in self._equations:
            for form in equation.equations:
                c.append(set_quadrature_degrees(form, quadrature_degrees(form)))
        self.size = len(c)
        self._owned = len(free)
        self.border = self._zero_border()
        self.increment: Array = np.zeros(len(c))
        self._c = [compiler.form(form) for form in c]
        self._B: dolfinx.fem.Form | None = None
        self._C: list[dolfinx.fem.Form | None] = []
        self._D: list[dolfinx.fem.Form | None] = []
        if not c:
            return
        # The unit vector of one scalar: the derivatives in its direction are a column of B and D.
        self._direction = dolfinx.fem.Constant(u.function_space.mesh, np.zeros(len(c)))
        directions = self._directions()
        B = column_in(residual, self._equations, directions)
        rows: list[ufl.Form] = []
        blocks: list[ufl.Form] = []
        for equation in self._equations:
            for k in range(len(equation.equations)):
                form = c[len(rows)]
                rows.append(row_in(equation, k, form, u))
                blocks.append(block_in(equation, k, form, directions))

        def compiled(derivative: ufl.Form) -> dolfinx.fem.Form | None:
            """Return the compiled form of a derivative; None if it vanishes."""
            is_zero = ufl.algorithms.expand_derivatives(derivative).empty()
            return None if is_zero else compiler.form(derivative)

        self._B = compiled(B)
        self._C = [compiled(row) for row in rows]
        self._D = [compiled(block) for block in blocks]

    def _directions(self) -> dict[dolfinx.fem.Constant, Expr]:
        """Return, by the constant of each unknown, its part of the direction, in its shape.

        If two equations share an unknown, it has both parts, and the check of independence finds
        that their columns are equal.
        """
        ds = iter(self._direction)
        directions: dict[dolfinx.fem.Constant, Expr] = {}
        for equation in self._equations:
            part = [next(ds) for _ in equation.equations]
            s = equation.unknown
            direction = ufl.as_vector(part) if s.ufl_shape else part[0]
            directions[s] = directions[s] + direction if s in directions else direction
        return directions

    def prescribe(self, bcs: Sequence[dolfinx.fem.DirichletBC], *, free: Mask) -> None:
        """Change the Dirichlet conditions. Collective.

        Args:
            bcs: The new conditions.
            free: Mask of the dofs without them, (N,).
        """
        for coupling in self._couplings:
            coupling.check(bcs)
        self._reset(free)

    def _reset(self, free: Mask) -> None:
        """Discard what depends on the free dofs: the check of independence, and the springs."""
        self._free = free
        self._is_checked = False
        self._solver = BorderedSolver()

    def values(self) -> Array:
        """Return s, (m,)."""
        s = [values_of(equation.unknown) for equation in self._equations]
        return np.concatenate([np.zeros(0), *s])

    def set_values(self, s: Array) -> None:
        """Set s, (m,)."""
        for equation in self._equations:
            values, s = np.split(s, [len(equation.equations)])
            equation.unknown.value = values.reshape(equation.unknown.ufl_shape)
            if equation.mirror is not None:
                equation.mirror.x.array[:] = values

    def residual(self) -> Array:
        """Return c(u, s), (m,). Collective."""
        return total_of(np.array([dolfinx.fem.assemble_scalar(c) for c in self._c]), self._comm)

    def linearise(self) -> None:
        """Assemble B, C and D at the present state. Collective."""
        border = self._zero_border()
        B = border.B
        C = border.C
        D = border.D
        for j, unit in enumerate(np.eye(self.size)):
            self._direction.value = unit
            if self._B is not None:
                B[:, j] = assemble_owned(self._B)
            row = self._C[j]
            if row is not None:
                C[:, j] = assemble_owned(row)
            for i, block in enumerate(self._D):
                if block is not None:
                    D[i, j] = dolfinx.fem.assemble_scalar(block)
        self.border = Border(B, C, total_of(D, self._comm))

    def _zero_border(self) -> Border:
        """Return B, C and D with zeros."""
        n = self._owned
        m = self.size
        return Border(np.zeros((n, m)), np.zeros((n, m)), np.zeros((m, m)))

    def solve(self, ksp: PETSc.KSP, A: PETSc.Mat, r: Array, c: Array) -> Array:
        """Solve for Δu and Δs with the present border. Collective.

        Args:
            ksp: A KSP with a FETI context.
            A: Torn matrix.
            r: Residual of u, (N,).
            c: Residuals of the equations, (m,).

        Returns:
            Δu, (N,); Δs is :attr:`increment`.
        """
        if not self.size:
            return solve_ksp(ksp, A, -r)
        du, self.increment = self._solver.solve(ksp, A, -r, self.border, -c)
        return du

    def correction(self, ksp: PETSc.KSP, r: Array, c: Array) -> tuple[Array, Array] | None:
        """Return approximate increments for residuals, without a solve. Collective.

        They come from the preconditioner of the last matrix and the border of the last
        :meth:`solve`.

        Args:
            ksp: A KSP with a FETI context.
            r: Residual of u, zero on Dirichlet dofs, (N,).
            c: Residuals of the equations, (m,).

        Returns:
            Δu, (N,), and Δs, (m,); None without a preconditioner or border.
        """
        if self.size:
            return self._solver.correction(ksp, -r, -c)
        z = ksp.getPythonContext().correction(ksp, -r)
        return None if z is None else (z, np.zeros(0))

    def error_of_correction(self, ds: Array, s: Array, u: Array) -> float:
        """Return the largest |Δs_k| relative to the size of s_k. Collective.

        See :meth:`BorderedSolver.error_of_correction
        <dolfinx_feti.scalars.bordered.BorderedSolver.error_of_correction>`.

        Args:
            ds: Δs, (m,).
            s: Largest size of s_k among the iterates, (m,).
            u: Largest size of u_j among the iterates, (N,).
        """
        return self._solver.error_of_correction(ds, s, u, self._comm)

    def scales(self, u: Array, h: Array | float) -> Array:
        r"""Return the scales of the equations, (m,). Collective.

        .. math:: \Bigl(\sum_j C_{jk}^2 (u_j^2 + h_j^2)\Bigr)^{1/2} + \sum_l |D_{kl} s_l|

        Args:
            u: Size of u at each dof, (N,).
            h: Size of the cells at each dof, (N,), if u is a displacement; else zero.
        """
        squares = (self.border.C**2 * (u**2 + np.square(h))[:, None]).sum(axis=0)
        change_by_u = np.sqrt(total_of(squares, self._comm))
        change_by_s = np.abs(self.border.D) @ np.abs(self.values())
        return change_by_u + change_by_s

    def are_satisfied(self, c: Array, u: Array, h: Array | float) -> bool:
        """Return True if all equations hold: each c_k is small relative to its scale. Collective.

        Args:
            c: Residuals of the equations, (m,).
            u: See :meth:`scales`.
            h: See :meth:`scales`.
        """
        return bool(np.all(np.abs(c) <= EQUATION_RTOL * self.scales(u, h)))

    def force_of(self, s: Array) -> Array:
        """Return B s, the force on u of values or increments of the scalars, (N,)."""
        return np.asarray(self.border.B @ s)

    def force(self) -> Array:
        """Return B s, the force of the present scalars on u, (N,)."""
        return self.force_of(self.values())

    def begin_step(self, length: float) -> None:
        """Prepare a step of a path, of this length in its load or time. Not collective."""
        for coupling in self._couplings:
            coupling.begin_step(length)

    def accept(self) -> None:
        """Store the present state as the last one of a path. Collective."""
        for coupling in self._couplings:
            coupling.accept()

    @property
    def histories(self) -> list[dolfinx.fem.Function]:
        """Functions that :meth:`accept` changes; the Constants that it changes are not listed."""
        return [f for coupling in self._couplings for f in coupling.functions]

    def check(self) -> None:
        """Check that the values and equations have a solution. Collective.

        Raises:
            ValueError: They have none; on all processes.
        """
        for coupling in self._couplings:
            on_all(coupling.check_values, self._comm)
        if self.size and not self._is_checked:
            self._check_independence(self._free)
            self._is_checked = True

    def _check_independence(self, free: Mask) -> None:
        """Check that equations depend on free dofs, and not on each other. Collective."""
        self.linearise()
        border = self.border
        self._check_columns(border.C, border.D.T, free, "equations")
        self._check_columns(border.B, border.D, free, "unknowns")

    def _check_columns(self, columns: Array, corner: Array, free: Mask, kind: str) -> None:
        """Check that columns of a border are not zero on free dofs, and independent. Collective.

        Columns that are coupled to another scalar by D are not checked.

        Args:
            columns: B or C, (N, m).
            corner: D or Dᵀ, (m, m).
            free: Mask of the dofs without Dirichlet condition, (N,).
            kind: Name of the columns in a message.
        """
        all_squares = total_of((columns**2).sum(axis=0), self._comm)
        gram = total_of(columns[free].T @ columns[free], self._comm)
        size = np.sqrt(gram.diagonal())
        is_coupled = np.abs(corner).max(axis=0, initial=0.0) > 0.0  # with another scalar
        is_zero = size <= ROUNDING_SHARE * np.sqrt(all_squares)
        idle = np.flatnonzero(is_zero & ~is_coupled)
        if len(idle):
            raise ValueError(
                f"The scalar {kind} {idle.tolist()} depend neither on a free dof of u nor on "
                "another scalar, so that no solve can satisfy them. Look at the Dirichlet "
                "conditions and at the measures."
            )
        alone = np.flatnonzero(~is_coupled)
        if not len(alone):
            return
        normalised = gram[np.ix_(alone, alone)] / np.outer(size[alone], size[alone])
        values, vectors = scipy.linalg.eigh(normalised)
        if values[0] < DEPENDENT_SINE**2:
            dependent = alone[np.abs(vectors[:, 0]) > NAMED_ENTRY]
            raise ValueError(
                f"The scalar {kind} {dependent.tolist()} depend on each other, so that they "
                "contradict each other or leave a multiplier free: leave one of them out."
            )
