# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pressure on the deformed wall, written on the reference surface by Nanson's formula.

With n da = cof(F) N dA the traction of a pressure p [kPa] is G₀ = −p cof(F) N (eq. 8 of the paper;
the weak form is eq. 20). Forms are *internal minus external* virtual work: add them to those of the
material. In all functions

- u is the displacement [mm], (d,), v a test function and du a trial function on the same space,
- ds is the measure of the loaded reference surface, whose normal N points out of the wall, into the
  lumen,
- p is a number, a dolfinx Constant or an expression. A number that is not finite raises a
  ValueError. For the number zero the form is empty, because UFL would drop the test function.

docs/theory.md explains when a tangent is symmetric.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real
from typing import Literal, get_args

import dolfinx
import ufl
from ufl.core.expr import Expr
from ufl.core.multiindex import MultiIndex
from ufl.corealg.traversal import traverse_unique_terminals

from dolfinx_feti.mechanics.kinematics import deformation_gradient
from dolfinx_feti.mechanics.trial_displacements import FORCE_RTOL, free_norm, trial_displacement
from dolfinx_feti.runtime.values import require_sequence, require_within

__all__ = [
    "enclosed_volume",
    "follower_pressure",
    "follower_pressure_tangent",
    "mmhg",
    "pressure_potential",
]

#: Parts of the tangent of a pressure, see :func:`follower_pressure_tangent`.
TangentKind = Literal["auto", "symmetric", "full", "none"]

#: One millimetre of mercury in kPa: an atmosphere is 101.325 kPa or 760 mmHg, by definition.
_KPA_PER_MMHG = 101.325 / 760.0


def mmhg(value: float) -> float:
    """Convert a finite pressure from millimetres of mercury to kPa, 1 mmHg = 0.1333223684 kPa."""
    require_within(-math.inf, math.inf, {"value": value}, remedy="a finite pressure in mmHg")
    return value * _KPA_PER_MMHG


def follower_pressure(p: float | Expr, u: Expr, v: Expr, ds: ufl.Measure) -> ufl.Form:
    """Residual of a pressure that follows the deformed surface, −δW_ext = ∫ p (J F⁻ᵀ N)·v dA.

    Args:
        p: Pressure [kPa]. A dolfinx Constant can change from load step to load step without
            recompilation.
        u: Displacement [mm], (d,).
        v: Test function on the same space.
        ds: Measure of the surface.

    Raises:
        ValueError: ``p`` is not finite.
    """
    _check_pressure(p)
    if _is_zero(p):
        return ufl.Form([])
    return p * ufl.inner(_area_vector(u), v) * ds


def follower_pressure_tangent(
    p: float | Expr,
    u: Expr,
    v: Expr,
    du: Expr,
    ds: ufl.Measure,
    kind: TangentKind = "auto",
    *,
    bcs: Sequence[dolfinx.fem.DirichletBC] | None = None,
) -> ufl.Form:
    """Derivative a(du, v) = ∫ p (D cof(F)[Grad du] N)·v dA of :func:`follower_pressure`, or a part.

    Collective if ``kind`` is ``"auto"``. The parts are

    - ``"full"``: a itself, which needs GMRES if it is not symmetric,
    - ``"symmetric"``: ½ (a + aᵀ), for CG. If a rim is free or on springs, Newton's method takes
      several times as many steps with it,
    - ``"none"``: an empty form, as in the paper. It needs many small load steps,
    - ``"auto"``: ``"symmetric"`` if p is uniform and the surface is closed, or its rim is clamped
      or slides in planes; ``"full"`` otherwise.

    Args:
        p: Pressure [kPa].
        u: Displacement [mm], (d,), a Function.
        v: Test function on the same space.
        du: Trial function on the same space.
        ds: Measure of the surface.
        kind: ``"auto"``, ``"symmetric"``, ``"full"`` or ``"none"``, see above.
        bcs: Dirichlet conditions of the problem for ``"auto"``, ``[]`` for none. They determine
            whether the rim is clamped. A closed surface needs none.

    Raises:
        ValueError: ``p`` is not finite, ``kind`` is none of these, or ``"auto"`` is not possible
            because ``bcs`` is missing, u is no Function, or ds has no facets.
    """
    if kind not in get_args(TangentKind):
        raise ValueError(f"kind = {kind!r}: choose 'auto', 'symmetric', 'full' or 'none'.")
    _check_pressure(p)
    if kind == "none" or _is_zero(p):
        return ufl.Form([])
    if kind == "auto":
        is_symmetric = _is_uniform(p) and _is_symmetric(u, ds, bcs)
        kind = "symmetric" if is_symmetric else "full"
    a = ufl.derivative(follower_pressure(p, u, v, ds), u, du)
    return a if kind == "full" else 0.5 * (a + ufl.adjoint(a, (v, du)))


def enclosed_volume(u: Expr, ds: ufl.Measure, axis: Sequence[float] | None = None) -> ufl.Form:
    """Volume of the lumen inside a deformed surface, V = −1/d ∫ x·(J F⁻ᵀ N) dA with x = X + u.

    For an open surface the caps over the rims are missing; V still has the right derivative if
    rims are clamped, or slide in planes through the origin. With an ``axis`` e, x is replaced by
    its part normal to e, and d by d − 1: V is the volume between planes normal to e, in which rims
    may slide.

    Args:
        u: Displacement [mm], (d,).
        ds: Measure of the surface.
        axis: Direction e, (d,), of any length but zero.

    Raises:
        TypeError: ``axis`` is no sequence of numbers.
        ValueError: ``axis`` has no length, or another shape.
    """
    if axis is not None:
        require_sequence(Real, axis=axis)
    d = len(u)
    x = ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(u)) + u
    if axis is not None:
        length = math.sqrt(sum(e * e for e in axis))
        if len(axis) != d or not (0 < length < math.inf):
            raise ValueError(f"axis = {axis}: expected {d} numbers, not all of them zero.")
        e = ufl.as_vector([float(component) / length for component in axis])
        x = x - ufl.dot(x, e) * e
        d = d - 1
    return -ufl.dot(x, _area_vector(u)) / d * ds


def pressure_potential(
    p: float | Expr, u: Expr, ds: ufl.Measure, axis: Sequence[float] | None = None
) -> ufl.Form:
    """Potential −p V(u) of a uniform pressure [mN mm], see :func:`enclosed_volume`.

    A follower pressure has no potential if p varies over the surface, or if a rim moves otherwise
    than :func:`enclosed_volume` requires.

    Args:
        p: Pressure [kPa].
        u: Displacement [mm], (d,).
        ds: Measure of the surface.
        axis: Direction normal to the planes in which rims slide, (d,).

    Raises:
        TypeError: ``axis`` is no sequence of numbers.
        ValueError: ``p`` is not finite, or ``axis`` has no length or another shape.
    """
    _check_pressure(p)
    volume = enclosed_volume(u, ds, axis)  # also for p = 0: it checks the axis
    if _is_zero(p):
        return ufl.Form([])
    return -p * volume


def _area_vector(u: Expr) -> Expr:
    """Deformed area per reference area times the deformed normal, J F⁻ᵀ N."""
    domain = ufl.domain.extract_unique_domain(u)
    return ufl.cofac(deformation_gradient(u)) * ufl.FacetNormal(domain)


def _is_uniform(p: float | Expr) -> bool:
    """Return True if p has one value everywhere: it consists of numbers and constants alone."""
    if not isinstance(p, Expr):
        return True
    uniform = (ufl.Constant, ufl.constantvalue.ConstantValue, MultiIndex)
    return all(isinstance(part, uniform) for part in traverse_unique_terminals(p))


def _is_symmetric(u: Expr, ds: ufl.Measure, bcs: Sequence[dolfinx.fem.DirichletBC] | None) -> bool:
    """Return True if the tangent of a uniform pressure is symmetric in all free dofs. Collective.

    Its skew part is p ∮ (v × du)·dx along the rim. It is assembled for p = 1, a displacement w and
    an increment du that have no symmetry and meet the conditions (docs/theory.md). The result does
    not depend on the values of u.

    Raises:
        ValueError: u is no Function, ds has no facets, or there is a rim and ``bcs`` is None.
    """
    if not isinstance(u, dolfinx.fem.Function):
        raise ValueError(
            f"u is {u!r}: kind='auto' assembles the tangent for trial displacements and needs a "
            "dolfinx.fem.Function; give kind='symmetric' if the rim is clamped, kind='full' if it "
            "is free."
        )
    V = u.function_space
    exact_ds = _exact_measure(ds, V)
    w = trial_displacement(V, 0)
    du = trial_displacement(V, 1)
    for bc in bcs or ():
        bc.set(w.x.array)
        bc.set(du.x.array, alpha=0.0)
    v = ufl.TestFunction(V)
    force = follower_pressure(1.0, w, v, exact_ds)
    a = ufl.derivative(force, w, du)  # a(du, v)
    a_T = ufl.derivative(follower_pressure(1.0, w, du, exact_ds), w, v)  # a(v, du)
    skew_norm = free_norm(a - a_T, bcs or ())
    norm = free_norm(a, bcs or ())
    if norm == 0.0 and free_norm(force, ()) == 0.0:
        raise ValueError(
            "ds has no facets: give the measure the facet tags, ufl.Measure('ds', mesh, "
            "subdomain_data=tags), and a tag that is among them."
        )
    is_symmetric = skew_norm <= FORCE_RTOL * norm
    if bcs is None and not is_symmetric:
        raise ValueError(
            "The surface under pressure has a rim, and kind='auto' needs to know whether it is "
            "clamped: give bcs=, the Dirichlet conditions of the problem ([] for none), or "
            "kind='symmetric' if the rim is clamped, kind='full' if it is free."
        )
    return is_symmetric


def _exact_measure(ds: ufl.Measure, V: dolfinx.fem.FunctionSpace) -> ufl.Measure:
    """Return the measure of a surface with a degree that is exact for pressures on straight facets.

    The integrand cof(F) N · v is a product of gdim fields with at most the degree of V or of the
    geometry.
    """
    elements = (V.ufl_element(), V.mesh.ufl_domain().ufl_coordinate_element())
    degree = max(element.embedded_superdegree for element in elements)
    return ds(metadata={"quadrature_degree": V.mesh.geometry.dim * degree})


def _is_zero(p: float | Expr) -> bool:
    """Return True if p is the number zero, with which UFL drops the test function."""
    return not isinstance(p, Expr) and p == 0


def _check_pressure(p: float | Expr) -> None:
    """Check a pressure.

    Raises:
        ValueError: p is a number that is not finite.
    """
    if isinstance(p, Expr):
        return
    require_within(-math.inf, math.inf, {"p": p}, remedy="a finite pressure or a UFL expression")
