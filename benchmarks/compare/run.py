# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI beside MUMPS, GAMG and others on the same matrices.

The first Newton step of a body at rest, P2–P0, or with --path P all Newton steps up to P mmHg:

    python3 -m benchmarks.compare --kappa 10,1000 --dofs 60000,184000 --json build/speed.json
    python3 -m benchmarks.compare --geometry vessel --dofs 199000 --path 10 --json build/speed.json

Bodies: the two-layer `tube` at 1 mmHg and `vessel` at 0.01 mmHg, and the neo-Hookean `block`,
clamped on five faces, under a dead load of 1 mmHg on the sixth one.

FETI gets the torn matrix; MUMPS (Cholesky) and GAMG (CG, six rigid body modes) the assembled one
that PETSc converts from it. Both are there before a solver begins. `peak_mib` is the most memory
that a solver took above that, from its creation to its solution, summed over the processes.
`--solvers` also takes hypre (BoomerAMG) and bddc (PETSc's, on the torn matrix). On the path
Newton's method goes on with FETI's solution, and MUMPS solves the same systems beside it.

All κ have the same subdomains. A case that is in the file with all its solvers is not run again,
unless by --again. A solver that fails, say for want of memory, is recorded with the reason.
Processes and threads (OMP_NUM_THREADS) are those that it is started with: run it on two processes
and on one with two threads, and `benchmarks.compare.page` takes the better one of each solver.
Options with a single dash are PETSc's, with the prefixes `tube_`, `vessel_`, `block_` (FETI),
`mumps_`, `gamg_`, …
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

from mpi4py import MPI

import dolfinx_feti
from benchmarks.common import command
from benchmarks.common.bodies import LoadedBody, create_clamped_block
from benchmarks.common.clock import Events
from benchmarks.common.machine import limited_memory, threads
from benchmarks.common.records import Record
from benchmarks.common.walls import clamped
from benchmarks.compare import path
from dolfinx_feti import loads
from dolfinx_feti.comparison.run import SOLVERS
from dolfinx_feti.output import writable_folder
from meshes.arguments import count, positive

__all__ = ["GEOMETRIES", "is_known", "main"]

GEOMETRIES = ("tube", "vessel", "block")

RTOL = 1e-8
USUAL = ("feti", "mumps", "gamg")

#: Load of the first Newton step [mmHg].
FIRST_LOAD = {"tube": 1.0, "vessel": clamped.FIRST_PRESSURE, "block": 1.0}


def main(argv: Sequence[str] | None = None) -> list[Record]:
    """Run the comparison, or what is left of it; return all records, those of the file, too."""
    comm = MPI.COMM_WORLD
    parser = _create_parser(comm)
    args = command.parse_words(parser, argv)
    possible = SOLVERS if args.path is None else path.SOLVERS
    solvers = args.solvers or [name for name in USUAL if name in possible]
    if not set(solvers) <= set(possible):
        parser.error(f"--path takes no other solvers than {command.names(possible)}")
    if args.path is not None and "feti" not in solvers:
        parser.error("--path needs feti among the --solvers: Newton's method goes on with it")
    file = command.open_records(args.json, parser, comm, is_known)
    records = []
    for case in _plan(args, comm.size):
        there = [file.find(case | {"solver": name}) for name in solvers]
        if args.again or None in there:
            try:
                body = _create_body(case, args.folder, comm)
            except ValueError as error:  # no such mesh, or fewer cells than subdomains
                parser.error(str(error))
            found = _run(case, body, solvers, args.memory, comm)
            there = [file.keep(case | {"solver": r["solver"]}, r) for r in found]
        else:
            command.say(f"{_name(case)}: in the records already", comm)
        records += there
        for record in there:
            command.say(json.dumps(record), comm)
    return records


def is_known(record: Record) -> bool:
    """Tell whether a record is one of this study."""
    return {"solver", "geometry", "threads", "path_mmhg"} <= record.keys()


def _plan(args: argparse.Namespace, processes: int) -> Iterator[Record]:
    """Yield the cases, small ones first."""
    for dofs, kappa in product(args.dofs, args.kappa):
        yield {
            "geometry": args.geometry,
            "kappa": kappa,
            "wanted_dofs": dofs,
            "wanted_subdomains": args.subdomains,
            "processes": processes,
            "threads": threads(),
            "path_mmhg": args.path,
        }


def _name(case: Record) -> str:
    return ", ".join(f"{name} {value}" for name, value in case.items())


def _run(
    case: Record, body: LoadedBody, solvers: Sequence[str], memory: float, comm: MPI.Comm
) -> list[Record]:
    """Run a case on its body at rest, in so much memory [MiB]; return a record for each solver."""
    dofmap = body.u.function_space.dofmap
    size: Record = {
        "dofs": dofmap.index_map.size_global * dofmap.index_map_bs,
        "subdomains": comm.allreduce(body.problem.decomposition.count),
    }
    with limited_memory(comm, memory) as room:
        if case["path_mmhg"] is None:
            body.load.value = loads.mmhg(FIRST_LOAD[case["geometry"]])
            found = _first_step(body, solvers)
        else:
            found = path.follow(body, case["path_mmhg"], direct="mumps" in solvers)
    size["free_mib"] = room if math.isfinite(room) else None
    return [case | size | record for record in found]


def _first_step(body: LoadedBody, solvers: Sequence[str]) -> list[Record]:
    """Solve the next Newton step with each solver."""
    ordered = [name for name in SOLVERS if name in solvers]  # FETI first
    phases = Events(path.PHASES, body.u.function_space.mesh.comm)
    found = dolfinx_feti.compare(body.problem, ordered, definite=True).records
    spent = phases.seconds()
    for record in found:
        if record["solver"] == "feti":
            record["seconds_phases"] = spent
        difference = record.pop("difference_to_direct", None)
        record |= {"difference_to_mumps": difference, "newton_iterations": 1}
    return found


def _create_body(case: Record, folder: Path, comm: MPI.Comm) -> LoadedBody:
    """Build a body at rest; FETI shows its parts (``ksp_view``) where it solves once only."""
    options = {} if case["path_mmhg"] is not None else {"ksp_view": None}
    shared = {
        "dofs": case["wanted_dofs"],
        "kappa": case["kappa"],
        "subdomains": case["wanted_subdomains"],
        "options": {"ksp_rtol": RTOL} | options,
    }
    if case["geometry"] == "block":
        return create_clamped_block(comm, **shared)
    if case["geometry"] == "vessel":
        wall = clamped.create_clamped_vessel(comm, **shared, folder=writable_folder(folder, comm))
    else:
        wall = clamped.create_clamped_tube(comm, **shared)
    return LoadedBody(wall.problem, wall.u, wall.p, wall.pressure)


def _create_parser(comm: MPI.Comm) -> argparse.ArgumentParser:
    parser = command.create_parser("compare", __doc__, comm)
    add = parser.add_argument
    add("--geometry", choices=GEOMETRIES, default="tube")
    add("--kappa", type=command.several(positive), default=[1000.0], help="[kPa], 1000")
    add("--dofs", type=command.several(count), default=[180_000], help="approximate number; 180000")
    add("--subdomains", type=count, help="over all processes; about one for 2000 dofs")
    add(
        "--solvers",
        type=command.some_of(SOLVERS),
        help=f"{command.names(SOLVERS)}; the first three",
    )
    add("--path", type=positive, metavar="P", help="load steps to P mmHg in place of a first step")
    add("--folder", type=Path, default=Path("build/walls"), help="where meshes are kept")
    command.add_records(parser, memory=True)
    return parser
