# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Scalar unknowns s with equations c(u, s) = 0, in UFL, and the ways to state them.

.. math:: r(u, s; v) = 0 \quad ∀ v, \qquad c_k(u, s) = 0, \quad k = 1, …, m

The unknowns are constants, which UFL differentiates by as variables; each c_k is a form without
arguments, a sum of integrals over cells and facets. Scalars on a real space, as scifem makes them,
become such constants, and a residual tested in it one form for each component.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.mechanics.values import require_finite
from dolfinx_feti.runtime.arrays import Array

__all__ = [
    "Coupling",
    "ScalarEquation",
    "derivative_in",
    "is_real",
    "mean_value",
    "rigid_motions",
    "separated",
    "values_of",
]


class Coupling:
    """What brings scalar unknowns along: an equation, or a cavity or a Windkessel that makes it.

    Attributes:
        functions: Functions that :meth:`accept` changes.
    """

    functions: Sequence[dolfinx.fem.Function] = ()

    @property
    def equation(self) -> ScalarEquation:
        """The unknowns and their equations."""
        raise NotImplementedError

    def check(self, bcs: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Refuse conditions that leave no solution, on all processes. Collective."""

    def check_values(self) -> None:
        """Refuse values that have no solution, before each solve."""

    def begin(self, length: float) -> None:
        """Prepare a step of a path, of this length in its load or time."""

    def accept(self) -> None:
        """Let the present state be the last one of a path. Collective."""


@dataclass(frozen=True)
class ScalarEquation(Coupling):
    """Scalar unknowns and as many equations.

    Attributes:
        unknown: A constant, scalar or (m,); it holds the start and then the solution.
        equations: c_k, m forms without arguments.
        work: What the unknowns add to the residual of u, tested with v; None if F has it.
        mirror: A Function on a real space that shows the values, too.
    """

    unknown: dolfinx.fem.Constant
    equations: tuple[ufl.Form, ...]
    work: ufl.Form | None = None
    mirror: dolfinx.fem.Function | None = None

    def __post_init__(self) -> None:
        """Check the numbers of unknowns, equations and arguments."""
        if not isinstance(self.unknown, dolfinx.fem.Constant):
            raise ValueError(f"unknown is {self.unknown!r}: give a Constant of the forms.")
        m = values_of(self.unknown).size
        if len(self.equations) != m or self.unknown.ufl_shape not in ((), (m,)):
            raise ValueError(
                f"The unknown has the shape {self.unknown.ufl_shape} and {len(self.equations)} "
                "equations: give a scalar constant and one, or a vector and one for each component."
            )
        ranks = [len(c.arguments()) if isinstance(c, ufl.Form) else None for c in self.equations]
        if any(ranks) or None in ranks:
            raise ValueError("The equations of scalars are forms without test or trial functions.")
        if self.work is not None and len(self.work.arguments()) != 1:
            raise ValueError("The work of scalars is a form with a test function of u alone.")

    @property
    def equation(self) -> ScalarEquation:
        """The equation itself."""
        return self


def derivative_in(form: ufl.Form, parts: Sequence[tuple[dolfinx.fem.Constant, Expr]]) -> ufl.Form:
    """Return the derivative of a form by constants, each in a direction of its own."""
    s = {unknown: ufl.variable(unknown) for unknown, _ in parts}

    def by(integrand: Expr) -> Expr:
        return sum(ufl.inner(ufl.diff(integrand, s[unknown]), ds) for unknown, ds in parts)

    integrals = ufl.replace(form, s).integrals()
    return ufl.Form([i.reconstruct(integrand=by(i.integrand())) for i in integrals])


def values_of(constant: dolfinx.fem.Constant) -> Array:
    """Return the values of a constant, (m,)."""
    return np.array(constant.value, dtype=np.float64).reshape(-1)


def mean_value(
    u: dolfinx.fem.Function, value: float | Expr = 0.0, dx: ufl.Measure | None = None
) -> ScalarEquation:
    r"""Hold the mean of u, of each component, by a multiplier: ∫ u − ū dX = 0.

    Args:
        u: The unknown.
        value: Its mean, a number or an expression of the shape of u.
        dx: Measure of the part over which the mean is taken; the whole body if not given.

    Raises:
        ValueError: The value is not finite, or has another shape.
    """
    mesh, n = u.function_space.mesh, u.ufl_shape
    dx = ufl.Measure("dx", mesh) if dx is None else dx
    require_finite(value=value)
    mean = ufl.as_ufl(value)
    if n and not mean.ufl_shape:
        mean = mean * ufl.as_vector([1.0] * n[0])
    if mean.ufl_shape != n:
        raise ValueError(f"value has the shape {mean.ufl_shape}: give a number or the shape {n}.")
    λ = dolfinx.fem.Constant(mesh, np.zeros(n))
    rest = u - mean
    equations = tuple(rest[i] * dx for i in range(n[0])) if n else (rest * dx,)
    return ScalarEquation(λ, equations, ufl.inner(λ, ufl.TestFunction(u.function_space)) * dx)


def rigid_motions(u: dolfinx.fem.Function, dx: ufl.Measure | None = None) -> ScalarEquation:
    """Hold the rigid motions of a displacement by a force and a moment, spread over the body.

    Three scalars in the plane, six in space: ∫ u dX = 0 and ∫ X × u dX = 0. They vanish where the
    loads balance each other: the solution is that with a null space.

    Args:
        u: The displacement.
        dx: Measure of one body among several; the whole mesh if not given.

    Raises:
        ValueError: u is no displacement of a body in the plane or in space.
    """
    mesh = u.function_space.mesh
    d = mesh.geometry.dim
    if u.ufl_shape != (d,) or d not in (2, 3):
        raise ValueError(f"u has the shape {u.ufl_shape}: give a displacement in {d} components.")
    x = ufl.SpatialCoordinate(mesh)
    pairs = [(0, 1)] if d == 2 else [(1, 2), (2, 0), (0, 1)]
    dx = ufl.Measure("dx", mesh) if dx is None else dx

    def motions(w: Expr) -> list[Expr]:
        return [*(w[i] for i in range(d)), *(x[i] * w[j] - x[j] * w[i] for i, j in pairs)]

    λ = dolfinx.fem.Constant(mesh, np.zeros(d + len(pairs)))
    work = ufl.inner(λ, ufl.as_vector(motions(ufl.TestFunction(u.function_space)))) * dx
    return ScalarEquation(λ, tuple(w * dx for w in motions(u)), work)


def separated(
    F: ufl.Form | Sequence[ufl.Form], u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function]
) -> tuple[ufl.Form | Sequence[ufl.Form], Any, list[ScalarEquation]]:
    """Take the scalars on real spaces out of a problem in blocks; leave another one alone.

    F are residuals tested with v and, for each s, in its real space, those of one space in the
    order of u; or a Lagrangian in u and s. Returns F in constants, the unknown, and the equations.
    """
    blocks = u if isinstance(u, Sequence) else []
    if not all(isinstance(w, dolfinx.fem.Function) for w in blocks):
        return F, u, []
    scalars = [w for w in blocks if is_real(w.function_space)]
    if not scalars:
        return F, u, []
    others = [w for w in blocks if not is_real(w.function_space)]
    if len(others) != 1:
        raise ValueError(
            f"u holds {len(others)} unknowns beside {len(scalars)} scalars on real spaces: give "
            "one, and condense discontinuous fields by condense=."
        )
    if isinstance(F, ufl.Form):
        F = [ufl.derivative(F, w, ufl.TestFunction(w.function_space)) for w in blocks]
    constants = {s: _constant(s) for s in scalars}
    forms = [ufl.replace(form, constants) for form in F]
    if any(len(form.arguments()) != 1 for form in forms):
        raise ValueError("F holds a form without a test function, or with more: give residuals.")
    spaces = [s.function_space for s in scalars]
    tested = [form.arguments()[0].ufl_function_space() for form in forms]
    rest = [form for form, V in zip(forms, tested, strict=True) if not is_real(V)]
    if len(forms) - len(rest) != len(scalars):
        raise ValueError(
            f"F has {len(forms) - len(rest)} residuals tested in real spaces for {len(scalars)} "
            "scalars: give one for each."
        )
    equations = []
    for i, (s, constant) in enumerate(constants.items()):
        V, n = s.function_space, s.ufl_shape
        own = [form for form, W in zip(forms, tested, strict=True) if W == V]
        if len(own) != spaces.count(V):
            raise ValueError(
                f"F has {len(own)} residuals tested in the space of the scalar '{s.name}', which "
                f"{spaces.count(V)} scalars are on: test that of each scalar in its own space."
            )
        form = own[spaces[:i].count(V)]
        (test,) = form.arguments()
        units = [ufl.unit_vector(i, n[0]) for i in range(n[0])] if n else [ufl.as_ufl(1.0)]
        c = tuple(ufl.replace(form, {test: e}) for e in units)
        equations.append(ScalarEquation(constant, c, mirror=s))
    return rest[0] if len(rest) == 1 else rest, others[0], equations


def is_real(V: dolfinx.fem.FunctionSpace) -> bool:
    """Tell whether a space holds one number for each component, on all processes."""
    dofmap = V.dofmap
    cells = V.mesh.topology.index_map(V.mesh.topology.dim).size_global
    return cells > 1 and dofmap.index_map.size_global == 1 and dofmap.dof_layout.num_dofs == 1


def _constant(s: dolfinx.fem.Function) -> dolfinx.fem.Constant:
    """Return a constant of the shape and with the values of a Function on a real space."""
    s.x.scatter_forward()
    return dolfinx.fem.Constant(s.function_space.mesh, np.reshape(s.x.array.copy(), s.ufl_shape))
