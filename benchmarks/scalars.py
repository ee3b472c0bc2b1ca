# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""What volumes cost beside given pressures, and three ways to solve bordered systems.

    mpirun -n 2 python3 -m benchmarks.scalars --part speed --json build/scalars.json
    python3 -m benchmarks.scalars --part ways --json build/scalars.json

*speed*: a body is inflated in two steps by given pressures, then by the volumes that these have
reached in none, one or all of its cavities. The second step counts, by processor time. *ways*: one
linear system on an octant of a balloon, with a random load, at states where K is regular, singular
at the limit point, and indefinite behind it, and of a body that nothing supports; and all Newton
steps of a path through these states. One process.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator, Sequence

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl

from benchmarks.common import command
from benchmarks.common.bordered import WAYS, System, Way, measure
from benchmarks.common.cavities import create_balloon, create_block, create_tube
from benchmarks.common.pages import Fields, groups
from benchmarks.common.records import Record
from benchmarks.common.study import Keep, Study
from dolfinx_feti import NonlinearProblem
from dolfinx_feti.fem.compiler import Compiler
from dolfinx_feti.scalars import rigid_motions
from dolfinx_feti.scalars.border import ScalarSystem

__all__ = ["BODIES", "STATES", "STUDY"]

#: Bodies, and the given pressures of the last step [kPa].
BODIES = {"tube": (create_tube, (0.15,)), "block": (create_block, (0.2, 0.1, 0.2, 0.1))}

#: Stretches of the balloon's inner radius up to each state; None for no support.
STATES = {
    "regular": (1.1, 1.2),
    "limit point": (1.15, 1.3, 1.42638),
    "indefinite": (1.2, 1.4, 1.6, 1.8, 2.0),
    "no support": None,
}

#: Of a path through the limit point.
PATH = (1.1, 1.2, 1.3, 1.4, 1.5, 1.65, 1.85, 2.15, 2.5)


#: What the page says of a state.
NAMES = {
    "regular": "K regular",
    "limit point": "limit point",
    "indefinite": "one negative eigenvalue",
    "no support": "no support, six means",
}

COUNTS = ("newton_steps", "linear_iterations")


def _options(parser: argparse.ArgumentParser) -> None:
    add, states = parser.add_argument, [*STATES, "path"]
    add("--part", type=command.some_of(["speed", "ways"]), default=["speed", "ways"])
    add("--body", type=command.some_of(list(BODIES)), default=list(BODIES), help=",".join(BODIES))
    add("--state", type=command.some_of(states), default=states, help=",".join(states))


def _cases(
    args: argparse.Namespace, parser: argparse.ArgumentParser, comm: MPI.Comm
) -> Iterator[Record]:
    if "speed" in args.part:
        for body in args.body:
            for m in sorted({0, 1, len(BODIES[body][1])}):
                yield {"study": "speed", "body": body, "scalars": m, "processes": comm.size}
    if "ways" in args.part:
        if comm.size > 1:
            parser.error("argument --part: ways are measured on one process, speed on any number")
        for state, way in itertools.product(args.state, WAYS):
            yield {"study": "ways", "state": state, "way": way}


def _run(case: Record, keep: Keep, _args: argparse.Namespace, comm: MPI.Comm) -> None:
    ways = _followed if case.get("state") == "path" else _solved
    keep({}, (_inflated if case["study"] == "speed" else ways)(case, comm))


def _line(record: Record) -> str:
    names = ("body", "processes", "scalars", "state", "way", "newton_steps", "iterations")
    what = ", ".join(f"{name} {record[name]}" for name in names if name in record)
    return f"{what}: {record['cpu_seconds']:.2f} s"


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


def _solved(key: Record, comm: MPI.Comm) -> Record:
    """Solve the bordered system of a state in one way."""
    stretches = STATES[str(key["state"])]
    body = create_balloon(comm, held=stretches is not None)
    V = body.u.function_space
    if stretches is None:
        scalars, work = rigid_motions(body.u), body.energy
        soft = 0.01 * ufl.inner(body.u, body.u) / 2 * ufl.dx  # kPa/mm²
        problem, regular = (
            body.problem([], subdomains=8),
            body.problem([], extra=soft, subdomains=8),
        )
    else:
        (scalars,), work = body.cavities, body.energy
        problem = regular = body.problem([scalars], subdomains=8)
        rest = scalars.present_volume()
        for stretch in stretches:
            scalars.volume.value = rest * stretch**3
            problem.solve()
    F = ufl.derivative(work, body.u, ufl.TestFunction(V)) + scalars.equation.work
    A, b = problem.linear_system()
    mask = np.ones(b.getLocalSize(), dtype=bool)
    system = ScalarSystem([scalars], body.u, F, Compiler(comm), free=mask)
    system.linearise()
    random = np.random.default_rng(0)
    load = random.standard_normal(len(mask))
    d = random.standard_normal(system.size) * np.linalg.norm(system.border.C, axis=0) * 0.01
    given = System(A, regular.linear_system()[0], regular.create_linear_solver(), system.border,
                   load, d)  # fmt: skip
    return measure(str(key["way"]), given)


def _followed(key: Record, comm: MPI.Comm) -> Record:
    """Fill the balloon through its limit point, each linear system solved in one way."""
    body = create_balloon(comm)
    (cavity,) = body.cavities
    problem, rest = body.problem([cavity], subdomains=8), cavity.present_volume()
    if key["way"] != "elimination":
        problem._system.scalars._solver = Way(str(key["way"]))
    total: dict[str, float] = {}
    for stretch in PATH:
        cavity.volume.value = rest * stretch**3
        for name, value in _timed(problem, comm).items():
            total[name] = total.get(name, 0) + float(str(value))
    return dict(total)


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each state and each body, and the path."""
    states = groups([r for r in records if r["study"] == "ways"], "state")
    rows = {state: {str(r["way"]): r for r in mine} for (state,), mine in states}
    speed = [r for r in records if r["study"] == "speed"]
    ratios = []
    for (body, processes), mine in groups(speed, "body", "processes"):
        at = {int(r["scalars"]): r for r in mine}
        seconds = {m: float(r["cpu_seconds"]) for m, r in at.items()}
        ratios.append(
            {"body": body, "processes": processes, "dofs": at[0]["dofs"]}
            | {name: ", ".join(str(at[m][name]) for m in sorted(at)) for name in COUNTS}
            | {"ratio": {m: f"{each / seconds[0]:.2f}" for m, each in seconds.items()}}
        )
    return {
        "states": [{"name": NAMES[s], "way": rows[s]} for s in NAMES if s in rows],
        "path": rows.get("path"),
        "speed": ratios,
    }


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="scalars",
    known=lambda record: record.get("study") in ("speed", "ways"),
    options=_options,
    cases=_cases,
    run=_run,
    line=_line,
    fields=_fields,
)

if __name__ == "__main__":
    STUDY.main()
