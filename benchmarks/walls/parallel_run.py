# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One run of the scaling study on the processes that mpirun has started.

`benchmarks.scaling` starts it, as ``python3 -m benchmarks.walls.parallel_run CASE FILE``, with the
case as JSON, and reads the record from the file. A run *measures* the load step to 0.2 mmHg, or
*counts*: the tangent at rest is set up once, and solved with a few iterations and with some more;
the difference is what an iteration sends, whatever the machine and however many processes share a
core.
"""

from __future__ import annotations

import json
import logging
import sys
import time
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import petsc4py

petsc4py.init(sys.argv[:1])

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from benchmarks.common.records import Record
from benchmarks.common.repeatable import fix_partitions
from benchmarks.common.traffic import COUNTERS, gather, since_reset, start_count
from benchmarks.walls.newton_case import CHOICES, TANGENTS
from benchmarks.walls.problem import WallProblem, create_wall_problem, right_hand_side
from dolfinx_feti import ConvergenceError, loads, materials
from dolfinx_feti.collective import on_first
from dolfinx_feti.events import seconds_of
from dolfinx_feti.feti.coarse.gathered import GatheredSolver
from dolfinx_feti.wall.fibres import ANGLES, fibre_families, fibre_frame
from meshes.walls import create_wall

__all__ = ["count", "measure"]

Array = npt.NDArray[np.float64]

#: Iterations of the two solves whose difference is counted, after one that makes all buffers.
WARM, FEW, MORE = 2, 5, 25

#: Load [mmHg]; under the paper's, 1 mmHg, a thin wall at rest would buckle.
PRESSURE = 0.2

#: Newton steps at most, the paper's. With its tangent, which leaves out that of the pressure, CG
#: solves their systems, but on a thin wall they come only some way to the solution.
STEPS = 5
TOO_MANY = PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT

#: The coarse solver's own solve, whose calls are counted.
SOLVE = GatheredSolver.solve

#: Phases of the method, by their log events.
EVENTS = {
    "tangent": "FETITangent",
    "gluing": "FETIGluing",
    "factor": "FETIFactor",
    "coarse": "FETICoarse",
    "krylov": "FETISolve",
    "iterations": "FETIIterations",
}


def measure(case: Record, comm: MPI.Comm) -> Record:
    """Measure a load step; seconds are those of the slowest process.

    The same load step on a tiny tube comes before it, so that all forms are compiled, and the mesh
    is generated.

    Note:
        Collective.
    """
    PETSc.Log.begin()
    create_wall(case["geometry"], comm, size=case["size"], folder=Path(str(case["folder"])))
    tiny, _ = _create(case | {"geometry": "tube", "size": 1.0, "subdomains": comm.size}, comm)
    _load(tiny)
    comm.Barrier()
    started = time.perf_counter()
    body, reading = _create(case, comm)
    comm.Barrier()
    created = time.perf_counter()
    before = np.array(seconds_of(EVENTS.values()))
    _load(body)
    comm.Barrier()
    ended = time.perf_counter()
    phases = np.empty(len(EVENTS) + 1)
    assembly = sum(step.seconds_assembly for step in body.problem.history)
    spent = np.array(seconds_of(EVENTS.values())) - before
    comm.Allreduce(np.append(spent, assembly), phases, op=MPI.MAX)
    of = dict(zip([*EVENTS, "assembly"], map(float, phases), strict=True))
    its = [step.linear_iterations for step in body.problem.history]
    return _sizes(body) | {
        "newton_iterations": len(its),
        "linear_iterations_per_newton": its,
        "linear_iterations_mean": float(np.mean(its)),
        "seconds_reading": reading,
        "seconds_input": created - started,
        "seconds_local": of["assembly"] + of["factor"],
        "seconds_coarse": of["coarse"],
        "seconds_krylov": of["krylov"],
        "seconds_total": ended - started,
    }


def count(case: Record, comm: MPI.Comm) -> Record:
    """Count what set-up and iterations send, and how evenly the work is spread.

    Note:
        Collective.
    """
    logging.getLogger("dolfinx_feti").setLevel(logging.CRITICAL)  # it is not to converge
    PETSc.Log.begin()
    body, _ = _create(case, comm)
    body.problem.linearise()
    body.pressure.value = loads.mmhg(PRESSURE)
    b = right_hand_side(body)
    x = b.duplicate()
    ksp = body.problem.solver.getKSP()
    ksp.setOperators(body.problem.A)
    flops = PETSc.Log.getFlops()
    start_count()
    ksp.setUp()
    setup = gather(since_reset(), comm)
    setup_flops = np.array(comm.allgather(PETSc.Log.getFlops() - flops))
    _iterate(ksp, b, x, WARM)
    few = _counted_solve(ksp, b, x, FEW)
    more = _counted_solve(ksp, b, x, MORE)
    each = (more - few) / (MORE - FEW)  # (processes, counters)
    neighbours = more[:, COUNTERS.index("neighbours")]
    coarse = coarse_work(lambda n: _iterate(ksp, b, x, n), comm)
    K = body.problem.A.getISLocalMat()
    entries = np.array(comm.allgather(K.getInfo()["nz_used"]))
    return (
        _sizes(body)
        | coarse
        | {
            "setup": _summary(setup),
            "iteration": _summary(each),
            "neighbours": float(neighbours.max()),
            "balance": {
                "entries of K": _balance(entries),
                "flops of set-up": _balance(setup_flops),
                "flops of an iteration": _balance(each[:, -1]),
                "bytes of an iteration": _balance(each[:, COUNTERS.index("bytes")]),
            },
        }
    )


def _load(body: WallProblem) -> None:
    """Take the load step from rest, or five Newton steps of it.

    Raises:
        ConvergenceError: A linear system was not solved.
    """
    at_rest = body.problem.linearise()
    body.pressure.value = loads.mmhg(PRESSURE)
    try:
        body.problem.solve(first_tangent=at_rest)
    except ConvergenceError:
        if body.problem.solver.getConvergedReason() != TOO_MANY:
            raise


def _create(case: Record, comm: MPI.Comm) -> tuple[WallProblem, float]:
    """Tear the wall of a case; return the problem and the seconds of reading and distributing."""
    started = time.perf_counter()
    folder = Path(str(case["folder"]))
    wall, _ = create_wall(case["geometry"], comm, size=case["size"], folder=folder)
    reading = time.perf_counter() - started
    angles = ANGLES if case["layers"] == 2 else dict.fromkeys(ANGLES, ANGLES["media"])
    own = {"feti_type": case["type"], "feti_pc_type": case["pc"], "snes_max_it": STEPS}
    if case["choices"] == "default" and case["task"] == "count":
        own["feti_formulation"] = "primal"  # that of every Newton step after the first one
    body = create_wall_problem(
        wall,
        degree=case["degree"],
        c=materials.ArteryParameters().c,
        kappa=case["kappa"],
        subdomains=case["subdomains"],
        options=CHOICES[str(case["choices"])] | own,
        fibres=fibre_families(wall, fibre_frame(wall), angles),
        potential=False,
        tangent=TANGENTS[str(case["choices"])],
    )
    return body, reading


def _iterate(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec, iterations: int) -> None:
    """Solve with so many iterations, no fewer."""
    ksp.setTolerances(rtol=1e-30, atol=0.0, max_it=iterations)
    ksp.solve(b, x)
    done = ksp.getPythonContext().iterations
    if done != iterations:
        raise RuntimeError(f"the solver took {done} iterations in place of {iterations}")


def _counted_solve(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec, iterations: int) -> Array:
    """Return counters and flops of a solve, (processes, counters + 1)."""
    before = PETSc.Log.getFlops()
    start_count()
    _iterate(ksp, b, x, iterations)
    sent = since_reset()
    flops = PETSc.Log.getFlops() - before
    comm = ksp.comm.tompi4py()
    return np.hstack([gather(sent, comm), np.array(comm.allgather([flops]))])


def coarse_work(iterate: Callable[[int], object], comm: MPI.Comm) -> Record:
    """Return the coarse solves of an iteration, and what MUMPS tells of the coarse factor.

    Args:
        iterate: Does so many iterations.
        comm: Its processes have the coarse factor.

    Returns:
        ``coarse_solves``, and ``coarse_entries`` and ``coarse_flops``, the entries of the factor
        and the operations that it took.

    Note:
        Collective.
    """
    calls, factor = [], [0.0, 0.0]

    def solve(solver: GatheredSolver, b: PETSc.Vec, x: PETSc.Vec) -> None:
        if solver.ksp is not None:
            F = solver.ksp.getPC().getFactorMatrix()
            entries = F.getMumpsInfog(29)
            factor[:] = entries if entries >= 0 else -1e6 * entries, F.getMumpsRinfog(3)
        SOLVE(solver, b, x)

    with mock.patch.object(GatheredSolver, "solve", autospec=True, side_effect=solve) as counted:
        for iterations in (FEW, MORE):
            counted.reset_mock()
            iterate(iterations)
            calls.append(counted.call_count)
    entries, flops = comm.bcast(factor)
    return {
        "coarse_solves": (calls[1] - calls[0]) / (MORE - FEW),
        "coarse_entries": float(entries),
        "coarse_flops": float(flops),
    }


def _summary(counts: Array) -> Record:
    """Return mean and greatest of each counter over the processes."""
    return {
        name: {"mean": float(column.mean()), "max": float(column.max())}
        for name, column in zip(COUNTERS, counts.T, strict=False)
    }


def _balance(values: Array) -> float:
    """Return the greatest over the mean."""
    return float(values.max() / values.mean()) if values.mean() > 0.0 else 1.0


def _sizes(body: WallProblem) -> Record:
    report = body.problem.solver.getKSP().getPythonContext().report()
    return {
        "dofs": body.dofs,
        "subdomains_in_all": report.subdomains,
        "multipliers": report.multipliers,
        "coarse_size": report.coarse_size,
        "coarse_mib": report.coarse_mib,
        "formulation": report.formulation,
    }


def main(words: list[str]) -> None:
    """Run a case, and write its record."""
    comm = MPI.COMM_WORLD
    fix_partitions()
    case = json.loads(words[0])
    record = {"measure": measure, "count": count}[case["task"]](case, comm)
    on_first(lambda: Path(words[1]).write_text(json.dumps(record)), comm)


if __name__ == "__main__":
    main(sys.argv[1:])
