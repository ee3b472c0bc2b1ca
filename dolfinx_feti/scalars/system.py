# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The scalars in Newton's system: their values, residuals and border, and its solution.

.. math:: K\, Δu + B\, Δs = -r, \quad C^⊤ Δu + D\, Δs = -c, \qquad
          B = ∂r/∂s, \quad C = ∂c/∂u, \quad D = ∂c/∂s

The equations may have any units: c_k counts as zero if \|c_k\| is small compared with its change as
u and s change by their own size, or u by the size of a cell.
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.fem.quadrature import quadrature_degrees, set_quadrature_degrees
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.collective import on_all, total_of
from dolfinx_feti.scalars.border import Border
from dolfinx_feti.scalars.border_forms import BorderForms
from dolfinx_feti.scalars.bordered import BorderedSolver
from dolfinx_feti.scalars.equations import Coupling, values_of
from dolfinx_feti.scalars.independence import require_independent
from dolfinx_feti.scalars.matrix_solver import solve_ksp

__all__ = ["ScalarSystem"]

#: Largest |c_k| of a satisfied equation, relative to its scale: a tenth of the default tolerance of
#: Newton's method.
EQUATION_RTOL = 1e-9


class ScalarSystem:
    """The scalars of a problem, possibly none, and their part of Newton's system.

    Attributes:
        size: Number m of scalars.
        border: B, C and D of the last :meth:`linearise`; zero before the first one.
    """

    def __init__(
        self,
        couplings: Sequence[Coupling],
        u: dolfinx.fem.Function,
        residual: ufl.Form,
        compiler: Compiler,
        *,
        is_free: Mask,
    ) -> None:
        """Compile the forms. Collective.

        Args:
            couplings: Equations, cavities and Windkessels.
            u: The unknown field.
            residual: r(u, s; v), with the work of the scalars.
            compiler: Compiler of forms.
            is_free: Mask of the dofs without Dirichlet condition, (N,).
        """
        self._couplings = couplings
        self._comm = compiler.comm
        self._equations = [coupling.equation for coupling in couplings]
        components = [
            [set_quadrature_degrees(c_k, quadrature_degrees(c_k)) for c_k in equation.equations]
            for equation in self._equations
        ]
        self._c = [compiler.form(c_k) for forms in components for c_k in forms]
        self._border_forms: BorderForms | None = None
        if self._c:
            self._border_forms = BorderForms(self._equations, components, u, residual, compiler)
        self.size = len(self._c)
        self.border = Border.zero(len(is_free), self.size)
        self._is_free = is_free
        self._are_independent = False  # until that has been checked
        self._solver = BorderedSolver()

    def prescribe(self, bcs: Sequence[dolfinx.fem.DirichletBC], *, is_free: Mask) -> None:
        """Change the Dirichlet conditions. Collective.

        Args:
            bcs: The new conditions.
            is_free: Mask of the dofs without them, (N,).
        """
        for coupling in self._couplings:
            coupling.check(bcs)
        self._is_free = is_free
        self._are_independent = False  # until that has been checked for these conditions
        self._solver = BorderedSolver()  # the last one has springs for the other conditions

    def values(self) -> Array:
        """Return s, (m,)."""
        s = [values_of(equation.unknown) for equation in self._equations]
        return np.concatenate([np.zeros(0), *s])

    def set_values(self, s: Array) -> None:
        """Set s, (m,)."""
        first = 0
        for equation in self._equations:
            end = first + len(equation.equations)
            values = s[first:end]
            first = end
            equation.unknown.value = values.reshape(equation.unknown.ufl_shape)
            if equation.mirror is not None:
                equation.mirror.x.array[:] = values

    def residual(self) -> Array:
        """Return c(u, s), (m,). Collective."""
        return total_of(np.array([dolfinx.fem.assemble_scalar(c) for c in self._c]), self._comm)

    def linearise(self) -> None:
        """Assemble the border at the present state. Collective."""
        if self._border_forms is not None:
            self.border = self._border_forms.assemble(len(self._is_free))

    def solve(self, ksp: PETSc.KSP, A: PETSc.Mat, r: Array, c: Array) -> tuple[Array, Array]:
        """Solve for Δu and Δs with the present border. Collective.

        Args:
            ksp: A KSP with a FETI context.
            A: Torn matrix.
            r: Residual of u, (N,).
            c: Residuals of the equations, (m,).

        Returns:
            Δu, (N,), and Δs, (m,).
        """
        if not self.size:
            return solve_ksp(ksp, A, -r), np.zeros(0)
        return self._solver.solve(ksp, A, -r, self.border, -c)

    def correction(self, ksp: PETSc.KSP, r: Array, c: Array) -> tuple[Array, Array] | None:
        """Return approximate increments for residuals, without a solve. Collective.

        One application of the preconditioner takes the place of the solve. The border is that of
        the last :meth:`solve`.

        Args:
            ksp: A KSP with a FETI context.
            r: Residual of u, zero on Dirichlet dofs, (N,).
            c: Residuals of the equations, (m,).

        Returns:
            Δu, (N,), and Δs, (m,); None without a preconditioner or border, or if the border's
            matrix S was singular.
        """
        if self.size:
            return self._solver.correction(ksp, -r, -c)
        z = ksp.getPythonContext().correction(ksp, -r)
        return None if z is None else (z, np.zeros(0))

    def error_of_scalars(self, ds: Array, s: Array, u: Array) -> float:
        """Return η of a correction of the scalars, the largest |Δs_k| relative to s_k. Collective.

        See :meth:`BorderedSolver.error_of_scalars
        <dolfinx_feti.scalars.bordered.BorderedSolver.error_of_scalars>`.

        Args:
            ds: Δs, (m,).
            s: Largest size of s_k among the iterates, (m,).
            u: Largest size of u_j among the iterates, (N,).
        """
        return self._solver.error_of_scalars(ds, s, u)

    def scales(self, u: Array, h: Array | float) -> Array:
        r"""Return the scales of the equations, (m,). Collective.

        .. math:: \Bigl(\sum_j C_{jk}^2 (u_j^2 + h_j^2)\Bigr)^{1/2} + \sum_l |D_{kl} s_l|

        Args:
            u: Size of u at each dof, (N,).
            h: Size of the cells at each dof, (N,), if u is a displacement: the scales then do not
                vanish with u. Zero for any other u.
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

        The first call, and the first one after :meth:`prescribe`, also assembles the border.

        Raises:
            ValueError: They have none; on all processes.
        """
        for coupling in self._couplings:
            on_all(coupling.check_values, self._comm)
        if self.size and not self._are_independent:
            self.linearise()
            require_independent(self.border, self._is_free, self._comm)
            self._are_independent = True
