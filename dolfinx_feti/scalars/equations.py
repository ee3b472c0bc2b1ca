# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Scalar unknowns s with equations c(u, s) = 0, in UFL, and their derivatives.

.. math:: r(u, s; v) = 0 \quad ∀ v, \qquad c_k(u, s) = 0, \quad k = 1, …, m

The unknowns are constants, which UFL differentiates by as variables; each c_k is a form without
arguments, a sum of integrals over cells and facets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.runtime.arrays import Array

__all__ = ["Coupling", "ScalarEquation", "derivative_in", "values_of"]


class Coupling:
    """What brings scalar unknowns along: an equation, or a cavity or a Windkessel that makes it.

    Attributes:
        functions: Functions that :meth:`accept` changes.
    """

    functions: Sequence[dolfinx.fem.Function] = ()

    @property
    def equation(self) -> ScalarEquation:
        """The unknowns and their equations."""
        raise NotImplementedError

    def check(self, bcs: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Refuse conditions that leave no solution, on all processes. Collective."""

    def check_values(self) -> None:
        """Refuse values that have no solution, before each solve."""

    def begin(self, length: float) -> None:
        """Prepare a step of a path, of this length in its load or time."""

    def accept(self) -> None:
        """Let the present state be the last one of a path. Collective."""


@dataclass(frozen=True)
class ScalarEquation(Coupling):
    """Scalar unknowns and as many equations.

    Attributes:
        unknown: A constant, scalar or (m,); it holds the start and then the solution.
        equations: c_k, m forms without arguments.
        work: What the unknowns add to the residual of u, tested with v; None if F has it.
        mirror: A Function on a real space that shows the values, too.
    """

    unknown: dolfinx.fem.Constant
    equations: tuple[ufl.Form, ...]
    work: ufl.Form | None = None
    mirror: dolfinx.fem.Function | None = None

    def __post_init__(self) -> None:
        """Check the numbers of unknowns, equations and arguments."""
        if not isinstance(self.unknown, dolfinx.fem.Constant):
            raise ValueError(f"unknown is {self.unknown!r}: give a Constant of the forms.")
        m = values_of(self.unknown).size
        if len(self.equations) != m or self.unknown.ufl_shape not in ((), (m,)):
            raise ValueError(
                f"The unknown has the shape {self.unknown.ufl_shape} and {len(self.equations)} "
                "equations: give a scalar constant and one, or a vector and one for each component."
            )
        ranks = [len(c.arguments()) if isinstance(c, ufl.Form) else None for c in self.equations]
        if any(ranks) or None in ranks:
            raise ValueError("The equations of scalars are forms without test or trial functions.")
        if self.work is not None and len(self.work.arguments()) != 1:
            raise ValueError("The work of scalars is a form with a test function of u alone.")

    @property
    def equation(self) -> ScalarEquation:
        """The equation itself."""
        return self


def derivative_in(
    form: ufl.Form, unknown: dolfinx.fem.Constant, direction: dolfinx.fem.Constant
) -> ufl.Form | None:
    """Return the derivative of a form by a constant, in a direction; None if that is zero."""
    s = ufl.variable(unknown)

    def by(integrand: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
        return ufl.inner(ufl.diff(integrand, s), direction)

    integrals = ufl.replace(form, {unknown: s}).integrals()
    whole = ufl.Form([i.reconstruct(integrand=by(i.integrand())) for i in integrals])
    return none_if_zero(whole)


def none_if_zero(form: ufl.Form) -> ufl.Form | None:
    """Return a form, or None if its derivatives turn out to be zero."""
    return None if ufl.algorithms.expand_derivatives(form).empty() else form


def values_of(constant: dolfinx.fem.Constant) -> Array:
    """Return the values of a constant, (m,)."""
    return np.array(constant.value, dtype=np.float64).reshape(-1)
