# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Multipliers that make a material incompressible in the end: their updates, accelerated.

The update λ ← p(λ) of the augmented Lagrangian, with the pressure p(λ) of the equilibrium under
λ, converges linearly, the faster the larger κ is beside the stiffness of the material. Anderson's
acceleration takes the combination of the last updates whose p − λ is least,

.. math:: λ_{k+1} = \sum_j γ_j\, p_j, \qquad
          \min \Bigl\| \sum_j γ_j (p_j - λ_j) \Bigr\|, \quad \sum_j γ_j = 1

(Walker and Ni 2011).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.problems.system import System

__all__ = ["accelerated", "ending_roughly", "updated"]

Array = npt.NDArray[np.float64]

#: What of its first residual a Newton solve leaves before the multipliers are updated.
ROUGH = 0.1

#: Most updates of a solve.
UPDATES = 50

#: How many updates are combined, and how small an eigenvalue of their products counts as zero.
DEPTH, DEPENDENT = 6, 1e-12


@contextmanager
def ending_roughly(snes: PETSc.SNES, scale: float) -> Iterator[tuple[float, float]]:
    """Let a SNES end at a tenth of its first residual.

    Args:
        snes: The solver.
        scale: ‖r‖ that its own relative tolerance refers to.

    Yields:
        ‖r‖ at which it would have ended, and its own relative tolerance.
    """
    rtol, atol, stol, most = snes.getTolerances()
    end = max(atol, rtol * scale)
    try:
        snes.setTolerances(rtol=ROUGH, atol=end)
        yield end, rtol
    finally:
        snes.setTolerances(rtol, atol, stol, most)


def updated(system: System, solve: Callable[[int], bool], tolerance: float) -> Iterator[float]:
    """Solve and update the multipliers in turn, until each cell keeps its volume.

    Args:
        system: The system; it begins with λ = p.
        solve: Solves it after so many updates; tells whether to the end.
        tolerance: On abs(mean J − 1) of each cell.

    Yields:
        The greatest abs(mean J − 1) of a cell after each solve.

    Raises:
        ConvergenceError: There were too many updates, or ``solve`` has failed.

    Note:
        Collective.
    """
    λ, change = system.state()[1], np.inf
    past: list[tuple[Array, Array]] = []
    for update in range(UPDATES):
        if update:
            λ = accelerated(past, system.comm)
            system.hold_pressure(λ)
        solved = solve(update)
        past.append((λ, system.state()[1]))
        change = system.hold_pressure()
        yield change
        if solved and change <= tolerance:
            return
    raise ConvergenceError(
        f"After {UPDATES} updates of its multipliers the mean volume of a cell is still off by "
        f"{change:.1e}: take a larger κ, which they converge with, or a larger volume_tolerance "
        f"than {tolerance:g}."
    )


def accelerated(past: Sequence[tuple[Array, Array]], comm: MPI.Comm) -> Array:
    """Return the next multipliers, this process's part.

    Args:
        past: Multipliers λ and the pressure p that came of them, one pair for each update.
        comm: Communicator of all parts.

    Note:
        Collective.
    """
    pairs = past[-DEPTH:]
    f = np.array([p - λ for λ, p in pairs])
    changes, last = f[:-1] - f[-1], f[-1]
    product = comm.allreduce(changes @ np.column_stack([changes.T, last]))
    γ = np.linalg.lstsq(product[:, :-1], -product[:, -1], rcond=DEPENDENT)[0]
    p = np.array([p for _, p in pairs])
    return np.asarray(p[-1] + γ @ (p[:-1] - p[-1]))
