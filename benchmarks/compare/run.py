# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI beside other solvers on the same matrices.

The first Newton step of a body at rest; with --loaded P that of a body in equilibrium at P mmHg,
under a hundredth more; or with --path P all Newton steps up to P mmHg:

    python3 -m benchmarks.compare --kappa 10,1000 --dofs 60000,184000 --json build/speed.json
    python3 -m benchmarks.compare --geometry vessel --dofs 71000 --path 10 --json build/speed.json

Bodies: the two-layer `tube` at 1 mmHg and `vessel` at 0.01 mmHg, and the neo-Hookean `block`,
clamped on five faces, under a dead load of 1 mmHg on the sixth one; P2–P0, or P1–P0 by --degree 1.

`--solvers` takes those of `benchmarks/compare/opponents.py`, which has their settings. Matrices are
there before a solver begins. `peak_mib` is the most memory that a solver took above that, from its
creation to its solution, summed over the processes. In each of the --rounds all solvers have their
turn; the record has the round with the median time, and `seconds_rounds` those of all. On the path
Newton's method goes on with FETI's solutions; a direct solver has a run of its own, in which they
are read, and it solves the same systems.

With --cost FETI takes other bounds χ₀ for what an average may cost than its own, and so more or
fewer coarse columns: with --subdomains these are the choices that its time and memory depend on.

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
from functools import partial
from itertools import product
from pathlib import Path
from unittest import mock

from mpi4py import MPI

import dolfinx_feti
from benchmarks.common import command
from benchmarks.common.bodies import LoadedBody, create_clamped_block
from benchmarks.common.clock import Events
from benchmarks.common.machine import limited_memory, threads
from benchmarks.common.records import Record
from benchmarks.common.walls import clamped
from benchmarks.compare import path
from benchmarks.compare.opponents import OPPONENTS
from benchmarks.compare.split import blocks_of
from dolfinx_feti import loads
from dolfinx_feti.feti.primal.form import COST
from dolfinx_feti.loading import Checkpoint
from dolfinx_feti.output import writable_folder
from meshes.arguments import count, positive

__all__ = ["GEOMETRIES", "is_known", "main", "seconds"]

GEOMETRIES = ("tube", "vessel", "block")

USUAL = ("feti", "mumps", "gamg")

#: Share of its load by which that of a loaded body grows.
MORE = 0.01

#: Load of the first Newton step [mmHg].
FIRST_LOAD = {"tube": 1.0, "vessel": clamped.FIRST_PRESSURE, "block": 1.0}


def main(argv: Sequence[str] | None = None) -> list[Record]:
    """Run the comparison, or what is left of it; return all records, those of the file, too."""
    comm = MPI.COMM_WORLD
    parser = _create_parser(comm)
    args = command.parse_words(parser, argv)
    possible = tuple(OPPONENTS) if args.path is None else path.SOLVERS
    solvers = args.solvers or [name for name in USUAL if name in possible]
    if args.path is not None and args.loaded is not None:
        parser.error("--path and --loaded exclude each other")
    if not set(solvers) <= set(possible):
        parser.error(f"--path takes no other solvers than {command.names(possible)}")
    if args.path is not None and "feti" not in solvers:
        parser.error("--path needs feti among the --solvers: Newton's method goes on with it")
    if args.path is not None and args.cost != [None]:
        parser.error("--path and --cost exclude each other")
    file = command.open_records(args.json, parser, comm, is_known)
    records = []
    for case in _plan(args, comm.size):
        there = [file.find(case | {"solver": name}) for name in solvers]
        if args.again or None in there:
            try:
                body = _create_body(case, args.folder, comm)
            except ValueError as error:  # no such mesh, or fewer cells than subdomains
                parser.error(str(error))
            found = _run(case, body, solvers, args, comm)
            there = [file.keep(case | {"solver": r["solver"]}, r) for r in found]
        else:
            command.say(f"{_name(case)}: in the records already", comm)
        records += there
        for record in there:
            command.say(json.dumps(record), comm)
    return records


def is_known(record: Record) -> bool:
    """Tell whether a record is one of this study."""
    return {"solver", "geometry", "threads", "path_mmhg", "degree", "cost"} <= record.keys()


def _plan(args: argparse.Namespace, processes: int) -> Iterator[Record]:
    """Yield the cases, small ones first."""
    for dofs, kappa, cost in product(args.dofs, args.kappa, args.cost):
        yield {
            "geometry": args.geometry,
            "degree": args.degree,
            "kappa": kappa,
            "wanted_dofs": dofs,
            "wanted_subdomains": args.subdomains,
            "processes": processes,
            "threads": threads(),
            "path_mmhg": args.path,
            "loaded_mmhg": args.loaded,
            "cost": cost,
        }


def _name(case: Record) -> str:
    return ", ".join(f"{name} {value}" for name, value in case.items())


def _run(
    case: Record,
    body: LoadedBody,
    solvers: Sequence[str],
    args: argparse.Namespace,
    comm: MPI.Comm,
) -> list[Record]:
    """Run a case on its body at rest, in so much memory; return a record for each solver."""
    dofmap = body.u.function_space.dofmap
    size: Record = {
        "dofs": dofmap.index_map.size_global * dofmap.index_map_bs,
        "subdomains": comm.allreduce(body.problem.decomposition.count),
    }
    if args.loaded is not None:
        names = ("geometry", "degree", "kappa", "wanted_dofs")
        place = args.folder / "_".join([*(str(case[n]) for n in names), f"{args.loaded:g}"])
        path.load(body, args.loaded, Checkpoint(place, comm, restart=place.exists()))
    with limited_memory(comm, args.memory) as room:
        if args.path is not None:
            direct = [name for name in solvers if name != "feti"]
            another = partial(_create_body, case, args.folder, comm)
            found = path.follow(body, args.path, direct=direct, another=another)
        else:
            mmhg = FIRST_LOAD[case["geometry"]] if args.loaded is None else args.loaded
            body.load.value = loads.mmhg(mmhg * (1.0 if args.loaded is None else 1.0 + MORE))
            cost = COST if case["cost"] is None else case["cost"]
            with mock.patch("dolfinx_feti.feti.primal.form.COST", cost):
                found = _median([_step(body, solvers) for _ in range(args.rounds)])
    size["free_mib"] = room if math.isfinite(room) else None
    return [case | size | record for record in found]


def _step(body: LoadedBody, solvers: Sequence[str]) -> list[Record]:
    """Solve the next Newton step with each solver."""
    ordered = {name: options for name, options in OPPONENTS.items() if name in solvers}
    if "pardiso" in ordered:
        ordered["pardiso"] = {**ordered["pardiso"], "definite": True}
    phases = Events(path.PHASES, body.u.function_space.mesh.comm)
    with blocks_of(body.problem):
        found = dolfinx_feti.compare(body.problem, ordered, definite=True).records
    spent = phases.seconds()
    for record in found:
        if record["solver"] == "feti":
            record["seconds_phases"] = spent
        difference = record.pop("difference_to_direct", None)
        record |= {"difference_to_mumps": difference, "newton_iterations": 1}
    return found


def _median(rounds: Sequence[list[Record]]) -> list[Record]:
    """Return the record of each solver's median round, with the seconds of all rounds."""
    found = []
    for several in zip(*rounds, strict=True):
        ordered = sorted(several, key=seconds)
        each = [[r.get("seconds_setup"), r.get("seconds_solve")] for r in several]
        found.append(ordered[(len(ordered) - 1) // 2] | {"seconds_rounds": each})
    return found


def seconds(record: Record) -> float:
    """Return the seconds of set-up and solution; infinite without a solution."""
    if not record["converged"]:
        return math.inf
    return record["seconds_setup"] + record["seconds_solve"]


def _create_body(case: Record, folder: Path, comm: MPI.Comm) -> LoadedBody:
    """Build a body at rest; FETI shows its parts (``ksp_view``) where it solves once only."""
    once = case["path_mmhg"] is None and case["loaded_mmhg"] is None
    options = {"ksp_view": None} if once else {}
    shared = {
        "degree": case["degree"],
        "dofs": case["wanted_dofs"],
        "kappa": case["kappa"],
        "subdomains": case["wanted_subdomains"],
        "options": options,
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
    add("--degree", type=command.one_of((1, 2)), default=2, help="of the displacement; 2")
    add("--kappa", type=command.several(positive), default=[1000.0], help="[kPa], 1000")
    add("--dofs", type=command.several(count), default=[180_000], help="approximate number; 180000")
    add("--subdomains", type=count, help="over all processes; about one for 2000 dofs")
    add("--cost", type=command.several(positive), default=[None], help=f"χ₀ of FETI, {COST:g}")
    add(
        "--solvers",
        type=command.some_of(tuple(OPPONENTS)),
        help=f"{command.names(tuple(OPPONENTS))}; the first three",
    )
    add("--rounds", type=count, default=1, help="in which the solvers alternate; 1")
    add("--path", type=positive, metavar="P", help="load steps to P mmHg in place of a first step")
    add("--loaded", type=positive, metavar="P", help="a step in the equilibrium at P mmHg")
    add("--folder", type=Path, default=Path("build/walls"), help="for meshes and loaded states")
    command.add_records(parser, memory=True)
    return parser
