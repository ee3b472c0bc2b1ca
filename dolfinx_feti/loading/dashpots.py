# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The last displacements of dashpots on a path of equilibria.

Dashpots resist the rate ẇ = (w − w⁰)/Δt, where w and w⁰ are u and its last value, ``last``, or
their normal parts. At the end of each step ``last`` becomes u. If u is the unknown, its values are
copied; if it is an expression, such as the sum of the unknown and a given displacement, it is
interpolated.
"""

from __future__ import annotations

from collections.abc import Iterable

import dolfinx

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.mechanics.supports import DashpotFactor, dashpots_in
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.compat import interpolation_points

__all__ = ["LastDisplacements"]


class LastDisplacements:
    """The last displacements of the dashpots in forms.

    Attributes:
        functions: The Functions that hold them, each once.
    """

    def __init__(self, constants: Iterable[dolfinx.fem.Constant], compiler: Compiler) -> None:
        """Find the dashpots in forms, and compile their displacements. Collective.

        Args:
            constants: Constants of the forms.
            compiler: Compiles displacements that are expressions.

        Raises:
            ValueError: A last displacement is not a Function, or belongs to two displacements.
        """
        dashpots = dashpots_in(constants)
        by_last = on_all(lambda: _by_last(dashpots), compiler.comm)
        self.functions = list(by_last)
        self._sources: list[dolfinx.fem.Function | dolfinx.fem.Expression] = []
        for last, dashpot in by_last.items():
            u = dashpot.u
            V = last.function_space
            if isinstance(u, dolfinx.fem.Function) and u.function_space == V:
                self._sources.append(u)
            else:
                self._sources.append(compiler.expression(u, interpolation_points(V)))

    def advance(self) -> None:
        """Set each last displacement to the present one, all at once. Collective.

        All present values are computed first: a displacement may contain another one's last value.
        """
        present = []
        for last, source in zip(self.functions, self._sources, strict=True):
            if isinstance(source, dolfinx.fem.Function):
                present.append(source.x.array.copy())
            else:
                interpolated = dolfinx.fem.Function(last.function_space)
                interpolated.interpolate(source)
                interpolated.x.scatter_forward()
                present.append(interpolated.x.array)
        for last, values in zip(self.functions, present, strict=True):
            last.x.array[:] = values


def _by_last(dashpots: Iterable[DashpotFactor]) -> dict[dolfinx.fem.Function, DashpotFactor]:
    """Return one dashpot of each last displacement.

    Raises:
        ValueError: A last displacement is not a Function, or belongs to two displacements.
    """
    by_last: dict[dolfinx.fem.Function, DashpotFactor] = {}
    for dashpot in dashpots:
        last = dashpot.last
        if not isinstance(last, dolfinx.fem.Function):
            raise ValueError(
                f"A dashpot has last={last}, which a path of loads cannot advance: give "
                "dashpot_energy a Function of its own for the last displacement."
            )
        other = by_last.setdefault(last, dashpot)
        is_same = bool(other.u == dashpot.u)  # expressions of UFL, compared by their structure
        if not is_same:
            raise ValueError(
                f"Two dashpots, of {other.u} and of {dashpot.u}, have one last displacement, "
                f"last={last}: give each a Function of its own."
            )
    return by_last
