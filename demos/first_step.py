# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI beside MUMPS on the first linear system of a nonlinear problem."""

from __future__ import annotations

import time
from dataclasses import asdict

from petsc4py import PETSc

from dolfinx_feti import NonlinearProblem
from dolfinx_feti.comparison import (
    Cost,
    PeakMemory,
    assembled_system,
    create_mumps,
    measure,
    record_cost,
    relative_residual,
)

__all__ = ["FirstStep"]

Record = dict[str, float]


class FirstStep:
    """Keeps the first linear system that a problem solves, with FETI's solution of it.

    Two hooks of the KSP do it, one before set-up and solution and one behind them.
    """

    def __init__(self, problem: NonlinearProblem) -> None:
        """Hook into the problem's KSP."""
        ksp = problem.solver.getKSP()
        self._cost: Cost | None = None
        self._times: list[float] = []
        ksp.setPreSolve(self._before)
        ksp.setPostSolve(self._after)

    def _before(self, ksp: PETSc.KSP, _b: PETSc.Vec, _x: PETSc.Vec) -> None:
        if self._cost is None:
            self._peak = PeakMemory()
            self._times = [time.perf_counter()]
            ksp.setUp()
            self._times.append(time.perf_counter())

    def _after(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        if self._cost is None:
            self._times.append(time.perf_counter())
            self._cost = record_cost(ksp, self._times, self._peak)
            self._x = x.copy()
            self._K, self._f = assembled_system(ksp.getOperators()[0], b)

    def feti(self) -> Record:
        """Return what FETI cost, and its residual.

        Note:
            Collective.
        """
        return self._record(self._cost, self._x)

    def mumps(self) -> tuple[Record, float]:
        """Solve the same system with a symmetric factorisation by MUMPS.

        Returns:
            What it cost and its residual, and the relative difference of FETI's solution to it.

        Note:
            Collective.
        """
        cost, x = measure(lambda: create_mumps(self._K), self._f)
        record, scale = self._record(cost, x), x.norm()
        x.axpy(-1.0, self._x)
        return record, x.norm() / scale

    def _record(self, cost: Cost, x: PETSc.Vec) -> Record:
        return asdict(cost) | {"relative_residual": relative_residual(self._K, self._f, x)}
