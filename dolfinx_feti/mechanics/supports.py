# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Springs and dashpots on a surface, for the tissue around a vessel, as energies in UFL.

The tissue around a wall answers with the traction −k w − η ẇ per reference area, where w is the
displacement u or its part along the normal N of the reference surface, w = (u·N) N. In a time step
Δt from the last displacement u⁰ to u, by the implicit Euler method, ẇ = (w − w⁰)/Δt, and both
tractions have a potential::

    Π_spring  = ∫ k/2 w·w dA,        Π_dashpot = ∫ η/(2 Δt) (w − w⁰)·(w − w⁰) dA.

They are to be **added** to the internal energy. Source: P. Moireau et al., Biomech. Model.
Mechanobiol. 11 (2012). Units: k in kPa/mm, η in kPa s/mm, Δt in s, lengths in mm, per reference
area. A number that is negative or not finite is a ValueError, and so is another direction than
``"normal"``, w = (u·N) N, or ``"all"``, w = u.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args
from weakref import WeakKeyDictionary

import ufl
from ufl.core.expr import Expr

from dolfinx_feti.mechanics.values import require_not_negative, typed

__all__ = ["DASHPOTS", "Dashpots", "Direction", "dashpot_energy", "spring_energy"]


@dataclass(frozen=True, slots=True)
class Dashpots:
    """What ẇ = (w − w⁰)/Δt of dashpots is made of."""

    u: Expr  #: Displacement
    time_step: float | Expr  #: Δt [s]


#: By their last displacement u⁰, those that a path of loads or times advances.
DASHPOTS: WeakKeyDictionary[Expr, list[Dashpots]] = WeakKeyDictionary()

#: Which part of the displacement is resisted.
Direction = Literal["normal", "all"]


def spring_energy(
    stiffness: float | Expr, u: Expr, ds: ufl.Measure, direction: Direction = "normal"
) -> ufl.Form:
    """Energy of springs between a surface and a place at rest, ∫ k/2 w·w dA [mN mm]."""
    require_not_negative(stiffness=stiffness)
    return stiffness / 2 * _square(u, direction) * ds


@typed
def dashpot_energy(
    viscosity: float | Expr,
    u: Expr,
    last: Expr,
    time_step: float | Expr,
    ds: ufl.Measure,
    direction: Direction = "normal",
) -> ufl.Form:
    """Incremental potential of dashpots, ∫ η/(2 Δt) (w − w⁰)·(w − w⁰) dA [mN mm].

    Args:
        viscosity: η.
        u: Displacement, shape (d,).
        last: That of the last time step, a Function of its own, which ``follow_load`` and
            ``follow_time`` advance; with inertia so that ẇ is the velocity.
        time_step: Δt, positive; a Constant of infinity leaves the dashpots without effect.
            ``follow_time`` sets it.
        ds: Measure of the surface.
        direction: Which part of the displacement is resisted.
    """
    require_not_negative(viscosity=viscosity)
    if not isinstance(time_step, Expr) and not time_step > 0.0:
        raise ValueError(f"time_step = {time_step}: give a positive number of seconds.")
    DASHPOTS.setdefault(last, []).append(Dashpots(u, time_step))
    return viscosity / (2 * time_step) * _square(u - last, direction) * ds


def _square(u: Expr, direction: Direction) -> Expr:
    """w·w of the resisted part w of a displacement."""
    if direction not in get_args(Direction):
        raise ValueError(f"direction = {direction!r}: choose 'normal' or 'all'.")
    if direction == "all":
        return ufl.inner(u, u)
    return ufl.inner(u, ufl.FacetNormal(ufl.domain.extract_unique_domain(u))) ** 2
