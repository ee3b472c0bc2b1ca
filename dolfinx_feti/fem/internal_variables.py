# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Internal variables of a material, such as damage: Functions with an update in UFL.

.. math:: ξ_{n+1} = Ξ(u_{n+1}, p_{n+1}, ξ_n)

at the points of each Function's element. All Ξ are evaluated before any ξ changes.

A variable *affects the forces* if it is in the forms of the problem, or if the Ξ of such a variable
depends on it. Its update disturbs the equilibrium, so it is done when the next step begins. The
other variables, such as a largest stress, are only recorded. They are updated when a state is
accepted.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import dolfinx
import ufl
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.compat import interpolation_points

#: Internal variables that an update changes: all, those that affect the forces, or those that are
#: only recorded.
Updated: TypeAlias = Literal["all", "in_forces", "recorded"]


@dataclass(frozen=True, slots=True)
class InternalVariable:
    """An internal variable ξ.

    Attributes:
        function: ξ.
        update: Ξ, compiled at the points of the element of ξ.
        affects_forces: Whether ξ affects the forces.
    """

    function: dolfinx.fem.Function
    update: dolfinx.fem.Expression
    affects_forces: bool


@dataclass(frozen=True, slots=True)
class InternalVariables:
    """All internal variables of a problem, which are updated together."""

    variables: tuple[InternalVariable, ...]

    @property
    def functions(self) -> tuple[dolfinx.fem.Function, ...]:
        """The Functions ξ."""
        return tuple(variable.function for variable in self.variables)

    def update(self, which: Updated = "all") -> None:
        """Set ξ to Ξ at the present state. Collective.

        Args:
            which: ``"in_forces"`` for the variables that affect the forces, whose update disturbs
                the equilibrium, ``"recorded"`` for the others, or ``"all"``.

        Raises:
            ValueError: ``which`` is none of these.
        """
        if which not in get_args(Updated):
            raise ValueError(f"which={which!r}: choose 'all', 'in_forces' or 'recorded'.")
        new_values = {}
        for variable in self.variables:
            group = "in_forces" if variable.affects_forces else "recorded"
            if which in ("all", group):
                ξ = variable.function
                new_values[ξ] = dolfinx.fem.Function(ξ.function_space)
                new_values[ξ].interpolate(variable.update)
        for ξ, new in new_values.items():
            ξ.x.array[:] = new.x.array
            ξ.x.scatter_forward()


def create_internal_variables(
    updates: Mapping[dolfinx.fem.Function, Expr],
    compiler: Compiler,
    *,
    coefficients: Collection[dolfinx.fem.Function] = (),
) -> InternalVariables:
    """Check and compile updates. Collective.

    Args:
        updates: Update Ξ of each Function ξ, of the same shape.
        compiler: Compiler of the problem.
        coefficients: Coefficients of the forms of the problem.

    Raises:
        TypeError: A key is no Function.
        ValueError: Cells share dofs of a Function, or its update has another shape.
    """
    on_all(lambda: _check_updates(updates), compiler.comm)
    in_forces = _variables_in_forces(updates, coefficients)
    variables = []
    for ξ, update in updates.items():
        compiled = compiler.expression(update, interpolation_points(ξ.function_space))
        variables.append(InternalVariable(ξ, compiled, ξ in in_forces))
    return InternalVariables(tuple(variables))


def _variables_in_forces(
    updates: Mapping[dolfinx.fem.Function, Expr], coefficients: Collection[dolfinx.fem.Function]
) -> list[dolfinx.fem.Function]:
    """Return the variables among the coefficients, and all that their updates depend on."""
    variables = [ξ for ξ in updates if ξ in coefficients]
    for ξ in variables:  # the list grows during the loop
        dependencies = extract_coefficients(ufl.as_ufl(updates[ξ]))
        variables += [f for f in dependencies if f in updates and f not in variables]
    return variables


def _check_updates(updates: Mapping[dolfinx.fem.Function, Expr]) -> None:
    """Check that Functions are discontinuous, and that updates have their shapes.

    Raises:
        TypeError: A key is no Function.
        ValueError: Cells share dofs of a Function, or an update has another shape.
    """
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
