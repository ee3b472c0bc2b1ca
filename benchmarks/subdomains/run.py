# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""How many subdomains: the time of the first linear solve over the dofs of a subdomain.

    python3 -m benchmarks.subdomains --case tube,cube1 --dofs 30000 --json build/subdomains.json

Bodies: the two-layer `tube` and `vessel` and the nearly incompressible `block`, all P2–P0 with
κ = 1000 kPa; the compressible `cube1` and `cube2`, P1 and P2; the compressible `square1`, P1, in
two dimensions; Poisson's equation on a cube, `heat1`, P1. For each the number of subdomains goes
through the steps of --per, dofs of a subdomain. `seconds_cpu` is processor time of set-up and
solution on the slowest process, which a machine with other work to do falsifies least; a repeated
case keeps its least. `ratio` is that time over the best of its body, size and number of processes.

A case that is in the file is not run again, unless by --again.
"""

from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

from mpi4py import MPI

from benchmarks.common import command
from benchmarks.common.bodies import create_block, create_cube, create_heated_cube
from benchmarks.common.records import Record
from benchmarks.common.walls import clamped
from benchmarks.common.walls.problem import WallProblem
from dolfinx_feti import LinearProblem, NonlinearProblem, loads
from dolfinx_feti.comparison import measure
from meshes.arguments import count

__all__ = ["CASES", "main", "ratio"]

KAPPA = 1000.0  # kPa
PER = (250, 500, 1000, 1500, 2000, 3000, 4500, 7000)
Problem = LinearProblem | NonlinearProblem


def main(argv: Sequence[str] | None = None, comm: MPI.Comm = MPI.COMM_WORLD) -> list[Record]:
    """Run the sweep; return its records, also those that the file had. Collective."""
    parser = command.create_parser("subdomains", __doc__, comm)
    add = parser.add_argument
    add("--case", type=command.some_of(list(CASES)), default=list(CASES), help=",".join(CASES))
    add(
        "--dofs",
        type=command.several(count),
        default=[30_000],
        help="approximate number of dofs; 30000",
    )
    add("--per", type=command.several(count), default=list(PER), help="dofs of a subdomain")
    add("--repeat", type=count, default=2, help="solves of which the fastest counts; 2")
    command.add_records(parser)
    args = command.parse_words(parser, argv)
    file = command.open_records(args.json, parser, comm)
    found = []
    for case, dofs, per in itertools.product(args.case, args.dofs, args.per):
        key = {"case": case, "wanted_dofs": dofs, "per": per, "processes": comm.size}
        record = None if args.again else file.find(key)
        if record is None:
            number = max(comm.size, round(dofs / per))
            record = file.keep(key, run(case, dofs, number, args.repeat, comm))
        found.append(record)
        command.say(_row(record), comm)
    for record in found:
        command.say(f"{_row(record)}, ratio {ratio(record, found):.2f}", comm)
    return found


def run(case: str, dofs: int, subdomains: int, repeat: int, comm: MPI.Comm) -> Record:
    """Solve the first linear system of a body; return what the fastest solve took. Collective."""
    problem = CASES[case](comm, dofs=dofs, subdomains=subdomains, options={"ksp_rtol": 1e-8})
    _, b = problem.linear_system()
    records = []
    for _ in range(repeat):
        started = time.process_time()
        cost, x = measure(problem.create_linear_solver, b)
        cpu = comm.allreduce(time.process_time() - started, op=MPI.MAX)
        records.append(asdict(cost) | {"seconds_cpu": cpu})
        x.destroy()
    size = {"dofs": b.getSize(), "subdomains": comm.allreduce(problem.decomposition.count)}
    b.destroy()
    return size | min(records, key=lambda record: record["seconds_cpu"])


def ratio(record: Record, records: Sequence[Record]) -> float:
    """Return the time of a record over the least of its case, size and number of processes."""
    alike = ("case", "wanted_dofs", "processes")
    times = [
        r["seconds_cpu"]
        for r in records
        if r["converged_reason"] > 0 and all(r[key] == record[key] for key in alike)
    ]
    return record["seconds_cpu"] / min(times) if times else float("nan")


def _wall(
    create: Callable[..., WallProblem], mmhg: float, comm: MPI.Comm, **case: object
) -> NonlinearProblem:
    """Create a wall under a first pressure [mmHg]."""
    wall = create(comm, kappa=KAPPA, **case)
    wall.pressure.value = loads.mmhg(mmhg)
    return wall.problem


def _vessel(comm: MPI.Comm, **case: object) -> WallProblem:
    with tempfile.TemporaryDirectory() as folder:
        return clamped.create_clamped_vessel(comm, folder=Path(folder), **case)


#: What makes each body with about so many dofs.
CASES: dict[str, Callable[..., Problem]] = {
    "tube": partial(_wall, clamped.create_clamped_tube, 1.0),
    "vessel": partial(_wall, _vessel, clamped.FIRST_PRESSURE),
    "block": create_block,
    "cube1": partial(create_cube, degree=1),
    "cube2": partial(create_cube, degree=2),
    "square1": partial(create_cube, degree=1, dim=2),
    "heat1": partial(create_heated_cube, degree=1),
}


def _row(record: Record) -> str:
    """Format a record as a line."""
    outcome = "" if record["converged_reason"] > 0 else ", did not converge"
    return (
        f"{record['case']:<8} {record['dofs']:>7} dofs {record['subdomains']:>4} subdomains, "
        f"{record['processes']} process(es): {record['iterations']:>4} it., "
        f"{record['seconds_cpu']:.2f} s{outcome}"
    )
