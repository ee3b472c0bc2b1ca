# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Multipliers that make a material incompressible in the end: their updates, accelerated.

The update λ ← p(λ) of the augmented Lagrangian, with the pressure p(λ) of the equilibrium under
λ, converges linearly, the faster the larger κ is beside the stiffness of the material; Anderson's
method accelerates it (docs/theory.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from mpi4py import MPI

import numpy as np

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.problems.anderson import Anderson
from dolfinx_feti.problems.system import System
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all

#: Most updates of a solve.
UPDATES = 50


def prepare(system: System, tolerance: float) -> None:
    """Let :func:`hold` work. Collective.

    Raises:
        ValueError: The tolerance is not positive, or no pressure is condensed.
    """
    if not tolerance > 0.0:
        raise ValueError(f"volume_tolerance is {tolerance}: give a number above zero, or None.")
    if system.condensation is None:
        raise ValueError(
            "volume_tolerance is given, but no pressure: pass condense=p, with p in the energy."
        )
    system.condensation.prepare_multipliers()


def hold(system: System, pressure: Array | None = None) -> float:
    """Let λ be the pressure, as in ``System.state``, or the present one. Collective.

    Returns:
        The greatest change of the mean compression of a cell: abs(mean J − 1) where the state
        solves the equation of p, and λ becomes p.
    """
    fields = system.condensation
    assert fields is not None
    multiplier = fields.values() if pressure is None else pressure
    change = on_all(lambda: fields.hold(multiplier), system.comm)
    return system.comm.allreduce(change, op=MPI.MAX)


def updated(system: System, solve: Callable[[int], bool], tolerance: float) -> Iterator[float]:
    """Solve and update the multipliers in turn, from λ = p until each cell keeps its volume.

    Args:
        system: The system.
        solve: Solves it after so many updates; tells whether to the end.
        tolerance: On abs(mean J − 1) of each cell.

    Yields:
        The greatest abs(mean J − 1) of a cell after each solve.

    Raises:
        ConvergenceError: There were too many updates, or ``solve`` has failed.
    """
    assert system.condensation is not None
    ends = np.cumsum([len(f.x.array) for f in system.condensation.fields])[:-1]
    λ, change = system.state()[1], np.inf
    unit = np.ones_like(λ)  # of each field its own
    anderson = Anderson(system.comm, len(λ))
    for update in range(UPDATES):
        if update:
            hold(system, λ)
        solved = solve(update)
        p = system.state()[1]
        change = hold(system)
        yield change
        if solved and change <= tolerance:
            return
        if not update:
            for part, first_change in zip(np.split(unit, ends), np.split(p - λ, ends), strict=True):
                part[:] = system.greatest(first_change) or 1.0
        λ = unit * anderson.next(λ / unit, (p - λ) / unit)
    raise ConvergenceError(
        f"After {UPDATES} updates of its multipliers the mean volume of a cell is still off by "
        f"{change:.1e}: take a larger κ, which they converge with, or a larger volume_tolerance "
        f"than {tolerance:g}."
    )
