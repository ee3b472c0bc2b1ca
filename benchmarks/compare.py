# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI compared with other solvers on the same matrices.

The first Newton step of a body at rest; with --loaded P that of a body in equilibrium at P mmHg,
under a hundredth more; or with --path P all Newton steps up to P mmHg:

    python3 -m benchmarks.compare --kappa 10,1000 --dofs 60000,184000 --json build/speed.json
    python3 -m benchmarks.compare --geometry vessel --dofs 71000 --path 10 --json build/speed.json
    python3 -m benchmarks.compare --geometry cube --degree 1 --solvers feti --per 500,1000,2000
    python3 -m benchmarks.compare --geometry plate-100 --dofs 30000 --solvers feti,feti-dual,gamg

`peak_mib` is the peak of the memory that a solver took above the matrices, summed over the
processes. With --rounds the solvers take turns, and the record has the round with the median time.
--per varies the dofs of a subdomain, with FETI alone; `seconds_cpu` is then its processor time, the
least of all rounds. A solver that fails is recorded with the reason; `ulimit -d KIB` limits its
memory. Run the study on two processes, and on one with OMP_NUM_THREADS=2: the page takes the better
layout of each solver. PETSc's options have the prefixes `tube_`, `vessel_`, `body_` (FETI),
`mumps_`, `gamg_`, …
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

from mpi4py import MPI

import dolfinx_feti
from benchmarks.common import bodies, command
from benchmarks.common.compare import path
from benchmarks.common.compare.geometries import GEOMETRIES, Request
from benchmarks.common.compare.opponents import OPPONENTS
from benchmarks.common.compare.tables import draw_compressible, fields, seconds
from benchmarks.common.records import Record, Records, threads
from benchmarks.common.study import Arguments, Keep, Study
from dolfinx_feti import LinearProblem, NonlinearProblem
from dolfinx_feti.loading import Checkpoint
from dolfinx_feti.meshes.arguments import count, positive

#: Solvers of a command line without --solvers.
USUAL = ("feti", "mumps", "gamg")

#: Increase of the load of a loaded body, relative to the load. The step is small enough for the
#: tangent to be that of the loaded equilibrium.
LOAD_INCREASE = 0.01

Problem = LinearProblem | NonlinearProblem


def _options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--geometry", choices=tuple(GEOMETRIES), default="tube")
    add("--degree", type=int, choices=(1, 2), default=2, help="of the displacement; 2")
    add("--kappa", type=command.several(positive), default=[1000.0], help="[kPa], 1000")
    add("--dofs", type=command.several(count), default=[180_000], help="approximate number; 180000")
    add("--subdomains", type=count, help="over all processes; about one for 2000 dofs")
    add("--per", type=command.several(count), default=[None], help="dofs of a subdomain")
    names = tuple(OPPONENTS)
    add("--solvers", type=command.some_of(names), help=f"{', '.join(names)}; {','.join(USUAL)}")
    add("--rounds", type=count, default=1, help="in which the solvers alternate; 1")
    add("--path", type=positive, metavar="P", help="load steps to P mmHg in place of a first step")
    add("--loaded", type=positive, metavar="P", help="a step in the equilibrium at P mmHg")
    add("--folder", type=Path, default=Path("build/walls"), help="for meshes and loaded states")


def _solvers(args: Arguments) -> list[str]:
    """Return the solvers that a command line names, or the usual ones."""
    if args.per != [None]:
        return ["feti"]
    possible = tuple(OPPONENTS) if args.path is None else path.SOLVERS
    return args.solvers or [name for name in USUAL if name in possible]


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases, small ones first."""
    solvers = _solvers(args)
    if args.path is not None and args.loaded is not None:
        raise ValueError("--path and --loaded exclude each other")
    if (args.path or args.loaded) and not GEOMETRIES[args.geometry].is_wall:
        raise ValueError(f"--geometry {args.geometry} goes without --path and --loaded")
    if args.path is not None and not set(solvers) <= set(path.SOLVERS):
        raise ValueError(f"--path takes no other solvers than {', '.join(path.SOLVERS)}")
    if args.path is not None and "feti" not in solvers:
        raise ValueError("--path needs feti among the --solvers: Newton's method goes on with it")
    shared = {"geometry": args.geometry, "degree": args.degree, "processes": comm.size}
    shared |= {"threads": threads(), "path_mmhg": args.path, "loaded_mmhg": args.loaded}
    kappas = [None] if GEOMETRIES[args.geometry].is_compressible else args.kappa
    for dofs, kappa, per in product(args.dofs, kappas, args.per):
        number = args.subdomains if per is None else max(comm.size, round(dofs / per))
        case = {"kappa": kappa, "wanted_dofs": dofs, "wanted_subdomains": number}
        yield shared | case | ({} if per is None else {"per": per})


def _is_done(case: Record, records: Records, args: Arguments) -> bool:
    """Return True if all solvers have a record."""
    return all(records.all(case | {"solver": name}) for name in _solvers(args))


def _run(case: Record, keep: Keep, args: Arguments, comm: MPI.Comm) -> None:
    """Solve the step or the path of a case with each solver; keep their records. Collective."""
    solvers = _solvers(args)
    body = _create_body(case, args.folder, comm)
    problem = getattr(body, "problem", body)
    dofmap = problem.u.function_space.dofmap
    size: Record = {
        "dofs": dofmap.index_map.size_global * dofmap.index_map_bs,
        "subdomains": comm.allreduce(problem.decomposition.count),
    }
    if args.path is not None:
        direct = [name for name in solvers if name != "feti"]
        measured = path.follow(body, args.path, direct=direct)
    else:
        if args.loaded is not None:
            names = ("geometry", "degree", "kappa", "wanted_dofs")
            name = "_".join([*(str(case[n]) for n in names), f"{args.loaded:g}"])
            folder = args.folder / name
            path.load(body, args.loaded, Checkpoint(folder, comm, restart=folder.exists()))
            body.set_load(args.loaded * (1.0 + LOAD_INCREASE))
        elif (first_load := GEOMETRIES[args.geometry].first_load) is not None:
            body.set_load(first_load)
        measured = _median([_step(problem, solvers, comm) for _ in range(args.rounds)])
    for record in measured:
        keep({"solver": record["solver"]}, size | record)


def _step(problem: Problem, solvers: Sequence[str], comm: MPI.Comm) -> list[Record]:
    """Solve the next Newton step with each solver; return a record for each. Collective."""
    options = {name: opponent.options for name, opponent in OPPONENTS.items() if name in solvers}
    if "pardiso" in options:
        options["pardiso"] = {**options["pardiso"], "definite": True}
    started = time.process_time()
    records = dolfinx_feti.compare(problem, options, definite=True).records
    cpu = comm.allreduce(time.process_time() - started, op=MPI.MAX)
    if [record["solver"] for record in records] == ["feti"]:
        records[0]["seconds_cpu"] = cpu
    for record in records:
        record["difference_to_mumps"] = record.pop("difference_to_direct", None)
        record["newton_iterations"] = 1
    return records


def _median(rounds: Sequence[list[Record]]) -> list[Record]:
    """Return the record of each solver's median round, with the seconds of all rounds."""
    medians = []
    for of_solver in zip(*rounds, strict=True):
        ordered = sorted(of_solver, key=seconds)
        record = dict(ordered[(len(ordered) - 1) // 2])
        record["seconds_rounds"] = [
            [r.get("seconds_setup"), r.get("seconds_solve")] for r in of_solver
        ]
        if "seconds_cpu" in record:
            record["seconds_cpu"] = min(r["seconds_cpu"] for r in of_solver)
        medians.append(record)
    return medians


def _create_body(case: Record, folder: Path, comm: MPI.Comm) -> bodies.Body | LinearProblem:
    """Build the body of a case at rest.

    If FETI solves a single system, it prints its parts (``ksp_view``).
    """
    geometry = GEOMETRIES[case["geometry"]]
    options: dict[str, object] = {}
    solves_once = case["path_mmhg"] is None and case["loaded_mmhg"] is None and "per" not in case
    if solves_once:
        options["ksp_view"] = None
    if geometry.is_compressible:
        options["ksp_rtol"] = geometry.rtol
    request = Request(
        dofs=case["wanted_dofs"], degree=case["degree"], kappa=case["kappa"], folder=folder
    )
    settings = {"subdomains": case["wanted_subdomains"], "petsc_options": options}
    return geometry.create(comm, request, settings)


def _is_known(record: Record) -> bool:
    """Return True if a record is one of this study, and its solver and body have a name."""
    is_of_study = {"solver", "geometry", "threads", "path_mmhg", "degree"} <= record.keys()
    return is_of_study and record["solver"] in OPPONENTS and record["geometry"] in GEOMETRIES


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="speed",
    known=_is_known,
    options=_options,
    cases=_cases,
    run=_run,
    done=_is_done,
    fields=fields,
    draw=draw_compressible,
)

if __name__ == "__main__":
    STUDY.main()
