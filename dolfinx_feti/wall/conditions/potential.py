# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Potential of the pressures on a wall, :math:`-\sum p\, V(u)`.

V is the volume inside a surface under pressure (``mechanics.loads.enclosed_volume``). A surface
with open ends has no volume of its own. If its rims are clamped, V still has the right derivative.
If they slide in planes with the normal e, the volume between these planes has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.mechanics.loads import follower_pressure, pressure_potential
from dolfinx_feti.mechanics.trial_displacements import FORCE_RTOL, free_norm, trial_displacement
from dolfinx_feti.wall.conditions.condition import create_constant

__all__ = ["PressureLoad", "find_potential"]


@dataclass(frozen=True, slots=True)
class PressureLoad:
    """The pressure on one surface.

    Attributes:
        share: Share of the wall's pressure [-].
        ds: Measure of the surface.
    """

    share: dolfinx.fem.Constant
    ds: ufl.Measure


def find_potential(
    p: dolfinx.fem.Constant,
    u: dolfinx.fem.Function,
    loads: Sequence[PressureLoad],
    bcs: Sequence[dolfinx.fem.DirichletBC],
    *,
    prescribed: dolfinx.fem.Function,
    plane_axes: Sequence[int],
) -> ufl.Form | None:
    """Return the potential of the pressures on a wall [mN mm]. Collective.

    −p V is a potential if its derivative is the residual of the pressures in the free dofs. This
    is computed for one displacement; both are polynomials in u.

    Args:
        p: The wall's pressure [kPa].
        u: Displacement [mm].
        loads: The pressures.
        bcs: Dirichlet conditions, which determine the free dofs.
        prescribed: Displacement with values that ``bcs`` may prescribe [mm], for the test.
        plane_axes: Numbers of the axes normal to planes in which surfaces slide.

    Returns:
        The potential, an empty form without pressures; None if there is no potential.
    """
    if not loads:
        return ufl.Form([])
    normals: list[list[float] | None] = [None]  # of the planes between which V is enclosed
    for axis in sorted(set(plane_axes)):
        normals.append(np.eye(3)[axis].tolist())
    for normal in normals:
        if _is_potential(loads, normal, bcs, prescribed):
            return _potential(p, u, loads, normal)
    return None


def _potential(
    p: dolfinx.fem.Constant,
    u: dolfinx.fem.Function,
    loads: Sequence[PressureLoad],
    normal: Sequence[float] | None,
) -> ufl.Form:
    """Return −Σ p V(u) of all surfaces under pressure.

    Args:
        p: The wall's pressure.
        u: Displacement.
        loads: The pressures.
        normal: Normal of the planes between which V is enclosed; None if there are none.
    """
    potential = ufl.Form([])
    for load in loads:
        potential += pressure_potential(load.share * p, u, load.ds, normal)
    return potential


def _is_potential(
    loads: Sequence[PressureLoad],
    normal: Sequence[float] | None,
    bcs: Sequence[dolfinx.fem.DirichletBC],
    prescribed: dolfinx.fem.Function,
) -> bool:
    """Return True if the derivative of −p V is the residual of p in the free dofs. Collective.

    Args:
        loads: The pressures.
        normal: Normal of the planes between which V is enclosed; None if there are none.
        bcs: Dirichlet conditions.
        prescribed: Displacement whose values the constrained dofs have in the test.
    """
    V = prescribed.function_space
    w = trial_displacement(V)
    for bc in bcs:
        dofs, _ = bc.dof_indices()
        w.x.array[dofs] = prescribed.x.array[dofs]
    v = ufl.TestFunction(V)
    one = create_constant(V.mesh, 1.0)
    residual = ufl.Form([])
    for load in loads:
        residual += follower_pressure(load.share * one, w, v, load.ds)
    difference = ufl.derivative(_potential(one, w, loads, normal), w, v) - residual
    return free_norm(difference, bcs) <= FORCE_RTOL * free_norm(residual, bcs)
