# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A load path whose linear systems FETI and a direct solver solve, each in a run of its own.

.. math:: A(U^k)\, ΔU = -r(U^k), \qquad U^{k+1} = U^k + α\, ΔU

Newton's method goes on with FETI's ΔU, so that there is one path. In a direct solver's run it takes
them from FETI's, which is over: beside each other in one process, the solvers would wear out each
other's memory. Both keep from one tangent to the next what they can: FETI its gluing, its coarse
space and the factors of a few tangents (``feti_lag``), MUMPS its analysis. A tangent that Newton's
method keeps is factored once. FETI is as accurate as each step deserves (``newton``): its residual
in a record is that of the roughest solve. *End to end* is everything from the first to the last
equilibrium, with the linear solves of the run's solver.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from benchmarks.common.bodies import LoadedBody
from benchmarks.common.clock import Events, Stopwatch
from benchmarks.common.records import Record
from benchmarks.compare.opponents import OPPONENTS
from dolfinx_feti import FETI, ConvergenceError, loads
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


def follow(
    body: LoadedBody,
    mmhg: float,
    *,
    direct: Sequence[str] = (),
    another: Callable[[], LoadedBody] | None = None,
) -> list[Record]:
    """Load a body at rest [mmHg], and record what its systems cost FETI and others. Collective.

    Args:
        body: The body, for FETI.
        mmhg: The load at the end.
        direct: Direct solvers.
        another: Creates the same body at rest, once for each of them.

    Returns:
        A record for each solver; ``note`` says why the path or the solver came to no end.
    """
    comm, answers = body.u.function_space.mesh.comm, _Answers()
    ksp = body.problem.solver.getKSP()
    answers.listen(ksp.getPythonContext())
    phases = Events(PHASES, comm)
    watch, its = Stopwatch(comm), list[int]()
    watch.hook(ksp, lambda ksp, _b, _x: its.append(ksp.getIterationNumber()))
    run = _drive(body, mmhg)
    each = watch.each()
    cost = _cost(each, its, run, comm.allreduce(run.seconds, op=MPI.MAX) - each.sum())
    outcome = _outcome(run.residuals, None, run.note)
    feti = {"solver": "feti"} | cost | outcome | {"seconds_phases": phases.seconds()}
    ksp.getPythonContext().destroy()
    found: list[Record] = [feti]
    for name in direct:
        assert another is not None
        body, other = another(), _Direct(name)
        found.append(_follow_again(body, mmhg, answers, other))
        feti["difference_to_mumps"] = feti["difference_to_mumps"] or other.difference
        other.destroy()
    return found


def _follow_again(body: LoadedBody, mmhg: float, answers: _Answers, other: _Direct) -> Record:
    """Follow the path again with FETI's answers; record what its systems cost another solver."""
    problem, comm, beside = body.problem, body.u.function_space.mesh.comm, list[float]()

    def then(_ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        begun = time.perf_counter()
        other.solve(problem.A, b, x)
        beside.append(time.perf_counter() - begun)

    ksp = problem.solver.getKSP()
    ksp.setPythonContext(_Answering(answers))
    ksp.setPostSolve(then)
    run = _drive(body, mmhg)
    rest = comm.allreduce(run.seconds - sum(beside), op=MPI.MAX)
    cost = _cost(np.array(other.seconds), other.iterations, run, rest)
    return {"solver": other.name} | cost | _outcome(other.residuals, 0.0, other.note or run.note)


@dataclass(frozen=True, slots=True)
class _Run:
    """A run along the path: steps and seconds of Newton's method, seconds of all, and its end."""

    load_steps: int
    newton_steps: int
    seconds_assembly: float
    seconds: float
    residuals: list[float]
    note: str


def _drive(body: LoadedBody, mmhg: float) -> _Run:
    """Load a body at rest [mmHg]. Collective."""
    accepted: list[LoadStep] = []
    note, begun = "", time.perf_counter()
    try:
        load(body, mmhg, on_step=accepted.append)
    except ConvergenceError as error:
        note = f"failed: {reason(error)}"
    seconds = time.perf_counter() - begun
    newton = [step for load_step in accepted for step in load_step.all_steps]
    assembly = sum(step.seconds_assembly for step in newton)
    residuals = [step.linear_residual for step in newton]
    return _Run(len(accepted), len(newton), assembly, seconds, residuals, note)


class _Answers:
    """What FETI has answered to each system of a path: what Newton's method sees of it, and x."""

    #: Attributes of FETI that Newton's method looks at.
    SEEN = (
        "message",
        "iterations",
        "residual",
        "rtol",
        "floor",
        "singular",
        "condition_number",
        "age",
        "method",
        "inertia",
    )

    def __init__(self) -> None:
        self.each: list[tuple[dict[str, object], int, npt.NDArray[np.float64]]] = []

    def listen(self, feti: FETI) -> None:
        """Keep all answers from now on."""
        solve = feti.solve

        def solve_and_keep(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
            solve(ksp, b, x)
            seen = {name: getattr(feti, name) for name in self.SEEN}
            self.each.append((seen, ksp.getConvergedReason(), x.array_r.copy()))

        feti.solve = solve_and_keep  # type: ignore[method-assign]


class _Answering:
    """Context of a KSP that gives FETI's answers again, one after the other."""

    def __init__(self, answers: _Answers) -> None:
        self._left = iter(answers.each)

    def renew(self) -> None:
        """Do nothing: FETI has done it."""

    def solve(self, ksp: PETSc.KSP, _b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Give the next answer.

        Raises:
            RuntimeError: There is none: this run asks for more than FETI's did.
        """
        answer = next(self._left, None)
        if answer is None:
            raise RuntimeError("this run of the path goes on where FETI's has ended")
        seen, ended, x.array[:] = answer
        vars(self).update(seen)
        ksp.setIterationNumber(seen["iterations"])
        ksp.setConvergedReason(ended)


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
    each: npt.NDArray[np.float64], iterations: Sequence[int], run: _Run, rest: float
) -> Record:
    """Return what the solves of a run took, each set-up and solution, (solves, 2), and the rest."""
    setup, solve = each.reshape(-1, 2).T
    later = (setup + solve)[1:].sum()
    return {
        "peak_mib": None,
        "newton_iterations": run.newton_steps,
        "load_steps": run.load_steps,
        "seconds_assembly": run.seconds_assembly,
        "linear_solves": len(setup),
        "iterations": sum(iterations),
        "iterations_per_solve": list(iterations),
        "seconds_setup": setup.sum(),
        "seconds_solve": solve.sum(),
        "seconds_per_solve": (setup + solve).tolist(),
        "seconds_end_to_end": rest + (setup + solve).sum(),
        "seconds_per_newton": later / (run.newton_steps - 1) if run.newton_steps > 1 else None,
    }


def _outcome(residuals: Sequence[float], difference: float | None, note: str) -> Record:
    """Return how well the systems were solved, and whether to the end."""
    return {
        "relative_residual": max(residuals, default=None),
        "difference_to_mumps": difference,
        "converged": not note,
        "note": note,
    }
