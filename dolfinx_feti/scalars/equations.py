# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Scalar unknowns s with equations c(u, s) = 0 in UFL.

.. math:: r(u, s; v) = 0 \quad ∀ v, \qquad c_k(u, s) = 0, \quad k = 1, …, m

The unknowns are constants. Each c_k is a form without arguments, a sum of integrals over cells and
facets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import dolfinx
import ufl

from dolfinx_feti.runtime.arrays import Array

__all__ = ["Coupling", "ScalarEquation", "ScalarTangent", "values_of"]


class Coupling:
    """Base class of scalar unknowns with equations: ScalarEquation, Cavity, Windkessel, ArcLength.

    A subclass defines ``equation``, and those of the other methods that it needs. A problem calls
    :meth:`check` with its Dirichlet conditions, again when they change, and :meth:`check_values`
    before each solve. Paths call :meth:`begin_step` before the solves of a step, and
    :meth:`accept` after a successful one.

    Attributes:
        functions: Functions that :meth:`accept` changes, which paths restore after a failed step.
            Constants need no list: paths restore all Constants of the forms.
    """

    functions: Sequence[dolfinx.fem.Function] = ()

    @property
    def equation(self) -> ScalarEquation:
        """The unknowns and their equations."""
        raise NotImplementedError

    def check(self, bcs: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Check that a solution with these conditions exists. Collective.

        Raises:
            ValueError: It does not; on all processes.
        """

    def check_values(self) -> None:
        """Check before each solve that a solution exists for the values of the constants.

        Raises:
            ValueError: It does not; on this process.
        """

    def begin_step(self, length: float) -> None:
        """Prepare a step of a path.

        Args:
            length: Length of the step, in the unit of the path: a load, or a time [s].
        """

    def accept(self) -> None:
        """Store the present state as the last one of a path. Collective."""


@dataclass(frozen=True, slots=True)
class ScalarTangent:
    """The user's own derivatives of a :class:`ScalarEquation`, in place of those that UFL derives.

    A zero block is None. ds is a trial function on the real space of the scalars s.

    Attributes:
        column: ∂r/∂s, bilinear in v and ds.
        rows: ∂c_k/∂u for each equation, linear in a test function of the space of u.
        blocks: ∂c_k/∂s for each constant s, a form for each equation, linear in the ds of s.
    """

    column: ufl.Form | None
    rows: tuple[ufl.Form | None, ...]
    blocks: Mapping[dolfinx.fem.Constant, tuple[ufl.Form | None, ...]]


@dataclass(frozen=True)
class ScalarEquation(Coupling):
    """Scalar unknowns and as many equations.

    Attributes:
        unknown: A constant, scalar or (m,), with the initial values and later the solution.
        equations: c_k, m forms without arguments.
        work: Part of the residual of u due to the unknowns, tested with v; None if the residual of
            the problem contains it already.
        mirror: A Function on a real space to which the values are copied.
        tangent: Its derivatives; derived by UFL if None.
    """

    unknown: dolfinx.fem.Constant
    equations: tuple[ufl.Form, ...]
    work: ufl.Form | None = None
    mirror: dolfinx.fem.Function | None = None
    tangent: ScalarTangent | None = None

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
        if any(rank != 0 for rank in ranks):
            raise ValueError("The equations of scalars are forms without test or trial functions.")
        if self.work is not None and len(self.work.arguments()) != 1:
            raise ValueError("The work of scalars is a form with a test function of u alone.")

    @property
    def equation(self) -> ScalarEquation:
        """The equation itself."""
        return self


def values_of(constant: dolfinx.fem.Constant) -> Array:
    """Return the values of a constant, (m,)."""
    return np.array(constant.value, dtype=np.float64).reshape(-1)
