# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""A load path whose linear systems FETI and MUMPS solve both, each with a time of its own.

.. math:: A(U^k)\, ΔU = -r(U^k), \qquad U^{k+1} = U^k + α\, ΔU

Newton's method goes on with FETI's ΔU, so that there is one path. Both solvers keep from one
tangent to the next what they can: FETI its gluing, its coarse space and the factors of a few
tangents (``feti_lag``), MUMPS its analysis.
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from benchmarks.common.bodies import LoadedBody
from benchmarks.common.clock import Events, Stopwatch
from benchmarks.common.records import Record
from dolfinx_feti import ConvergenceError, loads
from dolfinx_feti.comparison import (
    assembled_system,
    create_mumps,
    relative_difference,
    relative_residual,
    timed_solve,
)
from dolfinx_feti.loading import LoadStep, Steps, follow_load
from dolfinx_feti.runtime.collective import on_all, reason

__all__ = ["PHASES", "SOLVERS", "follow"]

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

#: Solvers of a path: FETI drives Newton's method.
SOLVERS = ("feti", "mumps")

#: As in ``demos/demo_artery.py``: the first load step's share of the path, and the relative
#: tolerances of Newton's method and of FETI before its end.
FIRST, RTOL, LINEAR_RTOL = 0.1, 1e-3, 1e-4


def follow(body: LoadedBody, mmhg: float, *, direct: bool) -> list[Record]:
    """Load a body at rest [mmHg], and record what its systems cost FETI and MUMPS. Collective.

    ``note`` says why the path or a solver came to no end.
    """
    problem, comm = body.problem, body.u.function_space.mesh.comm
    mumps = _Direct() if direct else None
    watch = Stopwatch(comm)
    iterations: list[int] = []

    def then(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        iterations.append(ksp.getIterationNumber())
        if mumps is not None:
            mumps.solve(problem.A, b, x)

    def set_load(value: float) -> None:
        body.load.value = loads.mmhg(value)

    watch.hook(problem.solver.getKSP(), then)
    phases = Events(PHASES, comm)
    first = FIRST * mmhg
    steps = Steps(first, least=first / 64, growth=1.15, quick=4, rtol=RTOL, linear_rtol=LINEAR_RTOL)
    accepted: list[LoadStep] = []
    note = ""
    try:
        follow_load(
            problem, set_load, [mmhg], steps,
            state=[body.u, body.p], on_step=accepted.append, unit="mmHg",
        )  # fmt: skip
    except ConvergenceError as error:
        note = f"failed: {reason(error)}"
    newton = [step for load_step in accepted for step in load_step.all_steps]
    shared: Record = {
        "peak_mib": None,
        "newton_iterations": len(newton),
        "load_steps": len(accepted),
        "seconds_assembly": sum(step.seconds_assembly for step in newton),
    }
    residuals = [step.linear_residual for step in newton]
    difference = None if mumps is None else mumps.difference
    cost = _cost(watch.each(), iterations, len(newton)) | _outcome(residuals, difference, note)
    found = [{"solver": "feti"} | shared | cost | {"seconds_phases": phases.seconds()}]
    if mumps is not None:
        cost = _cost(np.array(mumps.seconds), mumps.iterations, len(newton))
        cost |= _outcome(mumps.residuals, 0.0, mumps.note or note)
        found.append({"solver": "mumps"} | shared | cost)
        mumps.destroy()
    return found


class _Direct:
    """MUMPS on the tangents of a path: analysed once, factored for each."""

    def __init__(self) -> None:
        self.seconds: list[tuple[float, float]] = []  # analysis and factors, solution; each solve
        self.iterations: list[int] = []
        self.residuals: list[float] = []  # ‖f − K x‖/‖f‖
        self.difference: float | None = None  # ‖x_FETI − x‖/‖x‖ of the last solve
        self.note = ""  # why it failed; then it solves no more
        self._K: PETSc.Mat | None = None
        self._ksp: PETSc.KSP | None = None

    def solve(self, A: PETSc.Mat, b: PETSc.Vec, x_feti: PETSc.Vec) -> None:
        """Solve the assembled counterpart of a torn system A x = b. Collective."""
        if self.note:
            return
        K, f = assembled_system(A, b)
        if self._K is None:
            self._K, self._ksp = K, create_mumps(K)
        else:
            K.copy(self._K, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            K.destroy()
            self._ksp.setOperators(self._K)  # the matrix is another one
        x = f.duplicate()
        try:
            cost, _ = on_all(lambda: timed_solve(lambda: self._ksp, f, x), f.comm.tompi4py())
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

    def destroy(self) -> None:
        """Free matrix and factors."""
        for owned in filter(None, (self._ksp, self._K)):
            owned.destroy()


def _cost(each: npt.NDArray[np.float64], iterations: Sequence[int], newton: int) -> Record:
    """Return what the solves of some Newton steps took, each set-up and solution, (solves, 2)."""
    setup, solve = each.reshape(-1, 2).T
    later = (setup + solve)[1:].sum()
    return {
        "linear_solves": len(setup),
        "iterations": sum(iterations),
        "iterations_per_solve": list(iterations),
        "seconds_setup": setup.sum(),
        "seconds_solve": solve.sum(),
        "seconds_per_solve": (setup + solve).tolist(),
        "seconds_per_newton": later / (newton - 1) if newton > 1 else None,
    }


def _outcome(residuals: Sequence[float], difference: float | None, note: str) -> Record:
    """Return how well the systems were solved, and whether to the end."""
    return {
        "relative_residual": max(residuals, default=None),
        "difference_to_mumps": difference,
        "converged": not note,
        "note": note,
    }
