# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The Dirichlet conditions and forms of all conditions on a wall, and its axial prestretch.

A prestretch λ moves clamped and sliding surfaces by (λ − 1)(X·e − X₀) e along an axis e, a unit
vector, where X₀ is the smallest X·e of the wall. Units: mm, kPa, s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.mechanics.loads import TangentKind, follower_pressure, follower_pressure_tangent
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.values import require_finite, require_positive, require_type
from dolfinx_feti.wall.conditions.condition import (
    Condition,
    Contribution,
    SlidingPlane,
    Surface,
    WallState,
    create_constant,
)
from dolfinx_feti.wall.conditions.potential import PressureLoad, find_potential
from dolfinx_feti.wall.conditions.registry import Conditions, checked_conditions
from dolfinx_feti.wall.wall import AXES, Wall, extent, facets, require_surface

__all__ = ["Boundary", "Prestretch", "apply_conditions"]

#: Prestretch at which the potential of a pressure is tested. Rims that slide in a plane through the
#: origin pass the test without an axis, but fail it as soon as a prestretch moves the plane. Any
#: number far from 1 moves it enough.
TRIAL_STRETCH = 1.1


@dataclass(frozen=True, slots=True)
class Prestretch:
    """An axial prestretch of clamped and sliding surfaces.

    Attributes:
        axis: Number of the axis, 0 to 2.
        clamped: Prescribed displacement of clamped surfaces [mm].
        planes: Planes normal to the axis in which surfaces slide.
    """

    axis: int
    clamped: dolfinx.fem.Function
    planes: tuple[SlidingPlane, ...]

    def set(self, stretch: float) -> None:
        """Set the displacements to those of a stretch λ [-], 1 at rest. Collective."""
        V = self.clamped.function_space
        self.clamped.x.array[:] = axial_displacement(V, self.axis, stretch)
        start = _smallest_coordinate(V.mesh, self.axis)
        for plane in self.planes:
            plane.displacement.value = (stretch - 1.0) * (plane.coordinate - start)


@dataclass(frozen=True, slots=True)
class Boundary:
    """Dirichlet conditions and forms of all conditions on a wall.

    Attributes:
        bcs: Dirichlet conditions of clamped and sliding surfaces.
        residual: Virtual work of the conditions.
        tangent: Its derivative; symmetric if there is an ``energy``.
        energy: Potential [mN mm]; None if one of the conditions has none.
        pressure: The wall's pressure [kPa], zero at first; set its ``value``.
        time_step: Δt of the dashpots [s], infinite at first; set its ``value``, unless
            ``follow_time`` does.
        last: Displacement of the last time step [mm], zero at first. :meth:`advance`,
            ``follow_load`` and ``follow_time`` change it.
        clamped_displacement: Prescribed displacement of clamped surfaces [mm], zero at first.
            :meth:`set_stretch` changes it.
        prestretch: Surfaces that :meth:`set_stretch` moves; None without an axis.
    """

    bcs: list[dolfinx.fem.DirichletBC]
    residual: ufl.Form
    tangent: ufl.Form
    energy: ufl.Form | None
    pressure: dolfinx.fem.Constant
    time_step: dolfinx.fem.Constant
    last: dolfinx.fem.Function
    clamped_displacement: dolfinx.fem.Function
    prestretch: Prestretch | None

    def set_pressure(self, pressure: float) -> None:
        """Set the wall's pressure [kPa]; ``loads.mmhg(120.0)`` converts from mmHg.

        Raises:
            ValueError: The pressure is not finite.
        """
        require_finite(pressure=pressure)
        self.pressure.value = pressure

    def set_stretch(self, stretch: float) -> None:
        """Set the axial prestretch λ [-] of clamped and sliding surfaces; 1 at rest. Collective.

        Raises:
            ValueError: λ is not positive, or the conditions were applied without an axis.
        """
        if self.prestretch is None:
            raise ValueError("There is no axis to stretch along: give apply_conditions(axis=…).")
        require_positive(stretch=stretch)
        self.prestretch.set(stretch)

    def advance(self, u: dolfinx.fem.Function) -> None:
        """End a time step of the dashpots: u becomes ``last``.

        ``follow_load`` and ``follow_time`` do this themselves.
        """
        self.last.x.array[:] = u.x.array


def apply_conditions(
    wall: Wall, u: dolfinx.fem.Function, conditions: Conditions, *, axis: str | None = None
) -> Boundary:
    """Create the Dirichlet conditions and forms of conditions on surfaces. Collective.

    A pressure has a potential −p V if the derivative of this is the residual, which is checked
    numerically. If rims are free or on springs it has none, and the tangent is not symmetric
    (docs/conditions.md).

    Example::

        from dolfinx_feti.wall import Clamp, Pressure, Slide

        conditions = {"lumen": Pressure(), "opening_1": Clamp(), "opening_2": Slide()}
        boundary = apply_conditions(wall, u, conditions)
        problem = NonlinearProblem(psi * ufl.dx, u, boundary=boundary)
        boundary.set_pressure(0.2)  # kPa
        problem.solve()

    Args:
        wall: The wall.
        u: Displacement [mm], a Function in a Lagrange space on its mesh.
        conditions: One or several for each surface by name; other surfaces are free.
        axis: ``"x"``, ``"y"`` or ``"z"`` for a prestretch along it by :meth:`Boundary.set_stretch`.

    Raises:
        ValueError: u is no displacement of the wall, the wall has no such surface, one that is
            loaded or supported lies inside the wall, a clamp is not alone on its surface, a surface
            that slides lies in no plane normal to x, y or z, or the wall cannot be stretched along
            the axis. On all processes.
    """
    require_type(Wall, wall=wall)
    require_type(dolfinx.fem.Function, u=u)
    if u.ufl_shape != (3,) or u.function_space.mesh._cpp_object != wall.mesh._cpp_object:
        raise ValueError(
            f"u has the shape {u.ufl_shape}, or lives on another mesh: take a Function of "
            'functionspace(wall.mesh, ("Lagrange", 2, (3,))).'
        )
    V = u.function_space
    state = WallState(
        u=u,
        last=dolfinx.fem.Function(V, name="last_displacement"),
        clamped=dolfinx.fem.Function(V),
        pressure=create_constant(wall.mesh, 0.0),
        time_step=create_constant(wall.mesh, np.inf),
    )
    contributions, loads = _evaluate_conditions(checked_conditions(conditions), wall, state)
    bcs = [bc for contribution in contributions for bc in contribution.bcs]
    prestretch = None if axis is None else _create_prestretch(axis, contributions, state)
    potential = find_potential(
        state.pressure,
        u,
        loads,
        bcs,
        prescribed=_trial_prestretch(V, prestretch),
        plane_axes=[c.plane.axis for c in contributions if c.plane is not None],
    )
    without_pressure = _sum_forms(contributions, u)
    tangent_kind: TangentKind = "auto" if potential is None else "symmetric"
    pressures = _pressure_forms(loads, state, bcs, tangent_kind)
    energy = None
    if without_pressure.energy is not None and potential is not None:
        energy = without_pressure.energy + potential
    return Boundary(
        bcs=bcs,
        residual=without_pressure.residual + pressures.residual,
        tangent=without_pressure.tangent + pressures.tangent,
        energy=energy,
        pressure=state.pressure,
        time_step=state.time_step,
        last=state.last,
        clamped_displacement=state.clamped,
        prestretch=prestretch,
    )


@dataclass(frozen=True, slots=True)
class _Forms:
    """Forms of some conditions.

    Attributes:
        residual: Virtual work.
        tangent: Its derivative.
        energy: Potential; None if the residual has none, and for pressures, whose potential
            ``find_potential`` returns.
    """

    residual: ufl.Form
    tangent: ufl.Form
    energy: ufl.Form | None = None


def _evaluate_conditions(
    conditions: Mapping[str, Sequence[Condition]], wall: Wall, state: WallState
) -> tuple[list[Contribution], list[PressureLoad]]:
    """Return the contributions of all conditions, and the pressures among them. Collective.

    Args:
        conditions: Conditions of each surface by name.
        wall: The wall.
        state: Its displacement, pressure and time step.

    Raises:
        ValueError: The wall has no such surface, or it does not suit a condition.
    """
    contributions: list[Contribution] = []
    loads: list[PressureLoad] = []
    for name, on_surface in conditions.items():
        require_surface(wall, name)
        if any(condition.NEEDS_BOUNDARY for condition in on_surface):
            _check_on_boundary(wall, name)
        surface = Surface(wall, name, state)
        for condition in on_surface:
            contribution = condition.contribution(surface)
            contributions.append(contribution)
            if contribution.pressure_share is not None:
                loads.append(PressureLoad(contribution.pressure_share, surface.ds))
    return contributions, loads


def _sum_forms(contributions: Sequence[Contribution], u: dolfinx.fem.Function) -> _Forms:
    """Return the sum of the energies and residuals of contributions, without pressures.

    Args:
        contributions: Contributions of all conditions. :func:`_pressure_forms` has the forms of
            those with a share of the pressure.
        u: The displacement.
    """
    V = u.function_space
    energy = ufl.Form([])
    residual = ufl.Form([])
    for contribution in contributions:
        energy += contribution.energy
        residual += contribution.residual
    has_potential = residual.empty()
    if not energy.empty():
        residual += ufl.derivative(energy, u, ufl.TestFunction(V))
    tangent = ufl.Form([])
    if not residual.empty():
        tangent += ufl.derivative(residual, u, ufl.TrialFunction(V))
    return _Forms(residual, tangent, energy if has_potential else None)


def _pressure_forms(
    loads: Sequence[PressureLoad],
    state: WallState,
    bcs: Sequence[dolfinx.fem.DirichletBC],
    tangent_kind: TangentKind,
) -> _Forms:
    """Return the residual and the tangent of pressures. Collective.

    Args:
        loads: The pressures.
        state: Displacement and pressure of the wall.
        bcs: Dirichlet conditions.
        tangent_kind: Part of the tangent, see
            :func:`~dolfinx_feti.mechanics.loads.follower_pressure_tangent`.
    """
    u = state.u
    v = ufl.TestFunction(u.function_space)
    du = ufl.TrialFunction(u.function_space)
    residual = ufl.Form([])
    tangent = ufl.Form([])
    for load in loads:
        p = load.share * state.pressure
        residual += follower_pressure(p, u, v, load.ds)
        tangent += follower_pressure_tangent(p, u, v, du, load.ds, tangent_kind, bcs=bcs)
    return _Forms(residual, tangent)


def axial_displacement(V: dolfinx.fem.FunctionSpace, axis: int, stretch: float) -> Array:
    """Return the dofs of (λ − 1)(X·e − X₀) e on this process, ghosts included. Collective.

    Args:
        V: Space of the displacement, whose dofs are values at points.
        axis: Number of the axis e, 0 to 2.
        stretch: λ [-].

    Returns:
        The dofs [mm], (3 · nodes,).
    """
    X = V.tabulate_dof_coordinates()
    values = np.zeros(X.shape)
    values[:, axis] = (stretch - 1.0) * (X[:, axis] - _smallest_coordinate(V.mesh, axis))
    return values.ravel()


def _smallest_coordinate(mesh: dolfinx.mesh.Mesh, axis: int) -> float:
    """Return the smallest coordinate of a mesh on an axis, X₀ [mm]. Collective."""
    lower, _ = extent(mesh)
    return float(lower[axis])


def _create_prestretch(
    axis: str, contributions: Sequence[Contribution], state: WallState
) -> Prestretch:
    """Return the prestretch along an axis.

    Args:
        axis: ``"x"``, ``"y"`` or ``"z"``.
        contributions: Contributions of all conditions.
        state: The state of the wall, with the displacement of clamped surfaces.

    Raises:
        ValueError: The axis is unknown, or fewer than two surfaces can be moved along it.
    """
    if axis not in tuple(AXES):
        raise ValueError(f"axis={axis!r}: choose 'x', 'y' or 'z'.")
    number = AXES.index(axis)
    ends = [contribution for contribution in contributions if number in contribution.stretched_axes]
    if len(ends) < 2:
        raise ValueError(
            f"axis={axis!r}: a prestretch pulls at two ends, but fewer surfaces are clamped or "
            f"slide in a plane normal to {axis}: give both ends Clamp() or Slide()."
        )
    planes = tuple(contribution.plane for contribution in ends if contribution.plane is not None)
    return Prestretch(number, state.clamped, planes)


def _trial_prestretch(
    V: dolfinx.fem.FunctionSpace, prestretch: Prestretch | None
) -> dolfinx.fem.Function:
    """Return the displacement of a trial prestretch, or zero without one. Collective."""
    prescribed = dolfinx.fem.Function(V)
    if prestretch is not None:
        prescribed.x.array[:] = axial_displacement(V, prestretch.axis, TRIAL_STRETCH)
    return prescribed


def _check_on_boundary(wall: Wall, name: str) -> None:
    """Check that the facets of a surface are on the boundary, as ``ds`` contains no others.

    Raises:
        ValueError: Some are inside the wall. On all processes.

    Note:
        Collective.
    """
    topology = wall.mesh.topology
    topology.create_connectivity(2, 3)
    local = facets(wall, name)
    owned = local[local < topology.index_map(2).size_local]
    is_exterior = np.isin(owned, dolfinx.mesh.exterior_facet_indices(topology))
    inside = wall.mesh.comm.allreduce(int((~is_exterior).sum()))
    if inside:
        raise ValueError(
            f"The surface {name!r} has {inside} facets inside the wall, where no pressure, spring "
            "or other condition that is integrated over ds acts: name a surface of its boundary."
        )
