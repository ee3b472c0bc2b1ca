# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""One run of the scaling study on the processes that mpirun has started.

`benchmarks.scaling` starts it as ``python3 -m benchmarks.common.scaling.worker CASE FILE``, with
the case as JSON, and reads the record from the file. A run either *measures* the load step to 0.2
mmHg, or *counts*. To count, it sets up the tangent at rest once, and solves with a few iterations
and with more of them. The difference is what an iteration sends. It depends neither on the machine
nor on how many processes share a core.

The case has the keys that :mod:`benchmarks.scaling` yields (``task``, ``geometry``, ``size``,
``layers``, ``degree``, ``kappa``, ``choices``, ``type``, ``pc``, ``subdomains``), and the
``folder`` of the meshes.
"""

from __future__ import annotations

import json
import logging
import re
import sys
import time
from pathlib import Path

import petsc4py

petsc4py.init(sys.argv[:1])

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from benchmarks.common.bodies import Body
from benchmarks.common.clock import event_clock
from benchmarks.common.records import Record
from benchmarks.common.scaling.traffic import COUNTERS, counted
from benchmarks.common.walls import first_step
from dolfinx_feti import FETI
from dolfinx_feti.comparison import PeakMemory
from dolfinx_feti.feti.coarse.fronts import SharedFronts
from dolfinx_feti.feti.coarse.group import GroupFactor
from dolfinx_feti.feti.coarse.inverse import RowsOfInverse
from dolfinx_feti.meshes.walls import open_wall
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.runtime.collective import on_root
from dolfinx_feti.wall import Wall, read_wall, write_wall

#: Iterations of a first solve, which creates all buffers.
WARM_UP_ITERATIONS = 2

#: Iterations of the two solves whose difference is counted.
FEW_ITERATIONS = 5
MANY_ITERATIONS = 25

#: Load [mmHg]. The paper's load of 1 mmHg would make a thin wall buckle.
PRESSURE = 0.2

#: Most Newton steps, as in the paper. With the paper's tangent, which leaves out that of the
#: pressure, CG solves their systems, but on a thin wall Newton's method has not converged by then.
NEWTON_STEPS = 5

#: Log events of the phases.
FACTOR, COARSE, KRYLOV = EVENTS = ("FETIFactor", "FETICoarse", "FETISolve")

#: Log events of reading the wall.
READING = ("WallRead", "WallPartition", "WallTags")
#: Log events before the first load step.
ONCE = (*READING, "WallFibres", "FETITear", "FETIPattern", "FETIGluing", "FETICoarseSolve")


def measure(case: Record, comm: MPI.Comm) -> Record:
    """Measure a load step; seconds are those of the slowest process. Collective.

    Before the clock starts, the mesh is generated, and the same load step of a tiny tube compiles
    all forms. The second such step gives ``seconds_fixed``, which does not depend on the mesh.
    """
    PETSc.Log.begin()
    tiny = case | {"geometry": "tube", "size": 1.0, "subdomains": comm.size}
    tube = _wall_file(tiny, comm)
    file = _wall_file(case, comm)
    for _ in range(2):  # the second time for what does not depend on the mesh
        comm.Barrier()
        started = time.perf_counter()
        first_step.load(_create(tiny, read_wall(tube, comm)), PRESSURE, allow_max_steps=True)
        fixed = time.perf_counter() - started
    comm.Barrier()
    started = time.perf_counter()
    phases = event_clock((*EVENTS, *ONCE), comm)
    body = _create(case, read_wall(file, comm))
    first_step.load(body, PRESSURE, allow_max_steps=True)
    comm.Barrier()
    ended = time.perf_counter()
    spent = phases()
    seconds_assembly = sum(step.seconds_assembly for step in body.problem.history)
    assembly = comm.allreduce(seconds_assembly, op=MPI.MAX)
    iterations = [step.linear_iterations for step in body.problem.history]
    return first_step.sizes(body) | {
        "newton_iterations": len(iterations),
        "linear_iterations_per_newton": iterations,
        "linear_iterations_mean": float(np.mean(iterations)),
        "seconds_reading": sum(spent[name] for name in READING),
        "seconds_once": {name: spent[name] for name in ONCE},
        "seconds_fixed": fixed,
        "seconds_local": assembly + spent[FACTOR],
        "seconds_coarse": spent[COARSE],
        "seconds_krylov": spent[KRYLOV],
        "seconds_total": ended - started,
    }


def count(case: Record, comm: MPI.Comm) -> Record:
    """Count what each process sends in reading, set-up and an iteration. Collective."""
    logging.getLogger("dolfinx_feti").setLevel(logging.CRITICAL)  # it is not to converge
    PETSc.Log.begin()
    walls: list[Wall] = []  # the one that is read
    tube = _wall_file(case | {"geometry": "tube", "size": 1.0}, comm)
    file = _wall_file(case, comm)
    read_wall(tube, comm)  # loads libraries and creates buffers
    peak = PeakMemory()
    before = _bytes_read()
    reading = counted(lambda: walls.append(read_wall(file, comm)), comm)
    mib = comm.allreduce(peak.mib_above_start(MPI.COMM_SELF), op=MPI.MAX)
    bytes_read = comm.allreduce(_bytes_read() - before, op=MPI.MAX)
    body = _create(case, walls[0])
    body.problem.linearise()
    b = body.problem.A.createVecLeft()
    b.setRandom()
    x = b.duplicate()
    ksp = body.problem.solver.getKSP()
    ksp.setOperators(body.problem.A)
    setup = counted(ksp.setUp, comm)
    _iterate(ksp, b, x, WARM_UP_ITERATIONS)
    first = _coarse_solves()
    few = counted(lambda: _iterate(ksp, b, x, FEW_ITERATIONS), comm)
    middle = _coarse_solves()
    many = counted(lambda: _iterate(ksp, b, x, MANY_ITERATIONS), comm)
    last = _coarse_solves()
    each = (many - few) / (MANY_ITERATIONS - FEW_ITERATIONS)  # (processes, counters)
    solves = ((last - middle) - (middle - first)) / (MANY_ITERATIONS - FEW_ITERATIONS)
    entries, flops = comm.bcast(coarse_factor(ksp.getPythonContext()))
    neighbours = many[:, COUNTERS.index("neighbours")]
    messages = each[:, COUNTERS.index("messages")]
    return first_step.sizes(body) | {
        "coarse_solves": solves,
        "coarse_entries": entries,
        "coarse_flops": flops,
        "setup": _summary(setup),
        "iteration": _summary(each),
        "reading": _summary(reading),
        "reading_mib": mib,
        "reading_bytes": bytes_read,
        "neighbours": float(neighbours.max()),
        "neighbours_mean": float(neighbours.mean()),
        "messages_to_each": float(messages.sum() / max(neighbours.sum(), 1.0)),
    }


def _bytes_read() -> int:
    """Return the bytes that this process has read by system calls."""
    return int(re.search(r"rchar:\s+(\d+)", Path("/proc/self/io").read_text())[1])


def _wall_file(case: Record, comm: MPI.Comm) -> Path:
    """Return the file of a case's wall for this number of processes; write it if it is missing."""
    folder = Path(case["folder"])
    name = f"{case['geometry']}_{case['size']}_{comm.size}"
    path = folder / f"{name}.xdmf"
    if not comm.bcast(path.is_file()):
        wall, _ = open_wall(case["geometry"], comm, size=case["size"], folder=folder)
        write_wall(path, wall)
    return path


def _create(case: Record, wall: Wall) -> Body:
    """Create the problem of a case on its wall."""
    options = {"feti_type": case["type"], "feti_pc_type": case["pc"], "snes_max_it": NEWTON_STEPS}
    if case["choices"] == "default" and case["task"] == "count":
        options["feti_formulation"] = "primal"  # that of every Newton step after the first one
    return first_step.create(wall, case, case["subdomains"], options)


def _iterate(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec, iterations: int) -> None:
    """Solve with exactly this number of iterations.

    Raises:
        RuntimeError: The solver took another number.
    """
    ksp.setTolerances(rtol=1e-30, atol=0.0, max_it=iterations)
    ksp.solve(b, x)
    done = ksp.getPythonContext().iterations
    if done != iterations:
        raise RuntimeError(f"the solver took {done} iterations in place of {iterations}")


def coarse_factor(feti: FETI) -> tuple[float, float]:
    """Return the entries and flops of the factor of the coarse matrix; zeros without a factor."""
    factor = getattr(feti.formulation.coarse.solver, "factor", None)
    if isinstance(factor, RowsOfInverse):
        factor = factor.factor
    if isinstance(factor, SharedFronts):
        return float(factor.fronts.factor_entries), float(factor.fronts.flops)
    if isinstance(factor, GroupFactor) and factor.ksp is not None:
        F = factor.ksp.getPC().getFactorMatrix()
        entries = F.getMumpsInfog(29)
        return float(entries if entries >= 0 else -1e6 * entries), F.getMumpsRinfog(3)
    return 0.0, 0.0


def _coarse_solves() -> int:
    """Return the coarse solves of this process so far."""
    return PETSc.Log.Event("FETICoarseSolve").getPerfInfo()["count"]


def _summary(counts: Array) -> Record:
    """Return mean and greatest of each counter over the processes."""
    return {
        name: {"mean": float(column.mean()), "max": float(column.max())}
        for name, column in zip(COUNTERS, counts.T, strict=True)
    }


if __name__ == "__main__":
    comm = MPI.COMM_WORLD
    case = json.loads(sys.argv[1])
    record = {"measure": measure, "count": count}[case["task"]](case, comm)
    on_root(lambda: Path(sys.argv[2]).write_text(json.dumps(record)), comm)
