# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Refinement of the solution of a bordered system, until its estimated error η is small.

.. math:: r = b - A x - B s, \quad c = d - C^⊤ x - D s: \qquad
          A\, δy = r, \quad (δx, δs) \text{ by block elimination}, \quad
          x ← x + δx, \; s ← s + δs

η is the size of (δx, δs) if one application of the preconditioner takes the place of the solve
:math:`A\, δy = r`. It is the larger one of x (``feti.accuracy``) and of the scalars
(``BlockElimination.error_of_scalars``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.scalars.border import BlockElimination
from dolfinx_feti.scalars.bordered_system import BorderedSystem
from dolfinx_feti.scalars.matrix_solver import MatrixSolveError, MatrixSolver

__all__ = ["Refined", "refine"]

#: Largest number of refinements. Each one reduces the error as much as a solve does. A third one
#: was never needed: this guards against endless loops.
MAX_REFINEMENTS = 4

#: Factor by which a refinement has to reduce η for another one to follow. At the limit of rounding
#: η changes at random, which a factor near one would take for progress. The same value as that of
#: fresh starts (``outer_loop``).
REFINEMENT_GAIN = 0.5


@dataclass(frozen=True, slots=True)
class Refined:
    """A solution of a bordered system after refinement.

    Attributes:
        x: First unknown, (N,).
        s: Scalars, (m,).
        error_estimate: η, the larger one of x and of the scalars; nan if it was not measured.
        total_error_estimate: The same, with η of all components of x together.
        error_tolerance: Tolerance of η.
    """

    x: Array
    s: Array
    error_estimate: float
    total_error_estimate: float
    error_tolerance: float


def refine(
    solver: MatrixSolver, system: BorderedSystem, elimination: BlockElimination, x: Array, s: Array
) -> Refined:
    """Correct x and s until η is at its tolerance, or rounding keeps it above. Collective.

    Args:
        solver: Solves with A.
        system: The bordered system.
        elimination: Its block elimination.
        x: Its solution, (N,).
        s: Its scalars, (m,).

    Returns:
        The solution with the smallest η; that before a correction whose solve has failed. η is nan
        without a preconditioner.
    """
    without_springs = system.border.without_springs
    error_tolerance, second_reference = _error_tolerance(solver, system, s)
    best = Refined(x, s, np.inf, np.nan, error_tolerance)
    for _ in range(1 + MAX_REFINEMENTS):
        r, c = system.residual(x, s)
        z = solver.precondition(r)  # z ≈ A⁻¹ r
        if z is None:
            break
        dx, ds = elimination.solve(z, c)
        η_x, total_η_x = solver.feti.errors_of_correction(dx, [x, second_reference])
        η_s = elimination.error_of_scalars(without_springs(ds), without_springs(s), x)
        η = max(η_x, η_s)
        has_gained = η <= REFINEMENT_GAIN * best.error_estimate
        if η < best.error_estimate:
            best = Refined(x, s, η, max(total_η_x, η_s), error_tolerance)
        if not η > error_tolerance or not has_gained:  # ends also if η is nan
            break
        try:
            y = solver.solve_to(r, rtol=error_tolerance / η, atol=0.0)
        except MatrixSolveError:
            break  # the best solution so far is returned
        dx, ds = elimination.solve(y, c)
        x = x + dx
        s = s + ds
    if np.isinf(best.error_estimate):
        best = replace(best, error_estimate=np.nan)
    return best


def _error_tolerance(solver: MatrixSolver, system: BorderedSystem, s: Array) -> tuple[float, Array]:
    """Return the tolerance of η, and a second reference for η, (N,); see ``SolveSettings``.

    Args:
        solver: Solver with the tolerances of the KSP.
        system: The bordered system.
        s: Scalars that the absolute tolerance is relative to, (m,).
    """
    scale = system.scale(s) or np.inf  # without a load, rtol alone counts
    tolerance = max(solver.rtol, solver.atol / scale)
    return solver.feti.settings.loosen(tolerance, len(system.b))
