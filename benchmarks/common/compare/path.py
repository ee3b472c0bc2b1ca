# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A load path whose linear systems FETI and direct solvers solve.

.. math:: A(U^k)\, ΔU = -r(U^k), \qquad U^{k+1} = U^k + α\, ΔU

Newton's method uses FETI's ΔU. The other solvers solve each system after FETI. They analyse the
matrix once, and keep their factors while Newton's method keeps its tangent. *End to end* is the
time from the first to the last equilibrium, with the linear solves of one solver.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

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
from dolfinx_feti.runtime.collective import error_message, on_all
from dolfinx_feti.torn.matrix import MatrixVersion, version_of

#: Solvers of a path: FETI drives Newton's method, and tangents may be indefinite on the way.
SOLVERS = ("feti", "mumps", "pardiso")

#: As in ``demos/demo_artery.py``: the first load step's share of the path, and the relative
#: tolerances of Newton's method and of FETI before its end.
FIRST = 0.1
RTOL = 1e-3
LINEAR_RTOL = 1e-3


def load(
    body: Body,
    mmhg: float,
    checkpoint: Checkpoint | None = None,
    on_step: Callable[[LoadStep], object] = lambda _step: None,
) -> None:
    """Load a wall at rest, or continue from a checkpoint. Collective.

    Args:
        body: The wall.
        mmhg: Pressure at the end of the path [mmHg].
        checkpoint: Where states are kept; None for none.
        on_step: Called after each load step.
    """
    first = FIRST * mmhg
    steps = Steps(first, least=first / 64, growth=1.15, quick=4, rtol=RTOL, linear_rtol=LINEAR_RTOL)
    body.inflate([mmhg], steps, on_step=on_step, checkpoint=checkpoint, unit="mmHg")


def follow(body: Body, mmhg: float, *, direct: Sequence[str] = ()) -> list[Record]:
    """Load a wall at rest, and measure what its linear systems cost each solver. Collective.

    Args:
        body: The wall.
        mmhg: Pressure at the end of the path [mmHg].
        direct: Names of the direct solvers that solve the same systems.

    Returns:
        A record for each solver, FETI first; ``note`` has the reason if the path or the solver
        failed.
    """
    comm = body.u.function_space.mesh.comm
    others = [_Direct(name) for name in direct]
    feti = _Solves("feti")
    seconds_of_others = 0.0
    watch = Stopwatch(comm)

    def then(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        nonlocal seconds_of_others
        begun = time.perf_counter()
        feti.iterations.append(ksp.getIterationNumber())
        for other in others:
            other.solve(body.problem.A, b, x)
        seconds_of_others += time.perf_counter() - begun

    watch.hook(body.problem.solver.getKSP(), then)
    accepted: list[LoadStep] = []
    note = ""
    begun = time.perf_counter()
    try:
        load(body, mmhg, on_step=accepted.append)
    except ConvergenceError as error:
        note = f"failed: {error_message(error)}"
    seconds = comm.allreduce(time.perf_counter() - begun - seconds_of_others, op=MPI.MAX)
    newton = [step for load_step in accepted for step in load_step.all_steps]
    feti.seconds = watch.each().tolist()
    feti.residuals = [step.linear_residual for step in newton]
    feti.difference = next((other.last for other in others), None)
    whole = {"newton_iterations": len(newton), "load_steps": len(accepted), "peak_mib": None}
    whole |= {"seconds_assembly": sum(step.seconds_assembly for step in newton)}
    rest = seconds - watch.each().sum()  # assembly, line search, update
    found = [whole | solves.record(len(newton), rest, note) for solves in (feti, *others)]
    for other in others:
        other.destroy()
    return found


@dataclass(slots=True)
class _Solves:
    """Seconds, iterations and residuals of one solver on a path."""

    solver: str
    seconds: list[tuple[float, float]] = field(default_factory=list)  # set-up, solution
    iterations: list[int] = field(default_factory=list)
    residuals: list[float] = field(default_factory=list)  # ‖f − K x‖/‖f‖
    difference: float | None = 0.0  # to the direct solution of the last system
    note: str = ""  # why it failed

    def record(self, newton: int, rest: float, note: str) -> Record:
        """Return the record of this solver.

        Args:
            newton: Number of Newton steps on the path.
            rest: Seconds of the path without linear solves.
            note: Why the path ended early; empty if it did not.
        """
        note = self.note or note
        setup, solve = np.reshape(self.seconds, (-1, 2)).T
        later = (setup + solve)[1:].sum()
        return {
            "solver": self.solver,
            "linear_solves": len(setup),
            "iterations": sum(self.iterations),
            "iterations_per_solve": self.iterations,
            "seconds_setup": setup.sum(),
            "seconds_solve": solve.sum(),
            "seconds_end_to_end": rest + setup.sum() + solve.sum(),
            "seconds_per_newton": later / (newton - 1) if newton > 1 else None,
            "relative_residual": max(self.residuals, default=None),
            "difference_to_mumps": self.difference,
            "converged": not note,
            "note": note,
        }


@dataclass(slots=True)
class _Direct(_Solves):
    """A direct solver on the tangents of a path: analysed once, factored for each."""

    last: float | None = None  # ‖x_FETI − x‖/‖x‖ of the last solve
    K: PETSc.Mat | None = None
    version: MatrixVersion | None = None  # of the torn matrix behind it
    ksp: PETSc.KSP | None = None

    def solve(self, A: PETSc.Mat, b: PETSc.Vec, x_feti: PETSc.Vec) -> None:
        """Solve the assembled counterpart of a torn system, unless this solver failed. Collective.

        Args:
            A: Torn matrix.
            b: Right-hand side.
            x_feti: FETI's solution, with which this one is compared.
        """
        if self.note:
            return
        local = A.getISLocalMat()
        before = local.stateGet()
        K, f = assembled_system(A, b)
        local.stateSet(before)  # it was only read, though PETSc counts a change
        if self.K is None:
            self.K = K
        else:
            # PETSc factors a matrix anew that has been written to.
            if version_of(A) != self.version:
                K.copy(self.K, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            K.destroy()
        self.version = version_of(A)
        if self.ksp is not None:
            self.ksp.setOperators(self.K)  # perhaps the matrix is another one
        x = f.duplicate()
        try:
            cost, self.ksp = on_all(lambda: timed_solve(self._create, f, x), f.comm.tompi4py())
        except PETSc.Error as error:
            self.note = f"failed: {error_message(error)}"
        else:
            if cost.converged_reason > 0:
                self.seconds.append((cost.seconds_setup, cost.seconds_solve))
                self.iterations.append(cost.iterations)
                self.residuals.append(relative_residual(self.K, f, x))
                self.last = relative_difference(x_feti, x)
            else:
                self.note = f"failed: PETSc's reason {cost.converged_reason}"
        f.destroy()
        x.destroy()

    def _create(self) -> PETSc.KSP:
        return self.ksp or create_solver(self.K, self.solver, OPPONENTS[self.solver].options)

    def destroy(self) -> None:
        """Free matrix and factors."""
        for owned in filter(None, (self.ksp, self.K)):
            owned.destroy()
