# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pressure on the deformed wall, written on the reference surface by Nanson's formula.

With n da = cof(F) N dA the traction of a pressure p [kPa] is G₀ = −p cof(F) N (eq. 8,
Augustin_eq:Neumann). Forms are *internal minus external* virtual work (eq. 20,
Augustin_eq:WeakReference), to be **added**: u is the displacement [mm], (d,), v a test function, ds
the measure of the loaded reference surface, whose normal N points into the lumen. A p that is not
finite is a ValueError, zero an empty form. docs/theory.md says when a tangent is symmetric.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr
from ufl.core.multiindex import MultiIndex
from ufl.corealg.traversal import traverse_unique_terminals

from dolfinx_feti.mechanics.kinematics import deformation_gradient
from dolfinx_feti.mechanics.values import require_within, typed

__all__ = [
    "enclosed_volume",
    "follower_pressure",
    "follower_pressure_tangent",
    "mmhg",
    "pressure_potential",
]

#: What of a pressure's derivative is taken.
Kind = Literal["auto", "symmetric", "full", "none"]

_KPA_PER_MMHG = 101.325 / 760.0

#: How closely two forces agree that are one, relative to their norm.
SAME = 1e-9

#: Wave vectors of displacements without any symmetry, in the extent of the mesh; their size there.
WAVES = np.array(
    [
        [[5.1, 3.7, -4.3], [-2.9, 6.1, 3.3], [4.7, -3.1, 5.3]],
        [[3.3, -5.9, 4.1], [6.7, 2.3, -3.7], [-4.9, 5.3, 2.9]],
    ]
)
AMPLITUDE = 0.02


def mmhg(value: float) -> float:
    """Convert a finite pressure from millimetres of mercury to kPa, 1 mmHg = 0.1333223684 kPa."""
    require_within(-math.inf, math.inf, {"value": value}, remedy="a finite pressure in mmHg")
    return value * _KPA_PER_MMHG


def follower_pressure(p: float | Expr, u: Expr, v: Expr, ds: ufl.Measure) -> ufl.Form:
    """Residual of a pressure that follows the deformed surface.

    −δW_ext = ∫ p (J F⁻ᵀ N)·v dA. A p that is a dolfinx Constant can change from load step to load
    step without recompilation.
    """
    if _is_zero(p):
        return ufl.Form([])
    return p * ufl.inner(_area_vector(u), v) * ds


@typed
def follower_pressure_tangent(
    p: float | Expr,
    u: Expr,
    v: Expr,
    du: Expr,
    ds: ufl.Measure,
    kind: Kind = "auto",
    *,
    bcs: Sequence[dolfinx.fem.DirichletBC] | None = None,
) -> ufl.Form:
    """Derivative a(du, v) = ∫ p (D cof(F)[Grad du] N)·v dA of :func:`follower_pressure`, or a part.

    With a free rim, or one on springs, Newton's method takes several times as many steps with the
    symmetric part.

    Args:
        p: Pressure.
        u: Displacement, a Function.
        v: Test function.
        du: Trial function on the same space.
        ds: Measure of the surface.
        kind: ``"auto"``: ``"symmetric"`` if p is uniform and the surface is closed, or its rim
            clamped or sliding in planes, and ``"full"`` otherwise. Collective. ``"symmetric"``:
            ½ (a + aᵀ), for CG; ``"full"``: a itself, which needs GMRES; ``"none"``: an empty form
            as in the paper, at the price of many small load steps.
        bcs: Dirichlet conditions of the problem, ``[]`` for none, from which ``"auto"`` knows
            whether the rim is held. A closed surface needs none.

    Raises:
        ValueError: ``kind`` is none of these, or ``"auto"`` cannot tell, because ``bcs`` is
            missing, u is no Function, or ds has no facets.
    """
    if kind not in get_args(Kind):
        raise ValueError(f"kind = {kind!r}: choose 'auto', 'symmetric', 'full' or 'none'.")
    if kind == "none" or _is_zero(p):
        return ufl.Form([])
    if kind == "auto":
        kind = "symmetric" if _is_uniform(p) and _is_held(u, ds, bcs) else "full"
    a = ufl.derivative(follower_pressure(p, u, v, ds), u, du)
    return a if kind == "full" else 0.5 * (a + ufl.adjoint(a, (v, du)))


@typed
def enclosed_volume(u: Expr, ds: ufl.Measure, axis: Sequence[float] | None = None) -> ufl.Form:
    """Volume of the lumen inside a deformed surface, V = −1/d ∫ x·(J F⁻ᵀ N) dA with x = X + u.

    For an open surface the caps over the rims are missing; V still has the right derivative if
    rims are clamped, or slide in planes through the origin. With an ``axis`` e, (d,), x is replaced
    by its part normal to e, and d by d − 1: V is the volume between planes normal to e, in which
    rims may slide. An axis without length or of another shape is a ValueError.
    """
    d = len(u)
    x = ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(u)) + u
    if axis is not None:
        length = math.sqrt(sum(e * e for e in axis))
        if len(axis) != d or not (0 < length < math.inf):
            raise ValueError(f"axis = {axis}: expected {d} numbers, not all of them zero.")
        e = ufl.as_vector([float(component) / length for component in axis])
        x, d = x - ufl.dot(x, e) * e, d - 1
    return -ufl.dot(x, _area_vector(u)) / d * ds


def pressure_potential(
    p: float | Expr, u: Expr, ds: ufl.Measure, axis: Sequence[float] | None = None
) -> ufl.Form:
    """Potential −p V(u) of a uniform pressure, with rims held as :func:`enclosed_volume` requires.

    Otherwise, and for a p that varies over the surface, a follower pressure has no potential.
    """
    volume = enclosed_volume(u, ds, axis)
    return ufl.Form([]) if _is_zero(p) else -p * volume


def wave(V: dolfinx.fem.FunctionSpace, which: int = 0) -> dolfinx.fem.Function:
    """Return a displacement in which nothing is symmetric. Collective."""
    mesh, dim = V.mesh, V.mesh.geometry.dim
    x = np.asarray(mesh.geometry.x, dtype=np.float64)
    low = np.min(mesh.comm.allgather(x.min(axis=0, initial=np.inf)), axis=0)
    high = np.max(mesh.comm.allgather(x.max(axis=0, initial=-np.inf)), axis=0)
    length = float(np.linalg.norm(high - low))
    w, vectors = dolfinx.fem.Function(V), WAVES[which, :dim] / length
    w.interpolate(lambda x: AMPLITUDE * length * np.sin(vectors @ (x - low[:, None]) + 0.4))
    return w


def free_norm(form: ufl.Form, bcs: Sequence[dolfinx.fem.DirichletBC]) -> float:
    """Return the norm of a linear form in the dofs that no condition holds. Collective."""
    b = dolfinx.fem.assemble_vector(dolfinx.fem.form(form))
    b.scatter_reverse(dolfinx.la.InsertMode.add)
    owned = b.index_map.size_local * b.block_size
    for bc in bcs:
        bc.set(b.array, alpha=0.0)
    return float(np.sqrt(b.index_map.comm.allreduce(float(b.array[:owned] @ b.array[:owned]))))


def _area_vector(u: Expr) -> Expr:
    """Deformed area per reference area times the deformed normal, J F⁻ᵀ N."""
    domain = ufl.domain.extract_unique_domain(u)
    return ufl.cofac(deformation_gradient(u)) * ufl.FacetNormal(domain)


def _is_uniform(p: float | Expr) -> bool:
    """Tell whether p is made of numbers and constants alone."""
    if not isinstance(p, Expr):
        return True
    fixed = (ufl.Constant, ufl.constantvalue.ConstantValue, MultiIndex)
    return all(isinstance(part, fixed) for part in traverse_unique_terminals(p))


def _is_held(u: Expr, ds: ufl.Measure, bcs: Sequence[dolfinx.fem.DirichletBC] | None) -> bool:
    """Tell whether the tangent of a uniform pressure is symmetric in all free dofs. Collective.

    Its skew part is p ∮ (v × du)·dx along the rim; it is tried for one du (docs/theory.md).
    """
    if not isinstance(u, dolfinx.fem.Function):
        raise ValueError(
            f"u is {u!r}: kind='auto' tries displacements out and needs a dolfinx.fem.Function; "
            "give kind='symmetric' if the rim is held, kind='full' if it is free."
        )
    V = u.function_space
    elements = (V.ufl_element(), V.mesh.ufl_domain().ufl_coordinate_element())
    degree = max(element.embedded_superdegree for element in elements)
    exact = ds(metadata={"quadrature_degree": V.mesh.geometry.dim * degree})
    w, d = (wave(V, k) for k in (0, 1))
    for bc in bcs or ():
        bc.set(w.x.array)
        bc.set(d.x.array, alpha=0.0)
    v = ufl.TestFunction(V)
    force = follower_pressure(1.0, w, v, exact)
    a = ufl.derivative(force, w, d)  # a(d, v)
    a_T = ufl.derivative(follower_pressure(1.0, w, d, exact), w, v)  # a(v, d)
    skew, whole = (free_norm(form, bcs or ()) for form in (a - a_T, a))
    if whole == 0.0 and free_norm(force, ()) == 0.0:
        raise ValueError(
            "ds has no facets: give the measure the facet tags, ufl.Measure('ds', mesh, "
            "subdomain_data=tags), and a tag that is among them."
        )
    held = skew <= SAME * whole
    if bcs is None and not held:
        raise ValueError(
            "The surface under pressure has a rim, and kind='auto' does not know whether it is "
            "held: give bcs=, the Dirichlet conditions of the problem ([] for none), or "
            "kind='symmetric' if the rim is held, kind='full' if it is free."
        )
    return held


def _is_zero(p: float | Expr) -> bool:
    """Whether p is the number zero, which UFL would turn into a form without arguments."""
    if isinstance(p, Expr):
        return False
    require_within(-math.inf, math.inf, {"p": p}, remedy="a finite pressure or a UFL expression")
    return p == 0
