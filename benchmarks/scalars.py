# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What volumes cost beside given pressures.

    mpirun -n 2 python3 -m benchmarks.scalars --json build/scalars.json

A body is inflated in two steps by given pressures, then by the volumes that these have reached in
none, one or all of its cavities. The second step counts, by processor time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence

from mpi4py import MPI

import dolfinx

from benchmarks.common import command
from benchmarks.common.cavities import create_block, create_tube
from benchmarks.common.pages import Fields, groups
from benchmarks.common.records import Record
from benchmarks.common.study import Study
from dolfinx_feti import NonlinearProblem

__all__ = ["BODIES", "STUDY"]

#: Bodies, and the given pressures of the last step [kPa].
BODIES = {"tube": (create_tube, (0.15,)), "block": (create_block, (0.2, 0.1, 0.2, 0.1))}

COUNTS = ("newton_steps", "linear_iterations")


def _cases(
    args: argparse.Namespace, _parser: argparse.ArgumentParser, comm: MPI.Comm
) -> Iterator[Record]:
    for body in args.body:
        for m in sorted({0, 1, len(BODIES[body][1])}):
            yield {"study": "speed", "body": body, "scalars": m, "processes": comm.size}


def _inflated(key: Record, comm: MPI.Comm) -> Record:
    """Inflate a body by pressures, then again with volumes in the first cavities in their place."""
    create, last = BODIES[str(key["body"])]
    body, m = create(comm), int(str(key["scalars"]))
    pressures = [dolfinx.fem.Constant(body.u.function_space.mesh, 0.0) for _ in last]
    steps = (0.5, 1.0)
    reference = body.problem([], dict(enumerate(pressures)))
    volumes, record = [], {}
    for share in steps:
        for constant, pressure in zip(pressures, last, strict=True):
            constant.value = share * pressure
        record = _timed(reference, comm)
        volumes.append([cavity.present_volume() for cavity in body.cavities])
    if m:
        body.u.x.array[:] = body.p.x.array[:] = 0.0
        rest = {k: pressures[k] for k in range(m, len(last))}
        problem = body.problem(body.cavities[:m], rest)
        for share, reached in zip(steps, volumes, strict=True):
            for k, constant in enumerate(pressures):
                constant.value = share * last[k]
                body.cavities[k].volume.value = reached[k]
            record = _timed(problem, comm)
        record["pressure_error"] = max(
            abs(float(body.cavities[k].pressure.value) / last[k] - 1.0) for k in range(m)
        )
    V = body.u.function_space
    return record | {"dofs": V.dofmap.index_map.size_global * V.dofmap.index_map_bs}


def _timed(problem: NonlinearProblem, comm: MPI.Comm) -> Record:
    """Solve; return Newton steps, linear iterations and the processor time of all processes."""
    before = time.process_time()
    problem.solve()
    return {
        "cpu_seconds": comm.allreduce(time.process_time() - before),
        "newton_steps": len(problem.history),
        "linear_iterations": sum(step.linear_iterations for step in problem.history),
    }


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each body and number of processes."""
    rows = []
    for (body, processes), mine in groups(records, "body", "processes"):
        at = {int(r["scalars"]): r for r in mine}
        seconds = {m: float(r["cpu_seconds"]) for m, r in at.items()}
        rows.append(
            {"body": body, "processes": processes, "dofs": at[0]["dofs"]}
            | {name: ", ".join(str(at[m][name]) for m in sorted(at)) for name in COUNTS}
            | {"ratio": {m: f"{each / seconds[0]:.2f}" for m, each in seconds.items()}}
        )
    return {"speed": rows}


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="scalars",
    known=lambda record: record.get("study") == "speed",
    options=lambda parser: command.add_choices(parser, "--body", list(BODIES)),
    cases=_cases,
    run=lambda case, keep, _args, comm: keep({}, _inflated(case, comm)),
    fields=_fields,
)

if __name__ == "__main__":
    STUDY.main()
