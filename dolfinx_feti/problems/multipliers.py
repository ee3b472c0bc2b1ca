# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Multipliers that make a material incompressible in the end, a fixed point U = g(U).

The update λ ← p(λ) of the augmented Lagrangian, with the pressure p(λ) of the equilibrium under
λ, converges linearly, the faster the larger κ is beside the stiffness of the material. Anderson's
method accelerates it: of the last differences :math:`Δ\mathcal U, Δ\mathcal F` of the iterates and
of their residuals F = g(U) − U it takes the combination that leaves the least residual,

.. math:: γ = \arg\min \|F - Δ\mathcal F\, γ\|, \qquad
    U ← U + F - (Δ\mathcal U + Δ\mathcal F)\, γ

(Walker and Ni, SIAM Journal on Numerical Analysis 49 (2011), formula 2.2 with β = 1).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from mpi4py import MPI

import numpy as np

from dolfinx_feti.errors import ConvergenceError
from dolfinx_feti.problems.system import System
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_all

#: Most updates of a solve.
UPDATES = 50

#: Differences that are kept.
DEPTH = 20

#: Directions of a smaller share of the largest eigenvalue are rounding.
SMALL = 1e-12


class Anderson:
    """The last iterates of a fixed point; the first ``owned`` entries are this process's."""

    def __init__(self, comm: MPI.Comm, owned: int) -> None:
        self._comm, self._owned = comm, owned
        self._last: list[tuple[Array, Array]] = []  # U, F

    def next(self, U: Array, F: Array) -> Array:
        """Return the next iterate from U and its residual F. Collective."""
        self._last = [*self._last[-DEPTH:], (U.copy(), F.copy())]
        of_U, of_F = (np.diff(vectors, axis=0) for vectors in zip(*self._last, strict=True))
        own = of_F[:, : self._owned]
        A, b = self._comm.allreduce(own @ own.T), self._comm.allreduce(own @ F[: self._owned])
        scale = 1.0 / np.sqrt(np.maximum(np.diag(A), np.finfo(float).tiny))
        γ = scale * (np.linalg.pinv(scale[:, None] * A * scale, SMALL) @ (scale * b))
        return U + F - γ @ (of_U + of_F)


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

    Return the greatest change of the mean compression of a cell: abs(mean J − 1) where λ becomes
    the p that solves its equation.
    """
    fields = system.condensation
    assert fields is not None
    multiplier = fields.values() if pressure is None else pressure
    change = on_all(lambda: fields.hold(multiplier), system.comm)
    return system.comm.allreduce(change, op=MPI.MAX)


def updated(system: System, solve: Callable[[int], bool], tolerance: float) -> Iterator[float]:
    """Solve and update the multipliers in turn, from λ = p until each cell keeps its volume.

    ``solve`` is told the number of updates, and tells whether it has solved to the end. Yields the
    greatest abs(mean J − 1) of a cell after each solve.

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
