# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Internal variables: what a material remembers, as Functions with an update in UFL.

.. math:: ξ_{n+1} = Ξ(u_{n+1}, p_{n+1}, ξ_n)

at the points of each Function's own element: those of the quadrature, or of a discontinuous
polynomial. All Ξ are evaluated before any ξ changes, so that updates may refer to each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mpi4py import MPI

import dolfinx
from ufl.core.expr import Expr

from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.runtime.collective import on_all
from dolfinx_feti.runtime.compat import interpolation_points

__all__ = ["InternalVariables", "create_internal_variables"]


@dataclass(frozen=True, slots=True)
class InternalVariables:
    """Internal variables ξ and their updates.

    Attributes:
        functions: ξ, one Function each.
        updates: Ξ, compiled at the points of their elements.
    """

    functions: tuple[dolfinx.fem.Function, ...]
    updates: tuple[dolfinx.fem.Expression, ...]

    def update(self) -> None:
        """Let every ξ be its Ξ of the present state.

        Note:
            Collective.
        """
        found = []
        for ξ, update in zip(self.functions, self.updates, strict=True):
            new = dolfinx.fem.Function(ξ.function_space)
            new.interpolate(update)
            found.append(new.x.array)
        for ξ, array in zip(self.functions, found, strict=True):
            ξ.x.array[:] = array
            ξ.x.scatter_forward()


def create_internal_variables(
    updates: Mapping[dolfinx.fem.Function, Expr], compiler: Compiler
) -> InternalVariables:
    """Check and compile the updates of internal variables.

    Args:
        updates: The update Ξ of each Function ξ, in UFL, of ξ's shape.
        compiler: How they are compiled.

    Raises:
        TypeError: A key is no Function.
        ValueError: A Function has dofs that cells share, or is on another mesh, or its update has
            another shape.

    Note:
        Collective; raises on all processes.
    """
    on_all(lambda: _check(updates, compiler.comm), compiler.comm)
    compiled = [
        compiler.expression(update, interpolation_points(ξ.function_space))
        for ξ, update in updates.items()
    ]
    return InternalVariables(tuple(updates), tuple(compiled))


def _check(updates: Mapping[dolfinx.fem.Function, Expr], comm: MPI.Comm) -> None:
    """Require discontinuous Functions, and updates of their shapes.

    Raises:
        TypeError, ValueError: See :func:`create_internal_variables`.
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
