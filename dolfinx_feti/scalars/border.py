# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""What scalars add to Newton's system: their columns and rows, assembled, and its solution.

.. math:: K\, Δu + B\, Δs = -r, \quad C^⊤ Δu + D\, Δs = -c, \qquad
          B = ∂r/∂s, \quad C = ∂c/∂u, \quad D = ∂c/∂s

An equation is satisfied once \|c_k\| is small beside what a change of u and s by their own size, or
of u by that of a cell, makes of it: the equations have units of their own.
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import scipy.linalg

import dolfinx
import ufl

from dolfinx_feti.fem.assembly import assemble_owned
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.feti.bordered import Border, BorderedSolver, solved
from dolfinx_feti.runtime.arrays import Array, Mask
from dolfinx_feti.runtime.collective import on_all, total_of
from dolfinx_feti.scalars.equations import Coupling, derivative_in, values_of

__all__ = ["ScalarSystem"]


#: Share of its scale that an equation may miss.
MET = 1e-9

#: Sine of the angle between normalised constraints below which they depend on each other.
DEPENDENT = 1e-7

#: Share of the derivatives of an equation below which those by free dofs are rounding.
NOTHING = 1e-10


class ScalarSystem:
    """The scalars of a problem, perhaps none, and what they add to its system.

    Attributes:
        size: Their number m.
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
        """Compile the forms: r(u, s; v), with the work of the scalars, and their equations.

        ``free`` masks the owned dofs that no Dirichlet condition holds. Collective.
        """
        self._couplings, self._comm = couplings, compiler.comm
        self._hold(free)
        self._equations = [coupling.equation for coupling in couplings]
        c = [form for equation in self._equations for form in equation.equations]
        self.size, self._owned = len(c), len(free)
        self.border = self._zero()
        self.increment: Array = np.zeros(len(c))
        self._c = [compiler.form(form) for form in c]
        if not c:
            return
        self._direction = dolfinx.fem.Constant(u.function_space.mesh, np.zeros(len(c)))
        ds, parts = iter(self._direction), []
        for equation in self._equations:
            part = [next(ds) for _ in equation.equations]
            s = equation.unknown
            parts.append((s, ufl.as_vector(part) if s.ufl_shape else part[0]))

        def compiled(derivative: ufl.Form) -> dolfinx.fem.Form | None:
            zero = ufl.algorithms.expand_derivatives(derivative).empty()
            return None if zero else compiler.form(derivative)

        self._B = compiled(derivative_in(residual, parts))
        self._C = [compiled(ufl.derivative(form, u)) for form in c]
        self._D = [compiled(derivative_in(form, parts)) for form in c]

    def prescribe(self, bcs: Sequence[dolfinx.fem.DirichletBC], *, free: Mask) -> None:
        """Meet other Dirichlet conditions, which leave these dofs free, (owned,). Collective."""
        for coupling in self._couplings:
            coupling.check(bcs)
        self._hold(free)

    def _hold(self, free: Mask) -> None:
        """Begin with other free dofs: independence is to be checked, and springs to be found."""
        self._free, self._checked, self._solver = free, False, BorderedSolver()

    def values(self) -> Array:
        """Return s, (m,)."""
        s = [values_of(equation.unknown) for equation in self._equations]
        return np.concatenate([np.zeros(0), *s])

    def set_values(self, s: Array) -> None:
        """Set s, (m,)."""
        for equation in self._equations:
            own, s = np.split(s, [len(equation.equations)])
            equation.unknown.value = own.reshape(equation.unknown.ufl_shape)
            if equation.mirror is not None:
                equation.mirror.x.array[:] = own

    def residual(self) -> Array:
        """Return c(u, s), (m,). Collective."""
        return total_of(np.array([dolfinx.fem.assemble_scalar(c) for c in self._c]), self._comm)

    def linearise(self) -> None:
        """Assemble B, C and D at the present state. Collective."""
        border = self._zero()
        B, C, D = border.B, border.C, border.D
        for j, unit in enumerate(np.eye(self.size)):
            self._direction.value = unit
            if self._B is not None:
                B[:, j] = assemble_owned(self._B)
            if (form := self._C[j]) is not None:
                C[:, j] = assemble_owned(form)
            D[:, j] = [0.0 if f is None else dolfinx.fem.assemble_scalar(f) for f in self._D]
        self.border = Border(B, C, total_of(D, self._comm))

    def _zero(self) -> Border:
        """Return a border of zeros."""
        n, m = self._owned, self.size
        return Border(np.zeros((n, m)), np.zeros((n, m)), np.zeros((m, m)))

    def solve(self, ksp: PETSc.KSP, A: PETSc.Mat, r: Array, c: Array) -> Array:
        """Return Δu, (owned,), and keep Δs, by the present border. Collective."""
        if not self.size:
            return solved(ksp, A, -r)
        du, self.increment = self._solver.solve(ksp, A, -r, self.border, -c)
        return du

    def scales(self, u: Array, h: Array | float) -> Array:
        r"""Return what u of this size, (owned,), cells of size h and s make of the equations, (m,).

        .. math:: \Bigl(\sum_j C_{jk}^2 (u_j^2 + h_j^2)\Bigr)^{1/2} + \sum_l |D_{kl} s_l|

        h is that at each dof if u is a displacement. Collective.
        """
        squares = (self.border.C**2 * (u**2 + np.square(h))[:, None]).sum(axis=0)
        return np.sqrt(total_of(squares, self._comm)) + np.abs(self.border.D) @ np.abs(
            self.values()
        )

    def met(self, c: Array, u: Array, h: Array | float) -> bool:
        """Tell whether all equations hold, up to a share of their scales. Collective."""
        return bool(np.all(np.abs(c) <= MET * self.scales(u, h)))

    def push(self) -> Array:
        """Return B Δs, what their increment does to the equations of u, (owned,)."""
        return np.asarray(self.border.B @ self.increment)

    def force(self) -> Array:
        """Return B s, what the scalars do to the equations of u, (owned,)."""
        return np.asarray(self.border.B @ self.values())

    def begin(self, length: float) -> None:
        """Prepare a step of a path, of this length; on this process alone."""
        for coupling in self._couplings:
            coupling.begin(length)

    def accept(self) -> None:
        """Let the present state be the last one of a path. Collective."""
        for coupling in self._couplings:
            coupling.accept()

    @property
    def histories(self) -> list[dolfinx.fem.Function]:
        """Functions that :meth:`accept` changes; Constants are in the equations."""
        return [f for coupling in self._couplings for f in coupling.functions]

    def check(self) -> None:
        """Refuse values and constraints that no solution can meet, on all processes. Collective."""
        for coupling in self._couplings:
            on_all(coupling.check_values, self._comm)
        if self.size and not self._checked:
            self._check_independence(self._free)
            self._checked = True

    def _check_independence(self, free: Mask) -> None:
        """Refuse constraints that depend on each other or on nothing that is free. Collective."""
        self.linearise()
        for columns, corner, what in (
            (self.border.C, self.border.D.T, "equations"),
            (self.border.B, self.border.D, "unknowns"),
        ):
            whole = total_of((columns**2).sum(axis=0), self._comm)
            gram = total_of(columns[free].T @ columns[free], self._comm)
            size = np.sqrt(gram.diagonal())
            coupled = np.abs(corner).max(axis=0, initial=0.0) > 0.0
            idle = np.flatnonzero((size <= NOTHING * np.sqrt(whole)) & ~coupled)
            if len(idle):
                raise ValueError(
                    f"The scalar {what} {idle.tolist()} neither depend on a dof of u that is free, "
                    "nor on a scalar: no solve can meet them. Look at the Dirichlet conditions and "
                    "at the measures."
                )
            alone = np.flatnonzero(~coupled)
            if not len(alone):
                continue
            scaled = gram[np.ix_(alone, alone)] / np.outer(size[alone], size[alone])
            values, vectors = scipy.linalg.eigh(scaled)
            if values[0] < DEPENDENT**2:
                involved = alone[np.abs(vectors[:, 0]) > 1e-3]
                raise ValueError(
                    f"The scalar {what} {involved.tolist()} depend on each other, so that they "
                    "contradict each other or leave a multiplier free: leave one of them out."
                )
