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

A case that is in the file is not run again, unless by --again. With --page FILE the table of that
page is written anew from the file's records, and nothing is run.
"""

from __future__ import annotations

import re
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

from mpi4py import MPI

from benchmarks.common.arguments import (
    add_records,
    create_parser,
    one_of,
    open_records,
    parse_words,
    several,
)
from benchmarks.common.bodies import create_block, create_cube, create_heated_cube, create_square
from benchmarks.common.machine import describe, now
from benchmarks.common.progress import say
from benchmarks.common.records import Record
from benchmarks.walls.tube import create_clamped_tube
from benchmarks.walls.vessel import FIRST_PRESSURE, create_clamped_vessel
from dolfinx_feti import LinearProblem, NonlinearProblem, loads
from dolfinx_feti.collective import on_first
from dolfinx_feti.comparison import measure
from dolfinx_feti.fem.decomposition import DOFS
from meshes.arguments import count

__all__ = ["main"]

KAPPA = 1000.0  # kPa
PER = (250, 500, 1000, 1500, 2000, 3000, 4500, 7000)
Problem = LinearProblem | NonlinearProblem


def main(argv: Sequence[str] | None = None, comm: MPI.Comm = MPI.COMM_WORLD) -> list[Record]:
    """Run the sweep that the command line describes.

    Args:
        argv: The command line without the program's name; None for that of the process.
        comm: Communicator of the meshes.

    Returns:
        The records, also those that the file had.

    Raises:
        SystemExit: A word of the command line is wrong, or the file cannot be written.

    Note:
        Collective.
    """
    parser = create_parser("subdomains", __doc__, comm)
    add = parser.add_argument
    add("--case", type=several(one_of(list(CASES))), default=list(CASES), help=",".join(CASES))
    add("--dofs", type=several(count), default=[30_000], help="approximate number of dofs; 30000")
    add("--per", type=several(count), default=list(PER), help="dofs of a subdomain")
    add("--repeat", type=count, default=2, help="solves of which the fastest counts; 2")
    add("--page", type=Path, metavar="FILE", help="page of which the table is written anew")
    add_records(parser)
    args = parse_words(parser, argv)
    file = open_records(args.json, parser, comm)
    if args.page is not None:
        on_first(lambda: write_table(args.page, list(file)), comm)
        return list(file)
    found = []
    for case in args.case:
        for dofs in args.dofs:
            for per in args.per:
                key = {"case": case, "wanted_dofs": dofs, "per": per, "processes": comm.size}
                record = None if args.again else file.find(key)
                if record is None:
                    measured = run(case, dofs, max(comm.size, round(dofs / per)), args.repeat, comm)
                    record = file.put(key, key | measured | {"machine": describe(), "date": now()})
                found.append(record)
                say(_row(record), comm)
    for record in found:
        say(f"{_row(record)}, ratio {ratio(record, found):.2f}", comm)
    return found


def run(case: str, dofs: int, subdomains: int, repeat: int, comm: MPI.Comm) -> Record:
    """Tear a body and solve its first linear system.

    Args:
        case: Name out of ``CASES``.
        dofs: Approximate number.
        subdomains: Their number.
        repeat: Number of solves.
        comm: Communicator of the mesh.

    Returns:
        What the fastest solve took.

    Note:
        Collective.
    """
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


def table(records: Sequence[Record]) -> str:
    """Return the table of the page: ratios over dofs of a subdomain, the rule's in bold."""
    steps = sorted({record["per"] for record in records})
    rows: dict[tuple[str, int, int], dict[int, Record]] = {}
    for record in records:
        key = (record["case"], record["processes"], record["wanted_dofs"])
        rows.setdefault(key, {})[record["per"]] = record
    head = ["body", "processes", "dofs", *map(str, steps), "iterations"]
    lines = [head, ["---"] * len(head)]
    for case, processes, wanted in sorted(rows, key=lambda key: (key[1], *_place(key))):
        row = rows[case, processes, wanted]
        cells = [f"{ratio(row[per], records):.2f}" if per in row else "" for per in steps]
        cells[steps.index(DOFS)] = f"**{cells[steps.index(DOFS)]}**"
        its = [each["iterations"] for each in row.values() if each["subdomains"] > 1]
        dofs = str(row[DOFS]["dofs"])
        lines.append([f"`{case}`", str(processes), dofs, *cells, f"{min(its)}–{max(its)}"])
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _place(key: tuple[str, int, int]) -> tuple[int, int]:
    """Return where a row stands: bodies in the order of ``CASES``, small ones first."""
    return list(CASES).index(key[0]), key[2]


def write_table(page: Path, records: Sequence[Record]) -> None:
    """Put the table of the records in the place of the one that a page has."""
    text = page.read_text()
    page.write_text(re.sub(r"^\| body .*?(?=\n\n)", table(records), text, flags=re.M | re.S))


def _tube(
    comm: MPI.Comm, *, dofs: int, subdomains: int, options: dict[str, object]
) -> NonlinearProblem:
    tube = create_clamped_tube(comm, dofs=dofs, kappa=KAPPA, subdomains=subdomains, options=options)
    tube.pressure.value = loads.mmhg(1.0)
    return tube.problem


def _vessel(
    comm: MPI.Comm, *, dofs: int, subdomains: int, options: dict[str, object]
) -> NonlinearProblem:
    with tempfile.TemporaryDirectory() as folder:
        vessel = create_clamped_vessel(
            comm,
            dofs=dofs,
            kappa=KAPPA,
            subdomains=subdomains,
            options=options,
            folder=Path(folder),
        )
    vessel.pressure.value = loads.mmhg(FIRST_PRESSURE)
    return vessel.problem


#: What makes each body with about so many dofs.
CASES: dict[str, Callable[..., Problem]] = {
    "tube": _tube,
    "vessel": _vessel,
    "block": create_block,
    "cube1": partial(create_cube, degree=1),
    "cube2": partial(create_cube, degree=2),
    "square1": partial(create_square, degree=1),
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


if __name__ == "__main__":
    main()
