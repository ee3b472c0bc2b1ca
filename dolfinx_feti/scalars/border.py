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
from dataclasses import dataclass

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
from dolfinx_feti.scalars.equations import (
    Coupling,
    ScalarEquation,
    derivative_in,
    none_if_zero,
    values_of,
)

__all__ = ["ScalarSystem"]


#: Share of its scale that an equation may miss.
MET = 1e-9

#: Sine of the angle between normalised constraints below which they depend on each other.
DEPENDENT = 1e-7

#: Share of the derivatives of an equation below which those by free dofs are rounding.
NOTHING = 1e-10


@dataclass(frozen=True, slots=True)
class _Block:
    """The compiled forms of an equation, and where its unknowns stand."""

    equation: ScalarEquation
    rows: slice
    direction: dolfinx.fem.Constant
    c: list[dolfinx.fem.Form]
    C: list[dolfinx.fem.Form | None]
    B: dolfinx.fem.Form | None


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
        v = ufl.TestFunction(u.function_space)

        def compiled(form: ufl.Form | None) -> dolfinx.fem.Form | None:
            return None if form is None else compiler.form(form)

        blocks, first = [], 0
        for equation in (coupling.equation for coupling in couplings):
            m = len(equation.equations)
            zero = np.zeros_like(equation.unknown.value)
            direction = dolfinx.fem.Constant(u.function_space.mesh, zero)
            blocks.append(
                _Block(
                    equation,
                    slice(first, first + m),
                    direction,
                    [compiler.form(c) for c in equation.equations],
                    [compiled(none_if_zero(ufl.derivative(c, u, v))) for c in equation.equations],
                    compiled(derivative_in(residual, equation.unknown, direction)),
                )
            )
            first += m
        self.size, self._blocks = first, blocks
        rows = [(row, k, c) for row in blocks for k, c in enumerate(row.equation.equations)]
        self._D = [
            (row.rows.start + k, block, compiler.form(form))
            for row, k, c in rows
            for block in blocks
            if (form := derivative_in(c, block.equation.unknown, block.direction)) is not None
        ]
        V = u.function_space
        self._owned = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
        self.border = self._zero()
        self.increment: Array = np.zeros(first)

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
        s = [values_of(block.equation.unknown) for block in self._blocks]
        return np.concatenate([np.zeros(0), *s])

    def set_values(self, s: Array) -> None:
        """Set s, (m,)."""
        for block in self._blocks:
            unknown, mirror = block.equation.unknown, block.equation.mirror
            unknown.value = s[block.rows].reshape(unknown.ufl_shape)
            if mirror is not None:
                mirror.x.array[:] = s[block.rows]

    def residual(self) -> Array:
        """Return c(u, s), (m,). Collective."""
        c = [dolfinx.fem.assemble_scalar(c) for block in self._blocks for c in block.c]
        return total_of(np.array(c), self._comm)

    def linearise(self) -> None:
        """Assemble B, C and D at the present state. Collective."""
        border = self._zero()
        B, C, D = border.B, border.C, border.D
        for block in self._blocks:
            for k, j in enumerate(range(block.rows.start, block.rows.stop)):
                unit = np.eye(block.direction.value.size)[k]
                block.direction.value = unit.reshape(block.direction.ufl_shape)
                if block.B is not None:
                    B[:, j] = assemble_owned(block.B)
                form = block.C[k]
                if form is not None:
                    C[:, j] = assemble_owned(form)
                for row, other, entry in self._D:
                    if other is block:
                        D[row, j] += dolfinx.fem.assemble_scalar(entry)
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
