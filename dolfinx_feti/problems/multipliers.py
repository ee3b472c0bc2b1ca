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

from mpi4py import MPI

import numpy as np

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.problems.system import System
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all

__all__ = ["accelerated", "hold", "prepare", "updated"]


#: Most updates of a solve.
UPDATES = 50

#: How many updates are combined, and how small an eigenvalue of their products counts as zero.
DEPTH, DEPENDENT = 6, 1e-12


def prepare(system: System, tolerance: float) -> None:
    """Let :func:`hold` work.

    Raises:
        ValueError: The tolerance is not positive, or no pressure is condensed.

    Note:
        Collective.
    """
    if not tolerance > 0.0:
        raise ValueError(f"volume_tolerance is {tolerance}: give a number above zero, or None.")
    if system.condensation is None:
        raise ValueError(
            "volume_tolerance is given, but no pressure: pass condense=p, with p in the energy."
        )
    system.condensation.prepare_multipliers()


def hold(system: System, pressure: Array | None = None) -> float:
    """Update the multipliers: only by how much p differs from λ compresses the material.

    Args:
        system: The system.
        pressure: λ, as in ``System.state``; p if not given.

    Returns:
        The greatest change of the mean compression of a cell: abs(mean J − 1) where the state
        solves the equation of p, and λ becomes p.

    Note:
        Collective.
    """
    fields = system.condensation
    assert fields is not None
    multiplier = fields.values() if pressure is None else pressure
    change = on_all(lambda: fields.hold(multiplier), system.comm)
    return system.comm.allreduce(change, op=MPI.MAX)


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
    sizes = (
        [] if system.condensation is None else [len(p.x.array) for p in system.condensation.fields]
    )
    for update in range(UPDATES):
        if update:
            λ = accelerated(past, system.comm, sizes)
            hold(system, λ)
        solved = solve(update)
        past.append((λ, system.state()[1]))
        change = hold(system)
        yield change
        if solved and change <= tolerance:
            return
    raise ConvergenceError(
        f"After {UPDATES} updates of its multipliers the mean volume of a cell is still off by "
        f"{change:.1e}: take a larger κ, which they converge with, or a larger volume_tolerance "
        f"than {tolerance:g}."
    )


def accelerated(past: Sequence[tuple[Array, Array]], comm: MPI.Comm, sizes: Sequence[int]) -> Array:
    """Return the next multipliers, this process's part.

    Args:
        past: Multipliers λ and the pressure p that came of them, one pair for each update.
        comm: Communicator of all parts.
        sizes: Entries of each field. Fields have units of their own: each p − λ is relative to the
            greatest one of its field.

    Note:
        Collective.
    """
    pairs = past[-DEPTH:]
    f = np.array([p - λ for λ, p in pairs])
    for field in np.split(f, np.cumsum(sizes)[:-1], axis=1):
        most = comm.allreduce(float(np.abs(field).max(initial=0.0)), op=MPI.MAX)
        field /= most or 1.0
    changes, last = f[:-1] - f[-1], f[-1]
    product = comm.allreduce(changes @ np.column_stack([changes.T, last]))
    γ = np.linalg.lstsq(product[:, :-1], -product[:, -1], rcond=DEPENDENT)[0]
    p = np.array([p for _, p in pairs])
    return np.asarray(p[-1] + γ @ (p[:-1] - p[-1]))
