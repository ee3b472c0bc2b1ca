# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A played problem for load steps: its equilibria are known, and it fails where it is told to."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
from collective import COMM, agree
from problems import cube

import dolfinx

from dolfinx_feti import ConvergenceError
from dolfinx_feti.fem.content import Content
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import LoadStep, Steps
from dolfinx_feti.problems.history import NewtonStep

ROUNDING = 1e-12
OWN = 1e-9
STEP = NewtonStep(
    residual=1.0,
    step_length=1.0,
    linear_method="cg",
    linear_iterations=7,
    linear_residual=1e-9,
    condition_number=3.0,
    negative=0,
    indefinite=0,
    shift=0.0,
    solves=1,
    seconds_assembly=0.1,
    seconds_linear=0.2,
)


SNES = PETSc.SNES.ConvergedReason


@dataclass(frozen=True, slots=True)
class Attempt:
    """What a problem saw when it was solved.

    Attributes:
        load: The load.
        before: That of the last equilibrium.
        rtol: The tolerance.
        referred: Load and state that the tolerance refers to, if it was given.
        linearised: Load and state of the first tangent, if it was given.
        guess: The state, u and p in one entry each.
        converged: What came of it.
        renewed: Whether the preconditioner was to begin anew.
    """

    load: float
    before: float
    rtol: float
    linear_rtol: float
    referred: tuple[float, float, float] | None
    linearised: tuple[float, float, float] | None
    guess: tuple[float, float]
    converged: bool
    renewed: bool


class Played:
    """A problem with known equilibria, u(t) = 1 − 2 t + 3 t² and p(t) = t² − t.

    A solve takes as many Newton steps as it is told, or fails and leaves nonsense behind.
    """

    def __init__(
        self,
        *,
        start: float = 0.0,
        cost: Callable[[float], int] = lambda increment: 1,
        fails: Callable[[float, float], bool] = lambda before, load: False,
        inside_out: Callable[[float], bool] = lambda load: False,
    ) -> None:
        mesh = cube(2, 2)
        V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
        self.u = dolfinx.fem.Function(V)
        self.p = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
        self.volume_changes: list[float] = []
        self.internal_variables: tuple[dolfinx.fem.Function, ...] = ()
        self.content = Content((self.u, self.p))
        self.remembered: list[float] = []
        self.solver = PETSc.SNES().create(COMM)
        self.solver.setTolerances(rtol=OWN, atol=1e-10, max_it=30)
        self.solver.getKSP().setTolerances(rtol=OWN)
        self.solver.setSolution(PETSc.Vec().createMPI(1, comm=COMM))  # or it cannot be monitored
        self.history: list[NewtonStep] = []
        self.attempts: list[Attempt] = []
        self._cost, self._fails, self._inside_out = cost, fails, inside_out
        self._norms: dict[float, tuple[float, float, float]] = {}
        self._renewed = False
        self.load = self._equilibrium = start
        self._set(*truth(start))

    def _set(self, u: float, p: float) -> None:
        self.u.x.array[:], self.p.x.array[:] = u, p

    def state(self) -> tuple[float, float]:
        """Return u and p; each must have one value all over."""
        values = [f.x.array for f in (self.u, self.p)]
        agree(all(np.ptp(v) <= ROUNDING * (1 + abs(v[0])) for v in values if len(v)))
        return tuple(float(COMM.bcast(v[0] if len(v) else None)) for v in values)

    def linearise(self) -> tuple[float, float, float]:
        return (self.load, *self.state())

    def residual_norm(self) -> float:
        norm = 1.0 + len(self._norms)
        self._norms[norm] = (self.load, *self.state())
        return norm

    def update_internal_variables(self, *, balanced: bool | None = None) -> None:
        if balanced:
            self.remembered.append(self.load)

    def begin_step(self, length: float) -> None:
        agree(length != 0.0)

    def renew(self) -> None:
        self._renewed = True

    def solve(
        self,
        *,
        reference: float | None = None,
        first_tangent: tuple[float, float, float] | None = None,
        renew: bool = True,
        give_up_early: bool = False,
    ) -> None:
        renewed, self._renewed = renew or self._renewed, False
        before = self._equilibrium
        domain = first_tangent is None and self._inside_out(self.load)
        self.solver.setConvergedReason(
            SNES.DIVERGED_FUNCTION_DOMAIN if domain else SNES.DIVERGED_LINE_SEARCH
        )
        fails = domain or self._fails(before, self.load)
        self.attempts.append(
            Attempt(
                self.load,
                before,
                self.solver.getTolerances()[0],
                self.solver.getKSP().getTolerances()[0],
                None if reference is None else self._norms[reference],
                first_tangent,
                self.state(),
                not fails,
                renewed,
            )
        )
        for it in range(cost := self._cost(abs(self.load - before))):
            self.solver.monitor(it, 10.0**-it)
        self.history = [STEP] * cost
        if fails:
            self._set(math.nan, math.inf)
            raise ConvergenceError("The spring broke.")
        self._equilibrium = self.load
        self._set(*truth(self.load))

    def follow(self, targets: list[float], steps: Steps, **arguments: object) -> list[LoadStep]:
        return follow_load(
            self,
            lambda load: setattr(self, "load", load),
            targets,
            steps,
            state=[self.u, self.p],
            start=self._equilibrium,
            **arguments,
        )


def truth(t: float) -> tuple[float, float]:
    return 1 - 2 * t + 3 * t**2, t**2 - t
