# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A load path whose linear systems FETI and direct solvers solve.

.. math:: A(U^k)\, ΔU = -r(U^k), \qquad U^{k+1} = U^k + α\, ΔU

Newton's method goes on with FETI's ΔU; the others solve each system after FETI, and keep what they
can: MUMPS its analysis, and the factors of a tangent that Newton's method keeps. *End to end* is
everything from the first to the last equilibrium, with the linear solves of one solver.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from benchmarks.common.bodies import Body
from benchmarks.common.clock import Stopwatch
from benchmarks.common.compare.opponents import OPPONENTS
from benchmarks.common.records import Record
from dolfinx_feti import ConvergenceError
from dolfinx_feti.comparison import (
    assembled_system,
    create_solver,
    relative_difference,
    relative_residual,
    timed_solve,
)
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps
from dolfinx_feti.runtime.collective import on_all, reason
from dolfinx_feti.torn.matrix import State, state_of

__all__ = ["SOLVERS", "follow", "load"]

#: Solvers of a path: FETI drives Newton's method, and tangents may be indefinite on the way.
SOLVERS = ("feti", "mumps", "pardiso")

#: As in ``demos/demo_artery.py``: the first load step's share of the path, and the relative
#: tolerances of Newton's method and of FETI before its end.
FIRST, RTOL, LINEAR_RTOL = 0.1, 1e-3, 1e-3


def load(
    body: Body,
    mmhg: float,
    checkpoint: Checkpoint | None = None,
    on_step: Callable[[LoadStep], object] = lambda _step: None,
) -> None:
    """Load a wall at rest [mmHg], or go on from a checkpoint. Collective."""
    first = FIRST * mmhg
    steps = Steps(first, least=first / 64, growth=1.15, quick=4, rtol=RTOL, linear_rtol=LINEAR_RTOL)
    body.inflate([mmhg], steps, on_step=on_step, checkpoint=checkpoint)


def follow(body: Body, mmhg: float, *, direct: Sequence[str] = ()) -> list[Record]:
    """Load a wall at rest [mmHg], and record what its systems cost FETI and others. Collective.

    Returns:
        A record for each solver; ``note`` says why the path or the solver came to no end.
    """
    comm, others = body.u.function_space.mesh.comm, [_Direct(name) for name in direct]
    beside, its, watch = 0.0, list[int](), Stopwatch(comm)

    def then(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        nonlocal beside
        begun = time.perf_counter()
        its.append(ksp.getIterationNumber())
        for other in others:
            other.solve(body.problem.A, b, x)
        beside += time.perf_counter() - begun

    watch.hook(body.problem.solver.getKSP(), then)
    accepted: list[LoadStep] = []
    note, begun = "", time.perf_counter()
    try:
        load(body, mmhg, on_step=accepted.append)
    except ConvergenceError as error:
        note = f"failed: {reason(error)}"
    seconds = comm.allreduce(time.perf_counter() - begun - beside, op=MPI.MAX)
    newton, each = [step for load_step in accepted for step in load_step.all_steps], watch.each()

    def record(
        solver: str, spent: npt.NDArray[np.float64], iterations: list[int],
        residuals: list[float], difference: float | None, note: str,
    ) -> Record:  # fmt: skip
        """Return what the solves cost, each set-up and solution, and how well they were solved."""
        setup, solve = spent.reshape(-1, 2).T
        later = float((setup + solve)[1:].sum())
        return {
            "solver": solver,
            "newton_iterations": len(newton),
            "load_steps": len(accepted),
            "seconds_assembly": sum(step.seconds_assembly for step in newton),
            "peak_mib": None,
            "linear_solves": len(setup),
            "iterations": sum(iterations),
            "iterations_per_solve": iterations,
            "seconds_setup": setup.sum(),
            "seconds_solve": solve.sum(),
            "seconds_end_to_end": seconds - each.sum() + (setup + solve).sum(),
            "seconds_per_newton": later / (len(newton) - 1) if len(newton) > 1 else None,
            "relative_residual": max(residuals, default=None),
            "difference_to_mumps": difference,
            "converged": not note,
            "note": note,
        }

    residuals = [step.linear_residual for step in newton]
    difference = next((other.difference for other in others), None)
    found = [record("feti", each, its, residuals, difference, note)]
    for other in others:
        spent = np.array(other.seconds)
        found.append(
            record(other.name, spent, other.iterations, other.residuals, 0.0, other.note or note)
        )
        other.destroy()
    return found


class _Direct:
    """A direct solver on the tangents of a path: analysed once, factored for each."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.seconds: list[tuple[float, float]] = []  # analysis and factors, solution; each solve
        self.iterations: list[int] = []
        self.residuals: list[float] = []  # ‖f − K x‖/‖f‖
        self.difference: float | None = None  # ‖x_FETI − x‖/‖x‖ of the last solve
        self.note = ""  # why it failed; then it solves no more
        self._K: PETSc.Mat | None = None
        self._state: State | None = None  # of the torn matrix behind it
        self._ksp: PETSc.KSP | None = None

    def solve(self, A: PETSc.Mat, b: PETSc.Vec, x_feti: PETSc.Vec) -> None:
        """Solve the assembled counterpart of a torn system A x = b. Collective."""
        if self.note:
            return
        local = A.getISLocalMat()
        before = local.stateGet()
        K, f = assembled_system(A, b)
        local.stateSet(before)  # it was only read, though PETSc counts a change
        if self._K is None:
            self._K = K
        else:
            if state_of(A) != self._state:  # PETSc factors a matrix anew that has been written to
                K.copy(self._K, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            K.destroy()
        self._state = state_of(A)
        x = f.duplicate()
        try:
            cost, self._ksp = on_all(lambda: timed_solve(self._set_up, f, x), f.comm.tompi4py())
        except PETSc.Error as error:
            self.note = f"failed: {reason(error)}"
        else:
            if cost.converged_reason > 0:
                self.seconds.append((cost.seconds_setup, cost.seconds_solve))
                self.iterations.append(cost.iterations)
                self.residuals.append(relative_residual(self._K, f, x))
                self.difference = relative_difference(x_feti, x)
            else:
                self.note = f"failed: PETSc's reason {cost.converged_reason}"
        f.destroy()
        x.destroy()

    def _set_up(self) -> PETSc.KSP:
        """Return the solver, with an analysis if there was a matrix before."""
        if self._ksp is None:
            return create_solver(self._K, self.name, OPPONENTS[self.name])
        self._ksp.setOperators(self._K)  # perhaps the matrix is another one
        return self._ksp

    def destroy(self) -> None:
        """Free matrix and factors."""
        for owned in filter(None, (self._ksp, self._K)):
            owned.destroy()
