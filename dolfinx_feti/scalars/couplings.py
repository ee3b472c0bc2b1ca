# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The couplings of a problem, checked against each other and its conditions, or those of a case."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.scalars.cavity import Cavity
from dolfinx_feti.scalars.equations import Coupling
from dolfinx_feti.scalars.windkessel import Windkessel
from dolfinx_feti.wall.casefile import Filling
from dolfinx_feti.wall.wall import AXES, Wall, surface_measure

__all__ = ["checked_couplings", "create_cavities", "refuse_condensed_fields", "works"]


def checked_couplings(
    scalars: Sequence[Coupling],
    bcs: Sequence[dolfinx.fem.DirichletBC],
    V: dolfinx.fem.FunctionSpace,
) -> tuple[Coupling, ...]:
    """Return the couplings of a problem for an unknown in V, after what can be checked at once.

    None of them may act elsewhere or be without solution, no two cavities share facets. Collective;
    raises on all processes.
    """
    if not isinstance(scalars, Sequence):
        raise ValueError(f"scalars is {scalars!r} alone: put it in a list.")
    for i, coupling in enumerate(scalars):
        if not isinstance(coupling, Coupling):
            raise ValueError(
                f"scalars[{i}] is {coupling!r}: give a Cavity, Windkessel or ScalarEquation."
            )
        work = coupling.equation.work
        if work is not None and work.arguments()[0].ufl_function_space() != V:
            raise ValueError(f"scalars[{i}] acts on another space than that of the unknown u.")
        coupling.check(bcs)
    cavities = [c.cavity if isinstance(c, Windkessel) else c for c in scalars]
    for (i, one), (j, two) in itertools.combinations(enumerate(cavities), 2):
        if isinstance(one, Cavity) and isinstance(two, Cavity) and one.overlaps(two):
            raise ValueError(
                f"scalars[{i}] and scalars[{j}] are cavities on the same facets: give each facet "
                "to one of them."
            )
    return tuple(scalars)


def refuse_condensed_fields(
    couplings: Sequence[Coupling],
    fields: Sequence[dolfinx.fem.Function],
    residuals: Sequence[ufl.Form],
) -> None:
    """Require that scalars and condensed fields do not meet: a cell eliminates its fields alone."""
    for field, residual in zip(fields, residuals, strict=True):
        F_p = ufl.algorithms.expand_derivatives(residual)  # works of scalars have no derivative
        for i, equation in enumerate(coupling.equation for coupling in couplings):
            found = None
            if any(field in c.coefficients() for c in equation.equations):
                found = f"An equation of scalars[{i}] holds the condensed field {field.name}"
            elif equation.unknown in F_p.constants():
                found = f"The equation of the condensed field {field.name} holds scalars[{i}]"
            if found is not None:
                raise ValueError(
                    f"{found}, which each cell eliminates alone: state it in u, such as κ (J − 1) "
                    "for a pressure, or do not condense the field."
                )


def create_cavities(
    wall: Wall, u: dolfinx.fem.Function, cavities: Mapping[str, Filling]
) -> list[Cavity | Windkessel]:
    """Return the cavities and Windkessels of a case, in its order, for ``scalars=``. Collective.

    Args:
        wall: The wall.
        u: Its displacement [mm].
        cavities: What fills them, by the name of their surface.

    Raises:
        ValueError: The surface of one encloses no volume.
    """
    couplings: list[Cavity | Windkessel] = []
    for name, given in cavities.items():
        axis = None if given.axis is None else np.eye(3)[AXES.index(given.axis)]
        cavity = Cavity(u, surface_measure(wall)(wall.surfaces[name]), given.volume, axis=axis)
        couplings.append(Windkessel(cavity, **given.windkessel) if given.windkessel else cavity)
    return couplings


def works(couplings: Sequence[Coupling]) -> list[ufl.Form]:
    """Return what couplings add to the residual of u."""
    given = (coupling.equation.work for coupling in couplings)
    return [work for work in given if work is not None]
