# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Springs and dashpots on a surface, for the tissue around a vessel, as energies in UFL.

The tissue around a wall exerts the traction −k w − η ẇ per reference area, where w is the
displacement u or its part along the outward normal N of the body, w = (u·N) N. In a time step
Δt from the last displacement u⁰ to u, by the implicit Euler method, ẇ = (w − w⁰)/Δt, and both
tractions have a potential::

    Π_spring  = ∫ k/2 w·w dA,        Π_dashpot = ∫ η/(2 Δt) (w − w⁰)·(w − w⁰) dA.

Add them to the internal energy. Source: P. Moireau et al., Biomech. Model. Mechanobiol. 11 (2012).
Units: k in kPa/mm, η in kPa s/mm, Δt in s, lengths in mm, per reference area. The direction is
``"normal"``, w = (u·N) N, or ``"all"``, w = u. Any other direction raises a ValueError, as does a
number that is negative or not finite.

Springs push and pull, and have no gap; ``dolfinx_feti.contact`` is for rigid tools that only push.
A new support is a function here, and its name in ``__all__``. For cases in TOML it is also a class
in ``wall.conditions.supports``, which ``wall.conditions.registry`` lists.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, get_args

import numpy as np

import dolfinx
import ufl
from ufl.core.expr import Expr

from dolfinx_feti.runtime.values import require_not_negative

__all__ = [
    "DashpotFactor",
    "Direction",
    "check_direction",
    "dashpot_energy",
    "dashpots_in",
    "spring_energy",
]

#: Part w of the displacement that is resisted: (u·N) N or u.
Direction = Literal["normal", "all"]


class DashpotFactor(dolfinx.fem.Constant):
    """The factor ½ in the potential of dashpots, with the parts of their rate (u − u⁰)/Δt.

    ``follow_load`` and ``follow_time`` advance the last displacement of all dashpots of a problem.
    A form of UFL has no place for such data, except in its constants: :func:`dashpots_in` returns
    the factors among the constants of forms. A dashpot that is written in UFL without this factor,
    or in which ``ufl.replace`` has replaced it, resists the motion, but no path advances u⁰.

    Attributes:
        u: Displacement, shape (d,).
        last: Displacement of the last time step, u⁰, shape (d,).
        time_step: Δt [s].
    """

    def __init__(self, u: Expr, last: Expr, time_step: float | Expr) -> None:
        """Create the factor; see the attributes. All parts are on one mesh."""
        super().__init__(ufl.domain.extract_unique_domain(u - last), np.float64(0.5))
        self.u = u
        self.last = last
        self.time_step = time_step


def dashpots_in(constants: Iterable[dolfinx.fem.Constant]) -> list[DashpotFactor]:
    """Return the factors of dashpots among the Constants of forms."""
    return [constant for constant in constants if isinstance(constant, DashpotFactor)]


def spring_energy(
    stiffness: float | Expr, u: Expr, ds: ufl.Measure, direction: Direction = "normal"
) -> ufl.Form:
    """Energy of springs between a surface and points at rest, ∫ k/2 w·w dA [mN mm].

    Args:
        stiffness: k, not negative [kPa/mm].
        u: Displacement, shape (d,).
        ds: Measure of the surface.
        direction: Part of the displacement that is resisted.

    Raises:
        ValueError: ``stiffness`` is negative or not finite, or the direction is another one.
    """
    require_not_negative(stiffness=stiffness)
    return stiffness / 2 * _square(u, direction) * ds


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
        viscosity: η, not negative [kPa s/mm].
        u: Displacement, shape (d,): the unknown, or an expression in it such as its sum with a
            known displacement. ``follow_time`` needs the unknown itself.
        last: Displacement of the last time step: a Function that no other form uses.
            ``follow_load`` and ``follow_time`` advance it. ``follow_time`` sets it such that ẇ is
            the velocity.
        time_step: Δt, positive [s]: a number, or a Constant, which ``follow_time`` sets. While it
            is infinite, η/Δt is zero and the dashpots have no effect.
        ds: Measure of the surface.
        direction: Part of the displacement that is resisted.

    Raises:
        ValueError: ``last`` is ``u`` itself, with which the energy is zero; or a number or the
            direction is out of its range.
    """
    require_not_negative(viscosity=viscosity)
    if not isinstance(time_step, Expr) and not time_step > 0.0:  # infinity is allowed
        raise ValueError(f"time_step = {time_step}: give a positive number of seconds.")
    check_direction(direction)
    if last is u:
        raise ValueError(
            "last is u itself: give another Function for the last displacement, "
            "last = dolfinx.fem.Function(u.function_space)."
        )
    square = _square(u - last, direction)
    return DashpotFactor(u, last, time_step) * viscosity / time_step * square * ds


def check_direction(direction: str) -> None:
    """Raise a ValueError if a direction of springs or dashpots is unknown."""
    if direction not in get_args(Direction):
        raise ValueError(f"direction = {direction!r}: choose 'normal' or 'all'.")


def _square(u: Expr, direction: Direction) -> Expr:
    """Return w·w of the resisted part w of a displacement, or of a difference of displacements.

    Raises:
        ValueError: The direction is unknown.
    """
    check_direction(direction)
    if direction == "all":
        return ufl.inner(u, u)
    return ufl.inner(u, ufl.FacetNormal(ufl.domain.extract_unique_domain(u))) ** 2
