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
and on one with two threads, and `benchmarks.speed_page` takes the better one of each solver.
Options with a single dash are PETSc's, with the prefixes `tube_`, `vessel_`, `block_` (FETI),
`mumps_`, `gamg_`, …
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import petsc4py

petsc4py.init([word for word in sys.argv if not word.startswith("--")])

from mpi4py import MPI

import dolfinx_feti
from benchmarks.common.arguments import (
    add_records,
    create_parser,
    names,
    one_of,
    open_records,
    parse_words,
    several,
)
from benchmarks.common.bodies import LoadedBody, create_clamped_block
from benchmarks.common.machine import describe, limited_memory, now, threads
from benchmarks.common.progress import say
from benchmarks.common.records import Record
from benchmarks.common.repeatable import fix_partitions
from benchmarks.speed import path
from benchmarks.speed.groups import GEOMETRIES, Case, is_known
from benchmarks.speed.phases import Phases
from benchmarks.walls.tube import create_clamped_tube
from benchmarks.walls.vessel import FIRST_PRESSURE, create_clamped_vessel
from dolfinx_feti import loads
from dolfinx_feti.comparison.run import SOLVERS
from dolfinx_feti.output import writable_folder
from meshes.arguments import count, positive

__all__ = ["main"]

RTOL = 1e-8
USUAL = ("feti", "mumps", "gamg")

#: Load of the first Newton step [mmHg].
FIRST_LOAD = {"tube": 1.0, "vessel": FIRST_PRESSURE, "block": 1.0}


def main(argv: Sequence[str] | None = None) -> list[Record]:
    """Run the comparison, or what is left of it.

    Args:
        argv: The command line without the program's name; None for that of the process.

    Returns:
        A record for each case and solver, also those that the file had.

    Raises:
        SystemExit: A word of the command line is wrong, or the file cannot be written.
    """
    comm = MPI.COMM_WORLD
    fix_partitions()
    parser = _create_parser(comm)
    args = parse_words(parser, argv)
    possible = SOLVERS if args.path is None else path.SOLVERS
    solvers = args.solvers or [name for name in USUAL if name in possible]
    if not set(solvers) <= set(possible):
        parser.error(f"--path takes no other solvers than {names(possible)}")
    if args.path is not None and "feti" not in solvers:
        parser.error("--path needs feti among the --solvers: Newton's method goes on with it")
    file = open_records(args.json, parser, comm, known=is_known, writer="benchmarks.compare")
    records = []
    for case in _plan(args, comm.size):
        there = [file.find(case.key(name)) for name in solvers]
        if args.again or None in there:
            try:
                body = _create_body(case, args.folder, comm)
            except ValueError as error:  # no such mesh, or fewer cells than subdomains
                parser.error(str(error))
            found = _run(case, body, solvers, args.memory, comm)
            own = {"machine": describe(), "date": now()}
            there = [file.put(case.key(r["solver"]), r | own) for r in found]
        else:
            say(f"{case}: in the records already", comm)
        records += there
        for record in there:
            say(json.dumps(record), comm)
    return records


def _plan(args: argparse.Namespace, processes: int) -> Iterator[Case]:
    """Yield the cases, small ones first."""
    for dofs in args.dofs:
        for kappa in args.kappa:
            yield Case(
                geometry=args.geometry,
                kappa=kappa,
                wanted_dofs=dofs,
                wanted_subdomains=args.subdomains,
                processes=processes,
                threads=threads(),
                path_mmhg=args.path,
            )


def _run(
    case: Case, body: LoadedBody, solvers: Sequence[str], memory: float, comm: MPI.Comm
) -> list[Record]:
    """Run a case; return a record for each solver.

    Args:
        case: The case.
        body: Its body, at rest.
        solvers: Out of those that it may have.
        memory: What they may take beside the body [MiB].
        comm: Communicator of the mesh.
    """
    dofmap = body.u.function_space.dofmap
    size: Record = {
        "dofs": dofmap.index_map.size_global * dofmap.index_map_bs,
        "subdomains": comm.allreduce(body.problem.decomposition.count),
    }
    with limited_memory(comm, memory) as room:
        if case.path_mmhg is None:
            body.load.value = loads.mmhg(FIRST_LOAD[case.geometry])
            found = _first_step(body, solvers)
        else:
            found = path.follow(body, case.path_mmhg, direct="mumps" in solvers)
    size["free_mib"] = room if math.isfinite(room) else None
    return [case.key(record["solver"]) | size | record for record in found]


def _first_step(body: LoadedBody, solvers: Sequence[str]) -> list[Record]:
    """Solve the next Newton step with each solver."""
    ordered = [name for name in SOLVERS if name in solvers]  # FETI first
    phases = Phases(body.u.function_space.mesh.comm)
    found = dolfinx_feti.compare(body.problem, ordered, definite=True).records
    of_feti = phases.record()
    for record in found:
        if record["solver"] == "feti":
            record |= of_feti
        difference = record.pop("difference_to_direct", None)
        record |= {"difference_to_mumps": difference, "newton_iterations": 1}
    return found


def _create_body(case: Case, folder: Path, comm: MPI.Comm) -> LoadedBody:
    """Build a body at rest; FETI shows its parts (``ksp_view``) where it solves once only.

    Raises:
        ValueError: There is no such mesh, or it has too few cells for the subdomains.
    """
    options = {} if case.path_mmhg is not None else {"ksp_view": None}
    shared = {
        "dofs": case.wanted_dofs,
        "kappa": case.kappa,
        "subdomains": case.wanted_subdomains,
        "options": {"ksp_rtol": RTOL} | options,
    }
    if case.geometry == "block":
        return create_clamped_block(comm, **shared)
    if case.geometry == "vessel":
        wall = create_clamped_vessel(comm, **shared, folder=writable_folder(folder, comm))
    else:
        wall = create_clamped_tube(comm, **shared)
    return LoadedBody(wall.problem, wall.u, wall.p, wall.pressure)


def _create_parser(comm: MPI.Comm) -> argparse.ArgumentParser:
    parser = create_parser("compare", __doc__, comm)
    add = parser.add_argument
    add("--geometry", choices=GEOMETRIES, default="tube")
    add("--kappa", type=several(positive), default=[1000.0], help="[kPa], 1000")
    add("--dofs", type=several(count), default=[180_000], help="approximate number; 180000")
    add("--subdomains", type=count, help="over all processes; about one for 2000 dofs")
    add("--solvers", type=several(one_of(SOLVERS)), help=f"{names(SOLVERS)}; the first three")
    add("--path", type=positive, metavar="P", help="load steps to P mmHg in place of a first step")
    add("--folder", type=Path, default=Path("build/walls"), help="where meshes are kept")
    add_records(parser)
    return parser


if __name__ == "__main__":
    main()
