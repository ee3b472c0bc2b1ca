# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A fake problem for load steps, whose equilibria are known and whose solves fail on demand."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from petsc4py import PETSc

import numpy as np
from collective import COMM, agree
from problems import cube

import dolfinx

from dolfinx_feti import ConvergenceError
from dolfinx_feti.errors import InadmissibleStartError
from dolfinx_feti.fem.user_forms.form_content import FormContent
from dolfinx_feti.loading.load_step import LoadStep
from dolfinx_feti.loading.load_steps import follow_load
from dolfinx_feti.loading.steps import Steps
from dolfinx_feti.problems.history import NewtonStep

#: Difference of two equal states that rounding allows.
ROUNDING = 1e-12

#: The problem's own tolerances, of Newton's method and of linear solves.
OWN = 1e-9

#: What the history has for each Newton step.
STEP = NewtonStep(1.0, 1.0, "cg", 7, 1e-9, 3.0, 0, 0, 0.0, 1, 0.1, 0.2)

State = tuple[float, float, float]  # load, u, p


class Attempt(NamedTuple):
    """Load, tolerances and state with which a fake problem was solved."""

    load: float
    before: float  # the load of the last equilibrium
    rtol: float
    linear_rtol: float
    referred: State | None  # what the tolerance refers to
    linearised: State | None  # where the first tangent was assembled
    guess: tuple[float, float]
    converged: bool
    renewed: bool  # whether the preconditioner was to begin anew


def truth(t: float) -> tuple[float, float]:
    """Return u and p of the equilibrium at a load."""
    return 1 - 2 * t + 3 * t**2, t**2 - t


class FakeProblem:
    """A problem whose equilibrium at a load is u, p = truth(load).

    A solve that fails leaves NaN and infinity in u and p.

    Args:
        start: Load of the first equilibrium.
        cost: Newton steps of a solve, by the increment of the load.
        fails: Whether a solve fails, by the load of the last equilibrium and the new one.
        inside_out: Whether a prediction at a load is inadmissible.
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
        self.u, self.p = (
            dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))
            for element in (("Lagrange", 1), ("DG", 0))
        )
        self.unknown = self.u
        self.content = FormContent((self.u, self.p))
        self.internal_variables = ()
        self.n_updates = 0
        self.solver = PETSc.SNES().create(COMM)
        self.solver.setTolerances(rtol=OWN, atol=1e-10, max_it=30)
        self.solver.getKSP().setTolerances(rtol=OWN)
        self.solver.setSolution(PETSc.Vec().createMPI(1, comm=COMM))  # or it cannot be monitored
        self.history: list[NewtonStep] = []
        self.attempts: list[Attempt] = []
        self._cost = cost
        self._fails = fails
        self._inside_out = inside_out
        self._norms: dict[float, State] = {}
        self._renewed = False
        self.load = self._equilibrium = start
        self._set(*truth(start))

    def _set(self, u: float, p: float) -> None:
        self.u.x.array[:] = u
        self.p.x.array[:] = p

    def state(self) -> tuple[float, float]:
        """Return u and p; assert that each has the same value at all dofs."""
        values = [f.x.array for f in (self.u, self.p)]
        agree(all(np.ptp(v) <= ROUNDING * (1 + abs(v[0])) for v in values if len(v)))
        return tuple(float(COMM.bcast(v[0] if len(v) else None)) for v in values)

    def linearise(self) -> State:
        """Return the load and state at which the tangent is assembled."""
        return (self.load, *self.state())

    def residual_norm(self) -> float:
        """Return a norm by which the present state is known later, as a reference."""
        norm = 1.0 + len(self._norms)
        self._norms[norm] = self.linearise()
        return norm

    def update_internal_variables(self, which: str = "all") -> None:
        """Do nothing: there are no internal variables."""

    def begin_step(self, length: float) -> None:
        """Assert that a step has a length."""
        agree(length != 0.0)

    def renew(self) -> None:
        """Record that the preconditioner is to be set up at the next solve."""
        self._renewed = True

    def warn_of_cells(self) -> None:
        """Log no warning."""

    def solve(
        self,
        *,
        reference=None,
        first_tangent=None,
        renew=True,
        give_up_early=False,
        check_cells=True,
    ) -> None:
        """Record the attempt, and set u and p to the equilibrium, or to NaN and raise."""
        agree(not check_cells, "a path looks at the cells in accepted states alone")
        renewed = renew or self._renewed
        self._renewed = False
        before = self._equilibrium
        is_inadmissible = first_tangent is None and self._inside_out(self.load)
        fails = is_inadmissible or self._fails(before, self.load)
        rtol, linear_rtol = (s.getTolerances()[0] for s in (self.solver, self.solver.getKSP()))
        referred = self._norms.get(reference)
        self.attempts.append(
            Attempt(
                self.load,
                before,
                rtol,
                linear_rtol,
                referred,
                first_tangent,
                self.state(),
                not fails,
                renewed,
            )
        )
        cost = self._cost(abs(self.load - before))
        for it in range(cost):
            self.solver.monitor(it, 10.0**-it)
        self.history = [STEP] * cost
        if fails:
            self._set(math.nan, math.inf)
            error = InadmissibleStartError if is_inadmissible else ConvergenceError
            raise error("The spring broke.")
        self._equilibrium = self.load
        self._set(*truth(self.load))

    def follow(self, targets: list[float], steps: Steps, **arguments: object) -> list[LoadStep]:
        """Follow the load through targets; return the load steps."""
        return follow_load(
            self,
            lambda load: setattr(self, "load", load),
            targets,
            steps,
            state=[self.u, self.p],
            start=self._equilibrium,
            **arguments,
        )
