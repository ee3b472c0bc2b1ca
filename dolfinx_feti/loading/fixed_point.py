# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Problems that are fixed points U = g(U) of another one's solves, which a path follows."""

from __future__ import annotations

from typing import Any

import dolfinx

from dolfinx_feti.problems.anderson import Anderson
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.problems.system import Tangent

__all__ = ["MOST", "FixedPoint"]


#: Solves at a load, at most.
MOST = 50


class FixedPoint:
    """A problem that a path follows like a NonlinearProblem, with solves of one inside its own.

    Attributes:
        u: Displacement of the inner problem.
        solver: Its SNES.
        content: What its forms hold.
        history: The Newton steps of all inner solves of the last solve.
        volume_changes: What the last inner solve has left, see the problem.
        internal_variables: None: loads on the way to a shape or a stress are no history.
    """

    internal_variables: tuple[dolfinx.fem.Function, ...] = ()

    def __init__(self, problem: NonlinearProblem) -> None:
        self._problem, self._comm = problem, problem.u.function_space.mesh.comm
        self.u, self.solver, self.content = problem.u, problem.solver, problem.content
        self.renew = problem.renew
        self.history: list[NewtonStep] = []
        self.volume_changes: list[float] = []

    def update_internal_variables(self, *, balanced: bool | None = None) -> None:
        """Remember nothing."""

    def begin_step(self, length: float) -> None:
        """Depend on no length of a step."""

    def solve(
        self,
        *,
        reference: float | None = None,
        first_tangent: Tangent | None = None,
        renew: bool = True,
        give_up_early: bool = False,
    ) -> dolfinx.fem.Function:
        """Iterate; see :meth:`NonlinearProblem.solve`."""
        self.history = []
        self._iterate(reference, {"first_tangent": first_tangent, "renew": renew})
        return self.u

    def _iterate(self, reference: float | None, options: dict[str, Any]) -> None:
        """Solve the inner problem, at first with options, until the fixed point is found."""
        raise NotImplementedError

    def residual_norm(self) -> float:
        """Return ‖r‖ of the inner problem."""
        return self._problem.residual_norm()

    def linearise(self) -> Tangent:
        """Assemble the inner problem's tangent."""
        return self._problem.linearise()

    def _solve(self, **options: Any) -> None:
        """Solve the inner problem."""
        try:
            self._problem.solve(**options)
        finally:
            self.history += self._problem.history
            self.volume_changes = self._problem.volume_changes

    def _anderson(self, f: dolfinx.fem.Function) -> Anderson:
        """Begin to accelerate the iteration of a function."""
        dofmap = f.function_space.dofmap
        return Anderson(self._comm, dofmap.index_map.size_local * dofmap.index_map_bs)
