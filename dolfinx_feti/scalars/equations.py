# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Scalar unknowns s with equations c(u, s) = 0 in UFL.

.. math:: r(u, s; v) = 0 \quad ∀ v, \qquad c_k(u, s) = 0, \quad k = 1, …, m

The unknowns are constants; for derivatives, they are replaced by UFL variables. Each c_k is a form
without arguments, a sum of integrals over cells and facets. A scalar on a real space (scifem) is
replaced by such a constant, and a residual tested in this space by one form for each component.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.mechanics.values import require_finite
from dolfinx_feti.runtime.arrays import Array

__all__ = [
    "Coupling",
    "ScalarEquation",
    "ScalarTangent",
    "constant_of",
    "derivative_in",
    "is_real",
    "mean_value",
    "rigid_motions",
    "separate_scalars",
    "unit_values",
    "values_of",
    "with_trial",
]


class Coupling:
    """Base class of scalar unknowns with equations: ScalarEquation, Cavity, Windkessel, ArcLength.

    Attributes:
        functions: Functions that :meth:`accept` changes.
    """

    functions: Sequence[dolfinx.fem.Function] = ()

    @property
    def equation(self) -> ScalarEquation:
        """The unknowns and their equations."""
        raise NotImplementedError

    def check(self, bcs: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Check that a solution with these conditions exists. Collective.

        Raises:
            ValueError: It does not; on all processes.
        """

    def check_values(self) -> None:
        """Check before each solve that a solution exists for the values of the constants.

        Raises:
            ValueError: It does not; on this process.
        """

    def begin_step(self, length: float) -> None:
        """Prepare a step of a path.

        Args:
            length: Length of the step, in the unit of the path: a load, or a time [s].
        """

    def accept(self) -> None:
        """Store the present state as the last one of a path. Collective."""


@dataclass(frozen=True, slots=True)
class ScalarTangent:
    """The user's own derivatives of a :class:`ScalarEquation`, in place of those that UFL derives.

    A zero block is None. ds is a trial function on the real space of the scalars s.

    Attributes:
        column: ∂r/∂s, bilinear in v and ds.
        rows: ∂c_k/∂u for each equation, linear in a test function of the space of u.
        blocks: ∂c_k/∂s for each constant s, a form for each equation, linear in the ds of s.
    """

    column: ufl.Form | None
    rows: tuple[ufl.Form | None, ...]
    blocks: Mapping[dolfinx.fem.Constant, tuple[ufl.Form | None, ...]]


@dataclass(frozen=True)
class ScalarEquation(Coupling):
    """Scalar unknowns and as many equations.

    Attributes:
        unknown: A constant, scalar or (m,), with the initial values and later the solution.
        equations: c_k, m forms without arguments.
        work: Part of the residual of u due to the unknowns, tested with v; None if the residual of
            the problem contains it already.
        mirror: A Function on a real space to which the values are copied.
        tangent: Its derivatives; derived by UFL if None.
    """

    unknown: dolfinx.fem.Constant
    equations: tuple[ufl.Form, ...]
    work: ufl.Form | None = None
    mirror: dolfinx.fem.Function | None = None
    tangent: ScalarTangent | None = None

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
    """Return the derivative of a form by constants, in a direction.

    Args:
        form: The form.
        parts: Pairs of a constant and the part of the direction for it, of the same shape.
    """
    if not parts:
        return ufl.Form([])
    s = {unknown: ufl.variable(unknown) for unknown, _ in parts}

    def by(integrand: Expr) -> Expr:
        """Return the derivative of an integrand."""
        return sum(ufl.inner(ufl.diff(integrand, s[unknown]), ds) for unknown, ds in parts)

    integrals = ufl.replace(form, s).integrals()
    return ufl.Form([i.reconstruct(integrand=by(i.integrand())) for i in integrals])


def values_of(constant: dolfinx.fem.Constant) -> Array:
    """Return the values of a constant, (m,)."""
    return np.array(constant.value, dtype=np.float64).reshape(-1)


def mean_value(
    u: dolfinx.fem.Function, value: float | Expr = 0.0, dx: ufl.Measure | None = None
) -> ScalarEquation:
    r"""Prescribe the mean ū of u, of each component, by a multiplier: ∫ (u − ū) dX = 0.

    Args:
        u: The unknown.
        value: Its mean, a number or an expression of the shape of u.
        dx: Measure of the part over which the mean is taken; the whole body if not given.

    Raises:
        ValueError: The value is not finite, or has another shape.
    """
    mesh = u.function_space.mesh
    n = u.ufl_shape
    dx = ufl.Measure("dx", mesh) if dx is None else dx
    require_finite(value=value)
    mean = ufl.as_ufl(value)
    if n and not mean.ufl_shape:
        mean = mean * ufl.as_vector([1.0] * n[0])
    if mean.ufl_shape != n:
        raise ValueError(f"value has the shape {mean.ufl_shape}: give a number or the shape {n}.")
    λ = dolfinx.fem.Constant(mesh, np.zeros(n))
    difference = u - mean
    components = [difference[i] for i in range(n[0])] if n else [difference]
    equations = tuple(component * dx for component in components)
    return ScalarEquation(λ, equations, ufl.inner(λ, ufl.TestFunction(u.function_space)) * dx)


def rigid_motions(u: dolfinx.fem.Function, dx: ufl.Measure | None = None) -> ScalarEquation:
    """Constrain the rigid motions of a displacement by a force and a moment spread over the body.

    The equations are ∫ u dX = 0 and ∫ X × u dX = 0, with three scalars in the plane and six in
    space. The scalars vanish if the loads balance each other. Then u is the solution orthogonal to
    the null space.

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
        """Return the components of w and of X × w."""
        return [*(w[i] for i in range(d)), *(x[i] * w[j] - x[j] * w[i] for i, j in pairs)]

    λ = dolfinx.fem.Constant(mesh, np.zeros(d + len(pairs)))
    work = ufl.inner(λ, ufl.as_vector(motions(ufl.TestFunction(u.function_space)))) * dx
    return ScalarEquation(λ, tuple(w * dx for w in motions(u)), work)


def separate_scalars(
    F: ufl.Form | Sequence[ufl.Form], blocks: Sequence[dolfinx.fem.Function]
) -> tuple[list[ufl.Form], dict[dolfinx.fem.Function, dolfinx.fem.Constant], list[ScalarEquation]]:
    """Separate the scalars on real spaces from a problem in blocks.

    Args:
        F: Residuals in the order of the unknowns, or a Lagrangian in all unknowns. Residuals tested
            in real spaces may be at any position; those of one real space are in the order of its
            scalars.
        blocks: The unknowns, some of them on real spaces.

    Returns:
        The other residuals, with constants in place of the scalars; the constant of each scalar;
        and the equations of the scalars.

    Raises:
        ValueError: The residuals do not fit the scalars.
    """
    scalars = [w for w in blocks if is_real(w.function_space)]
    if isinstance(F, ufl.Form):
        F = [ufl.derivative(F, w, ufl.TestFunction(w.function_space)) for w in blocks]
    constants = {s: constant_of(s) for s in scalars}
    forms = [ufl.replace(form, constants) for form in F]
    if any(len(form.arguments()) != 1 for form in forms):
        raise ValueError("F has a form without or with several test functions: give residuals.")
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
        V = s.function_space
        residuals = [form for form, W in zip(forms, tested, strict=True) if W == V]
        if len(residuals) != spaces.count(V):
            raise ValueError(
                f"F has {len(residuals)} residuals tested in the space of the scalar '{s.name}', "
                f"but {spaces.count(V)} scalars are on it: test that of each scalar in its space."
            )
        form = residuals[spaces[:i].count(V)]  # the k-th scalar on V has the k-th residual
        (test,) = form.arguments()
        c = tuple(ufl.replace(form, {test: e}) for e in unit_values(s.ufl_shape))
        equations.append(ScalarEquation(constant, c, mirror=s))
    return rest, constants, equations


def unit_values(shape: tuple[int, ...]) -> list[Expr]:
    """Return the unit vectors of a shape (m,), m of them; for a scalar, one."""
    if not shape:
        return [ufl.as_ufl(1.0)]
    return [ufl.unit_vector(k, shape[0]) for k in range(shape[0])]


def with_trial(form: ufl.Form, value: Expr) -> ufl.Form:
    """Return a form with a value in place of its trial function."""
    trial = next(v for v in form.arguments() if v.number() == 1)
    return ufl.replace(form, {trial: value})


def is_real(V: dolfinx.fem.FunctionSpace) -> bool:
    """Return True if a space has one number for each component, on all processes together.

    In a mesh of one cell, piecewise constants have one as well: no space counts as real there.
    """
    dofmap = V.dofmap
    cells = V.mesh.topology.index_map(V.mesh.topology.dim).size_global
    return cells > 1 and dofmap.index_map.size_global == 1 and dofmap.dof_layout.num_dofs == 1


def constant_of(s: dolfinx.fem.Function) -> dolfinx.fem.Constant:
    """Return a constant of the shape and with the values of a Function on a real space."""
    s.x.scatter_forward()
    return dolfinx.fem.Constant(s.function_space.mesh, np.reshape(s.x.array.copy(), s.ufl_shape))
