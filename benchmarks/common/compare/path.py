# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A load path whose linear systems FETI and direct solvers solve.

.. math:: A(U^k)\, ΔU = -r(U^k), \qquad U^{k+1} = U^k + α\, ΔU

Newton's method goes on with FETI's ΔU, so that there is one path; the others solve each system
after FETI. All keep from one tangent to the next what they can: FETI its gluing, its coarse space
and the factors of a few tangents (``feti_lag``), MUMPS its analysis. A tangent that Newton's method
keeps is factored once. FETI is as accurate as each step deserves (``newton``): its residual in a
record is that of the roughest solve. *End to end* is everything from the first to the last
equilibrium, with the linear solves of one solver.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from benchmarks.common.bodies import LoadedBody
from benchmarks.common.clock import Events, Stopwatch
from benchmarks.common.compare.opponents import OPPONENTS
from benchmarks.common.records import Record
from dolfinx_feti import ConvergenceError, loads
from dolfinx_feti.comparison import (
    assembled_system,
    create_solver,
    relative_difference,
    relative_residual,
    timed_solve,
)
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps, follow_load
from dolfinx_feti.runtime.collective import on_all, reason
from dolfinx_feti.torn.matrix import State, state_of

__all__ = ["PHASES", "SOLVERS", "follow", "load"]


#: Log events of FETI that do not overlap, in the order of the method.
PHASES = (
    "FETIGluing",
    "FETISchur",
    "FETIModes",
    "FETICoarse",
    "FETISchurProduct",
    "FETILocalSolve",
    "FETICoarseSolve",
)

#: Solvers of a path: FETI drives Newton's method, and tangents may be indefinite on the way.
SOLVERS = ("feti", "mumps", "pardiso")

#: As in ``demos/demo_artery.py``: the first load step's share of the path, and the relative
#: tolerances of Newton's method and of FETI before its end.
FIRST, RTOL, LINEAR_RTOL = 0.1, 1e-3, 1e-3


def load(
    body: LoadedBody,
    mmhg: float,
    checkpoint: Checkpoint | None = None,
    on_step: Callable[[LoadStep], object] | None = None,
) -> None:
    """Load a body at rest [mmHg], or go on from a checkpoint. Collective."""

    def set_load(value: float) -> None:
        body.load.value = loads.mmhg(value)

    first = FIRST * mmhg
    steps = Steps(first, least=first / 64, growth=1.15, quick=4, rtol=RTOL, linear_rtol=LINEAR_RTOL)
    follow_load(
        body.problem, set_load, [mmhg], steps,
        state=[body.u, body.p], on_step=on_step, checkpoint=checkpoint, unit="mmHg",
    )  # fmt: skip


def follow(body: LoadedBody, mmhg: float, *, direct: Sequence[str] = ()) -> list[Record]:
    """Load a body at rest [mmHg], and record what its systems cost FETI and others. Collective.

    Returns:
        A record for each solver; ``note`` says why the path or the solver came to no end.
    """
    comm, others = body.u.function_space.mesh.comm, [_Direct(name) for name in direct]
    ksp, beside, its = body.problem.solver.getKSP(), list[float](), list[int]()
    phases, watch = Events(PHASES, comm), Stopwatch(comm)

    def then(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        begun = time.perf_counter()
        its.append(ksp.getIterationNumber())
        for other in others:
            other.solve(body.problem.A, b, x)
        beside.append(time.perf_counter() - begun)

    watch.hook(ksp, then)
    accepted: list[LoadStep] = []
    note, begun = "", time.perf_counter()
    try:
        load(body, mmhg, on_step=accepted.append)
    except ConvergenceError as error:
        note = f"failed: {reason(error)}"
    seconds = comm.allreduce(time.perf_counter() - begun - sum(beside), op=MPI.MAX)
    newton = [step for load_step in accepted for step in load_step.all_steps]
    each = watch.each()
    run: Record = {
        "newton_iterations": len(newton),
        "load_steps": len(accepted),
        "seconds_assembly": sum(step.seconds_assembly for step in newton),
    }
    rest = seconds - each.sum()
    cost = run | _cost(each, its, len(newton), rest)
    difference = next((other.difference for other in others), None)
    outcome = _outcome([step.linear_residual for step in newton], difference, note)
    found = [{"solver": "feti"} | cost | outcome | {"seconds_phases": phases.seconds()}]
    for other in others:
        cost = run | _cost(np.array(other.seconds), other.iterations, len(newton), rest)
        outcome = _outcome(other.residuals, 0.0, other.note or note)
        found.append({"solver": other.name} | cost | outcome)
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


def _cost(
    each: npt.NDArray[np.float64], iterations: Sequence[int], newton_steps: int, rest: float
) -> Record:
    """Return what the solves of a run took, each set-up and solution, (solves, 2), and the rest."""
    setup, solve = each.reshape(-1, 2).T
    later = (setup + solve)[1:].sum()
    return {
        "peak_mib": None,
        "linear_solves": len(setup),
        "iterations": sum(iterations),
        "iterations_per_solve": list(iterations),
        "seconds_setup": setup.sum(),
        "seconds_solve": solve.sum(),
        "seconds_per_solve": (setup + solve).tolist(),
        "seconds_end_to_end": rest + (setup + solve).sum(),
        "seconds_per_newton": later / (newton_steps - 1) if newton_steps > 1 else None,
    }


def _outcome(residuals: Sequence[float], difference: float | None, note: str) -> Record:
    """Return how well the systems were solved, and whether to the end."""
    return {
        "relative_residual": max(residuals, default=None),
        "difference_to_mumps": difference,
        "converged": not note,
        "note": note,
    }
