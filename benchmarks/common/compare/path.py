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

# Settings of load steps, as in ``demos/demo_artery.py``.

#: Increment of the first load step over the load at the end of the path.
FIRST_INCREMENT = 0.1
#: Relative tolerance of Newton's method before the end of the path.
NEWTON_RTOL = 1e-3
#: Relative tolerance of FETI before the end of the path.
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
    first = FIRST_INCREMENT * mmhg
    steps = Steps(
        first, least=first / 64, growth=1.15, quick=4, rtol=NEWTON_RTOL, linear_rtol=LINEAR_RTOL
    )
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
    direct_solvers = [_DirectSolver(name) for name in direct]
    feti = _LinearSolves("feti")
    seconds_of_direct = 0.0
    watch = Stopwatch(comm)

    def solve_directly(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        nonlocal seconds_of_direct
        started = time.perf_counter()
        feti.iterations.append(ksp.getIterationNumber())
        for solver in direct_solvers:
            solver.solve(body.problem.A, b, x)
        seconds_of_direct += time.perf_counter() - started

    watch.hook(body.problem.solver.getKSP(), solve_directly)
    load_steps: list[LoadStep] = []
    note = ""
    started = time.perf_counter()
    try:
        load(body, mmhg, on_step=load_steps.append)
    except ConvergenceError as error:
        note = f"failed: {error_message(error)}"
    seconds = comm.allreduce(time.perf_counter() - started - seconds_of_direct, op=MPI.MAX)
    newton_steps = [step for load_step in load_steps for step in load_step.all_steps]
    feti.seconds = watch.wall_times().tolist()
    feti.residuals = [step.linear_residual for step in newton_steps]
    feti.difference = direct_solvers[0].feti_difference if direct_solvers else None
    of_path = {
        "newton_iterations": len(newton_steps),
        "load_steps": len(load_steps),
        "peak_mib": None,
        "seconds_assembly": sum(step.seconds_assembly for step in newton_steps),
    }
    rest = seconds - watch.wall_times().sum()  # assembly, line search, update
    records = [
        of_path | solves.record(len(newton_steps), rest, note)
        for solves in (feti, *(solver.solves for solver in direct_solvers))
    ]
    for solver in direct_solvers:
        solver.destroy()
    return records


@dataclass(slots=True)
class _LinearSolves:
    """Cost and accuracy of one solver's linear solves on a path.

    Attributes:
        solver: Name of the solver.
        seconds: Set-up and solution of each solve [s].
        iterations: Iterations of each solve.
        residuals: ‖f − K x‖/‖f‖ of each solve.
        difference: Relative difference to the direct solution of the last system.
        note: Why the solver failed; empty if it did not.
    """

    solver: str
    seconds: list[tuple[float, float]] = field(default_factory=list)
    iterations: list[int] = field(default_factory=list)
    residuals: list[float] = field(default_factory=list)
    difference: float | None = 0.0
    note: str = ""

    def record(self, newton_steps: int, rest: float, path_note: str) -> Record:
        """Return the record of this solver.

        Args:
            newton_steps: Number of Newton steps on the path.
            rest: Seconds of the path without linear solves.
            path_note: Why the path ended early; empty if it did not.
        """
        note = self.note or path_note
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
            "seconds_per_newton": later / (newton_steps - 1) if newton_steps > 1 else None,
            "relative_residual": max(self.residuals, default=None),
            "difference_to_mumps": self.difference,
            "converged": not note,
            "note": note,
        }


class _DirectSolver:
    """A direct solver on the tangents of a path: analysed once, factored for each.

    The solves of the path are in ``solves``. ``feti_difference`` is ‖x_FETI − x‖/‖x‖ of the last
    one, or None.
    """

    def __init__(self, name: str) -> None:
        """Create a solver without a matrix.

        Args:
            name: A key of ``OPPONENTS``.
        """
        self.solves = _LinearSolves(name)
        self.feti_difference: float | None = None
        self._options = OPPONENTS[name].options
        self._K: PETSc.Mat | None = None
        self._version: MatrixVersion | None = None  # of the torn matrix that K was assembled from
        self._ksp: PETSc.KSP | None = None

    def solve(self, A: PETSc.Mat, b: PETSc.Vec, x_feti: PETSc.Vec) -> None:
        """Solve the assembled counterpart of a torn system, unless this solver failed. Collective.

        Args:
            A: Torn matrix.
            b: Right-hand side.
            x_feti: FETI's solution, with which this one is compared.
        """
        if self.solves.note:
            return
        f = self._assemble(A, b)
        x = f.duplicate()
        try:
            cost, self._ksp = on_all(lambda: timed_solve(self._create_ksp, f, x), f.comm.tompi4py())
        except PETSc.Error as error:
            self.solves.note = f"failed: {error_message(error)}"
        else:
            if cost.converged_reason > 0:
                self.solves.seconds.append((cost.seconds_setup, cost.seconds_solve))
                self.solves.iterations.append(cost.iterations)
                self.solves.residuals.append(relative_residual(self._K, f, x))
                self.feti_difference = relative_difference(x_feti, x)
            else:
                self.solves.note = f"failed: PETSc's reason {cost.converged_reason}"
        f.destroy()
        x.destroy()

    def _assemble(self, A: PETSc.Mat, b: PETSc.Vec) -> PETSc.Vec:
        """Assemble the system, and return its right-hand side, which the caller destroys.

        PETSc factors a matrix anew whenever it has been written to, so K is left alone while the
        tangent is the same.
        """
        local = A.getISLocalMat()
        state = local.stateGet()
        K, f = assembled_system(A, b)
        local.stateSet(state)  # it was only read, though PETSc counts a change
        if self._K is None:
            self._K = K
        else:
            if version_of(A) != self._version:
                K.copy(self._K, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            K.destroy()
        self._version = version_of(A)
        if self._ksp is not None:
            self._ksp.setOperators(self._K)
        return f

    def _create_ksp(self) -> PETSc.KSP:
        """Return the KSP of the last solve, or a new one."""
        return self._ksp or create_solver(self._K, self.solves.solver, self._options)

    def destroy(self) -> None:
        """Free matrix and factors."""
        for owned in filter(None, (self._ksp, self._K)):
            owned.destroy()
