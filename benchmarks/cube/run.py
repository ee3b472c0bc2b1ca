# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The linear study of the paper: the unit cube in 512 subdomains, in all variants.

    python3 -m benchmarks.cube --level 1,2,3 --json build/linear.json
    mpirun -n 2 python3 -m benchmarks.cube --degree 2 --type classical --pc lumped
    mpirun -n 2 python3 -m benchmarks.cube --sets all --json build/linear.json
    mpirun -n 2 python3 -m benchmarks.cube --solvers all --level 2,3 --json build/solvers.json

An option that takes several values runs all combinations. The defaults are the paper's choices:
8 × 8 × 8 subdomains, multiplicity scaling, Q = I, full gluing, a reduction of the dual residual by
1e-8; E = 210, ν = 0.45, and on the whole surface the displacements of the fundamental solution with
its source at (2, 2, 2). --sets runs the cases of the whole study in place of combinations;
--solvers compares FETI with MUMPS and GAMG on P1, for --level and --subdomains-per-edge alone.

A case that is in the JSON file is not run again, unless by --again. The memory is estimated before
each case, and a case that will not fit is refused; the exit status then is 1, but for --sets.
PETSC_OPTIONS in the environment serves PETSc's own options.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterator, Sequence
from contextlib import suppress

from mpi4py import MPI

from benchmarks.common import command
from benchmarks.common.cube import PATTERNS
from benchmarks.common.records import Record, Records
from benchmarks.cube.case import LEVELS, Case
from benchmarks.cube.plan import SETS, plan
from benchmarks.cube.solvers import SOLVERS, solve
from benchmarks.cube.study import run_all
from dolfinx_feti.feti.options import CHOICES
from meshes.arguments import count, positive

__all__ = ["main"]

#: Options of FETI that take several values, and their defaults.
VARIED = {
    "type": "all_floating,classical",
    "pc": "identity,lumped,dirichlet",
    "scaling": "multiplicity",
    "coarse_q": "identity",
    "gluing": "full",
    "interior": "auto",
}
SEVERAL = ("degree", "level", "subdomains_per_edge", "jump", *VARIED)
SINGLE = ("coarse_modes", "reorthogonalize", "pattern", "source")


def main(arguments: Sequence[str] | None = None, comm: MPI.Comm = MPI.COMM_WORLD) -> int:
    """Run what the command line describes; return 0 if all the cases have a record. Collective."""
    parser = _create_parser(comm)
    args = parser.parse_args(arguments)
    fewest = min(args.subdomains_per_edge) ** 3
    if comm.size > fewest and not args.sets:
        parser.error(
            f"--subdomains-per-edge {min(args.subdomains_per_edge)} gives {fewest} subdomain(s) to "
            f"{comm.size} processes: take fewer processes, or as many subdomains at least"
        )
    if (args.pattern == "none") != (args.jump == [1.0]):
        parser.error(
            f"--jump {args.jump} and --pattern {args.pattern}: give both, how stiff and which "
            "subdomains, or none of them"
        )
    records = command.open_records(args.json, parser, comm)
    if args.solvers:
        _compare(args, records, comm)
        return 0
    cases = plan(args.sets) if args.sets else list(_cases(args))
    cases = [case for case in cases if case.subdomains_per_edge**3 >= comm.size]
    lost = run_all(cases, records, comm, limit=args.memory, again=args.again)
    return int(lost > 0 and not args.sets)


def _cases(args: argparse.Namespace) -> Iterator[Case]:
    """Combine the values of all options."""
    single = {name: getattr(args, name) for name in SINGLE}
    for values in itertools.product(*(getattr(args, name) for name in SEVERAL)):
        yield Case(**dict(zip(SEVERAL, values, strict=True)), **single)


def _compare(args: argparse.Namespace, records: Records, comm: MPI.Comm) -> None:
    """Run the solvers that the records lack."""
    for level, edge in itertools.product(args.level, args.subdomains_per_edge):
        place = {"level": level, "subdomains": edge**3, "processes": comm.size}
        missing = [n for n in args.solvers if records.find(place | {"solver": n}) is None]
        wanted = args.solvers if args.again else missing
        case = Case(level=level, subdomains_per_edge=edge)
        for name, found in solve(case, wanted, comm, args.memory) if wanted else ():
            record = records.keep(place | {"solver": name}, found)
            command.say(_line(record), comm)


def _line(record: Record) -> str:
    """Format a record of a solver as a line."""
    name = f"level {record['level']}, {record['solver']:<18}"
    if record["converged_reason"] < 0:
        return f"{name} {record.get('note') or 'did not converge'}"
    return (
        f"{name} {record['iterations']:>4} it., set-up {record['seconds_setup']:.2f} s, solve "
        f"{record['seconds_solve']:.2f} s"
    )


def _create_parser(comm: MPI.Comm) -> argparse.ArgumentParser:
    parser = command.create_parser("cube", __doc__, comm)
    add = parser.add_argument
    add("--degree", type=command.some_of((1, 2)), default=[1], help="of displacements; 1")
    add("--level", type=command.several(_level), default=[1], help="of the mesh, 1 to 5; 1")
    edge = {"type": command.several(count), "default": [8], "metavar": "M"}
    add("--subdomains-per-edge", **edge, help="M³ subdomains; 8")
    choices = CHOICES | {"pc": CHOICES["pc_type"], "gluing": ("full",)}
    for name, default in VARIED.items():
        kind = {"type": command.some_of(choices[name]), "default": default.split(",")}
        text = f"{command.names(choices[name])}; {default}"
        add("--" + name.replace("_", "-"), **kind, help=text)
    modes = {"type": command.count_or_zero, "default": 0}
    add("--coarse-modes", **modes, help="soft modes in the coarse space; 0")
    add("--reorthogonalize", action="store_true", help="CG with full reorthogonalisation")
    jump = {"type": command.several(positive), "default": [1.0]}
    add("--jump", **jump, help="factor of the stiff subdomains; 1")
    add("--pattern", choices=tuple(PATTERNS), default="none", help="which subdomains are stiff")
    point = {"type": _outside, "default": Case().source, "metavar": "X,Y,Z"}
    add("--source", **point, help="source point of the fundamental solution; 2,2,2")
    add("--sets", type=_all_or(tuple(SETS)), help=f"all, or some of {command.names(SETS)}")
    add("--solvers", type=_all_or(SOLVERS), help=f"all, or some of {command.names(SOLVERS)}")
    command.add_records(parser, memory=True)
    return parser


def _all_or(choices: Sequence[object]) -> object:
    """Return a type for ``all`` or some of the choices."""
    some = command.some_of(choices)
    return lambda text: list(choices) if text == "all" else some(text)


def _level(text: str) -> object:
    if text.lstrip("-").isdecimal() and int(text) < LEVELS[0]:
        raise argparse.ArgumentTypeError(
            f"{text!r} would make more subdomains than cells: choose one of {command.names(LEVELS)}"
        )
    return command.one_of(LEVELS)(text)


def _outside(text: str) -> tuple[float, ...]:
    point: tuple[float, ...] = ()
    with suppress(ValueError):
        point = tuple(float(word) for word in text.split(","))
    if len(point) != 3 or not all(map(math.isfinite, point)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a point X,Y,Z")
    if all(0.0 <= c <= 1.0 for c in point):
        raise argparse.ArgumentTypeError(
            f"{text!r} lies in the unit cube, where the exact solution has to be smooth: choose a "
            "point outside, for example 2,2,2"
        )
    return point
