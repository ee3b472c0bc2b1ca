# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The couplings of a problem together: their checks, and their works in the residual of u."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import dolfinx
import ufl

from dolfinx_feti.scalars.cavity import Cavity
from dolfinx_feti.scalars.equations import Coupling
from dolfinx_feti.scalars.windkessel import Windkessel

__all__ = ["check_couplings", "coupling_works", "refuse_condensed_fields"]


def check_couplings(
    scalars: Sequence[Coupling],
    bcs: Sequence[dolfinx.fem.DirichletBC],
    V: dolfinx.fem.FunctionSpace,
) -> tuple[Coupling, ...]:
    """Check the couplings of a problem, with its conditions and among each other. Collective.

    A new kind of coupling with a cavity has to be added to ``cavities`` below.

    Args:
        scalars: The couplings.
        bcs: Dirichlet conditions of the problem.
        V: Space of its unknown.

    Returns:
        The couplings.

    Raises:
        ValueError: One of them is no coupling, acts on another space, or has no solution, or two
            cavities share facets. On all processes.
    """
    if not isinstance(scalars, Sequence):
        raise ValueError(f"scalars is {scalars!r} alone: put it in a list.")
    for i, coupling in enumerate(scalars):
        if not isinstance(coupling, Coupling):
            raise ValueError(
                f"scalars[{i}] is {coupling!r}: give a Cavity, Windkessel, ArcLength or "
                "ScalarEquation."
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
    """Check that no equation contains both a scalar and a condensed field.

    Condensed fields are eliminated cell by cell, where a scalar is no unknown.

    Args:
        couplings: The couplings.
        fields: The condensed fields.
        residuals: The equations of the fields, in the same order.

    Raises:
        ValueError: An equation contains both.
    """
    for field, residual in zip(fields, residuals, strict=True):
        # Expanded, because a residual that is the derivative of an energy by the field contains the
        # terms with scalars as unevaluated derivatives, which are zero.
        F_p = ufl.algorithms.expand_derivatives(residual)
        for i, coupling in enumerate(couplings):
            equation = coupling.equation
            cause = None
            if any(field in c.coefficients() for c in equation.equations):
                cause = f"An equation of scalars[{i}] contains the condensed field {field.name}"
            elif equation.unknown in F_p.constants():
                cause = f"The equation of the condensed field {field.name} contains scalars[{i}]"
            if cause is not None:
                raise ValueError(
                    f"{cause}, but such fields are eliminated in each cell alone: write it in u, "
                    "such as κ (J − 1) for a pressure, or do not condense the field."
                )


def coupling_works(couplings: Sequence[Coupling]) -> list[ufl.Form]:
    """Return the works of couplings, which are part of the residual of u."""
    all_works = (coupling.equation.work for coupling in couplings)
    return [work for work in all_works if work is not None]
