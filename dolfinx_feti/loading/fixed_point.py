# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Problems that are fixed points U = g(U) of another one's solves, which a path follows."""

from __future__ import annotations

from typing import Any

import dolfinx

from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.multipliers import Anderson
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem

__all__ = ["MOST", "FixedPoint"]


#: Solves at a load, at most.
MOST = 50


class FixedPoint:
    """A problem that a path follows like the NonlinearProblem inside, whose solves it iterates.

    Attributes:
        history: The Newton steps of all inner solves of the last solve.
        internal_variables: None: loads on the way to a shape or a stress are no history.
    """

    internal_variables: tuple[dolfinx.fem.Function, ...] = ()

    def __init__(self, problem: NonlinearProblem) -> None:
        self._problem, self._comm = problem, problem.u.function_space.mesh.comm
        self.history: list[NewtonStep] = []

    def __getattr__(self, name: str) -> Any:
        """Be the inner problem in all else."""
        return getattr(self._problem, name)

    def update_internal_variables(self, *, balanced: bool | None = None) -> None:
        """Remember nothing."""

    def begin_step(self, length: float) -> None:
        """Depend on no length of a step."""

    def solve(
        self, *, reference: float | None = None, give_up_early: bool = False, **options: Any
    ) -> dolfinx.fem.Function:
        """Iterate, to the end; see :meth:`NonlinearProblem.solve`."""
        self.history = []
        self._iterate(reference, options)
        return self.u

    def _iterate(self, reference: float | None, options: dict[str, Any]) -> None:
        """Solve the inner problem, at first with options, until the fixed point is found."""
        raise NotImplementedError

    def _solve(self, **options: Any) -> None:
        """Solve the inner problem."""
        try:
            self._problem.solve(**options)
        finally:
            self.history += self._problem.history

    def _anderson(self, f: dolfinx.fem.Function) -> Anderson:
        """Begin to accelerate the iteration of a function."""
        dofmap = f.function_space.dofmap
        return Anderson(self._comm, dofmap.index_map.size_local * dofmap.index_map_bs)
