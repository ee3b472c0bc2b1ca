# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Internal variables: what a material remembers, as Functions with an update in UFL.

.. math:: ξ_{n+1} = Ξ(u_{n+1}, p_{n+1}, ξ_n)

at the points of each Function's own element. All Ξ are evaluated before any ξ changes. Variables in
the balance of forces are those in the forms of the problem, and those that their Ξ depend on. The
others only observe: they may be updated while the balance still has to be shown.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import dolfinx
import ufl
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.compat import interpolation_points


@dataclass(frozen=True, slots=True)
class InternalVariables:
    """Internal variables ξ and their updates."""

    functions: tuple[dolfinx.fem.Function, ...]  # ξ, one Function each
    updates: tuple[dolfinx.fem.Expression, ...]  # Ξ, compiled at the points of their elements
    balanced: tuple[bool, ...]  # whether each is in the balance of forces

    def update(self, *, balanced: bool | None = None) -> None:
        """Let every ξ, or those that are ``balanced`` or not, be its Ξ now. Collective."""
        found = {}
        for ξ, update, in_balance in zip(self.functions, self.updates, self.balanced, strict=True):
            if balanced in (None, in_balance):
                found[ξ] = dolfinx.fem.Function(ξ.function_space)
                found[ξ].interpolate(update)
        for ξ, new in found.items():
            ξ.x.array[:] = new.x.array
            ξ.x.scatter_forward()


def create_internal_variables(
    updates: Mapping[dolfinx.fem.Function, Expr],
    compiler: Compiler,
    *,
    coefficients: Collection[dolfinx.fem.Function] = (),
) -> InternalVariables:
    """Check and compile the update Ξ, of ξ's shape, of each Function ξ. Collective.

    Those among the coefficients are in the balance of forces.

    Raises:
        TypeError: A key is no Function.
        ValueError: A Function has dofs that cells share, or its update has another shape.
    """
    on_all(lambda: _check(updates), compiler.comm)
    compiled = [
        compiler.expression(update, interpolation_points(ξ.function_space))
        for ξ, update in updates.items()
    ]
    reached = [ξ for ξ in updates if ξ in coefficients]
    for ξ in reached:  # grows on the way
        behind = extract_coefficients(ufl.as_ufl(updates[ξ]))
        reached += [other for other in behind if other in updates and other not in reached]
    return InternalVariables(tuple(updates), tuple(compiled), tuple(ξ in reached for ξ in updates))


def _check(updates: Mapping[dolfinx.fem.Function, Expr]) -> None:
    """Require discontinuous Functions, and updates of their shapes."""
    for ξ, update in updates.items():
        if not isinstance(ξ, dolfinx.fem.Function):
            raise TypeError(
                f"internal_variables has the key {ξ!r}: give a Function and its update for each, "
                "internal_variables={d: update}."
            )
        element = ξ.function_space.ufl_element()
        if not element.discontinuous and element.basix_sobolev_space.name != "L2":
            raise ValueError(
                f"The internal variable '{ξ.name}' has the element {element}, whose dofs cells "
                "share: take a quadrature element (basix.ufl.quadrature_element) or ('DG', k)."
            )
        if update.ufl_shape != ξ.ufl_shape:
            raise ValueError(
                f"The update of the internal variable '{ξ.name}' has the shape {update.ufl_shape}, "
                f"but '{ξ.name}' has {ξ.ufl_shape}: give an expression of that shape."
            )
