# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Problems that are fixed points U = g(U) of another one's solves, and Anderson's acceleration.

Of the last differences :math:`Δ\mathcal U, Δ\mathcal F` of the iterates and of their residuals
F = g(U) − U it takes the combination that leaves the least residual,

.. math:: γ = \arg\min \|F - Δ\mathcal F\, γ\|, \qquad
    U ← U + F - (Δ\mathcal U + Δ\mathcal F)\, γ .

Source: Walker and Ni, SIAM Journal on Numerical Analysis 49 (2011), formula 2.2 with β = 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import dolfinx

from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.problems.nonlinear_problem import NonlinearProblem
from dolfinx_feti.problems.system import Tangent
from dolfinx_feti.runtime.arrays import Array

__all__ = ["MOST", "Anderson", "FixedPoint"]


#: Solves at a load, at most.
MOST = 50

#: Differences that are kept.
DEPTH = 20

#: Directions of a smaller share of the largest eigenvalue are rounding.
SMALL = 1e-12


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

    def renew(self) -> None:
        """Let the next solve depend on none before."""
        self._problem.renew()

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


class Anderson:
    """The last iterates of a fixed point, vectors with the dofs of a space."""

    def __init__(self, space: dolfinx.fem.FunctionSpace) -> None:
        """Begin with none."""
        self._comm = space.mesh.comm
        self._owned = space.dofmap.index_map.size_local * space.dofmap.index_map_bs
        self._last: tuple[Array, Array] | None = None
        self._differences: list[tuple[Array, Array]] = []  # ΔU, ΔF

    def next(self, U: Array, F: Array) -> Array:
        """Return the next iterate from U, ghosts included, and its residual F. Collective."""
        if self._last is not None:
            self._differences.append((U - self._last[0], F - self._last[1]))
            del self._differences[:-DEPTH]
        self._last = U.copy(), F.copy()
        new = U + F
        if self._differences:
            for share, (of_U, of_F) in zip(self._shares(F), self._differences, strict=True):
                new -= share * (of_U + of_F)
        return new

    def _shares(self, F: Array) -> Array:
        """Return γ from the normal equations of the scaled differences."""
        rows = np.stack([of_F[: self._owned] for _, of_F in self._differences])
        A, b = self._comm.allreduce(rows @ rows.T), self._comm.allreduce(rows @ F[: self._owned])
        scale = 1.0 / np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
        return scale * (np.linalg.pinv(scale[:, None] * A * scale, SMALL) @ (scale * b))
