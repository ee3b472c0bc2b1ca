# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's nonlinear study: iterations and seconds per Newton step of a first load step.

    mpirun -n 2 python3 -m benchmarks.nonlinear --geometry vessel --json build/nonlinear.json

Both variants, three preconditioners and κ = 10, 100, 1000 kPa, with the paper's choices and with
the package's own (section *Arterial model on a realistic mesh geometry*, tables
Augustin_tab:aorta_linear, carotis_linear, aorta_quadratic, carotis_quadratic). A wall of one layer
stands for the paper's aorta, one of two layers, at the highest κ, for its carotid artery. Last come
decompositions in which one subdomain touches the clamped rim in three points, and not at all, at
the lowest and the highest κ.

The paper's choices include its tangent, without that of the pressure: CG solves all systems, and
the first four Newton steps are taken. Its load is 1 mmHg, under which a thin wall at rest, which
has no tension yet, would buckle: the vessel takes `--pressure 0.2`.

A case that is in the file is not run again, unless by --again; one whose Krylov method took more
than --most-iterations is, if more are allowed. A case that fails is recorded with the reason.
`benchmarks.nonlinear.page` makes the page.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import product

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from benchmarks.common import command
from benchmarks.common.clock import Stopwatch
from benchmarks.common.records import Record, Records
from benchmarks.common.walls import first_step
from benchmarks.common.walls.first_step import CHOICES, LAYERS, PRECONDITIONERS, TYPES
from benchmarks.common.walls.problem import WallProblem
from benchmarks.common.walls.volume import summarise, volume_ratios
from benchmarks.nonlinear.rims import CONTACTS, Parts, partition
from dolfinx_feti import ConvergenceError
from dolfinx_feti.output import writable_folder
from dolfinx_feti.wall import Wall
from dolfinx_feti.wall.fibres import Frame, fibre_frame
from meshes.arguments import count, positive
from meshes.walls import open_wall

__all__ = ["is_known", "is_solved", "main"]

KAPPA = (10.0, 100.0, 1000.0)

#: Most Newton steps: with the paper's tangent as many as it took at least.
NEWTON_STEPS = {"paper": 4, "default": 20}

#: How one subdomain meets the rim, see ``rims``.
RIM = {"whole": "", "few": ", few points on the rim", "none": ", off the rim"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study, or what is left of it; what a case came to is in its record."""
    comm = MPI.COMM_WORLD
    parser = _create_parser(comm)
    args = command.parse_words(parser, argv)
    records = command.open_records(args.json, parser, comm, is_known)
    plan = list(_cases(args, comm.size))
    cases = [
        case
        for case in plan
        if args.again or not is_finished(records.find(case), args.most_iterations)
    ]
    if len(cases) < len(plan):
        command.say(f"{len(plan) - len(cases)} case(s) are in the records already", comm)
    if cases:
        try:
            _run_all(cases, args, records, comm)
        except ValueError as error:  # of the decomposition, before any case
            parser.error(str(error))
    return 0


def _cases(args: argparse.Namespace, processes: int) -> Iterator[Record]:
    """Yield the cases that a command line asks for, the strong preconditioners first."""
    usual: Record = {
        "geometry": args.geometry,
        "size": args.size,
        "layers": 1,
        "degree": args.degree,
        "subdomains": args.subdomains,  # before a rim is cut off
        "contact": "whole",
        "kappa": max(args.kappa),
        "pressure": args.pressure,
        "type": "all_floating",
        "pc": "dirichlet",
        "choices": "paper",
        "processes": processes,
    }
    for layers in args.layers if "whole" in args.contact else ():
        for kappa in args.kappa if layers == 1 else [max(args.kappa)]:
            for pc in sorted(args.pc, key=PRECONDITIONERS.index, reverse=True):
                yield from _variants(usual | {"layers": layers, "kappa": kappa, "pc": pc}, args)
    if 1 in args.layers and "dirichlet" in args.pc:
        for contact in (contact for contact in CONTACTS[1:] if contact in args.contact):
            for kappa in dict.fromkeys((min(args.kappa), max(args.kappa))):
                yield from _variants(usual | {"contact": contact, "kappa": kappa}, args)


def _variants(case: Record, args: argparse.Namespace) -> Iterator[Record]:
    """Both variants with both choices."""
    for choices, kind in product(args.choices, args.type):
        yield case | {"choices": choices, "type": kind}


def _run_all(
    cases: Sequence[Record], args: argparse.Namespace, records: Records, comm: MPI.Comm
) -> None:
    """Run cases on one wall, each decomposition made once; the records are written after each."""
    folder = writable_folder(args.folder, comm)
    wall, _ = open_wall(args.geometry, comm, size=args.size, folder=folder)
    frame = fibre_frame(wall)
    contacts = dict.fromkeys(str(case["contact"]) for case in cases)
    parts = {contact: partition(wall, args.subdomains, contact) for contact in contacts}
    for case in cases:
        found = run(case, wall, frame, parts[str(case["contact"])], most=args.most_iterations)
        record = records.keep(case, found)
        command.say(_line(case, record), comm)


def _create_parser(comm: MPI.Comm) -> argparse.ArgumentParser:
    parser = command.create_parser("nonlinear", __doc__, comm)
    add = parser.add_argument

    def add_list(name: str, values: Sequence[object], about: str) -> None:
        text = ",".join(map(str, values))
        kind = command.some_of(values)
        add(name, type=kind, default=list(values), help=f"{about}{text}")

    command.add_mesh(parser)
    add("--degree", type=command.one_of((1, 2)), default=1, help="of the displacements, 1")
    add("--kappa", type=command.several(positive), default=list(KAPPA), help="[kPa], 10,100,1000")
    add("--pressure", type=positive, default=1.0, help="the load [mmHg], 1")
    add("--subdomains", type=count, default=32, help="over all processes, 32")
    add_list("--layers", tuple(LAYERS), "of the wall, the paper's aorta and carotid artery: ")
    add_list("--type", tuple(TYPES), "")
    add_list("--pc", PRECONDITIONERS, "preconditioners, ")
    add_list("--choices", tuple(CHOICES), "the paper's and the package's own, ")
    add_list("--contact", CONTACTS, "of one subdomain with the rim: as it comes, points, none; ")
    add("--most-iterations", type=count, default=10_000, help="of a linear solve, 10000")
    command.add_records(parser)
    return parser


def _line(case: Record, record: Record) -> str:
    """Format a record as a line."""
    its = record["linear_iterations_per_newton"]
    if "failure" in record:
        end = f"failed after {len(its)} Newton steps: {record['failure']}"
    elif "iterations_exceed" in record:
        end = f"more than {record['iterations_exceed']} iterations in a linear solve"
    else:
        setup, krylov = (record[f"seconds_{part}_per_newton"] for part in ("setup", "krylov"))
        end = (
            f"{len(its)} Newton steps of {', '.join(map(str, its))} iterations, "
            f"{setup:.2f} + {krylov:.2f} s each"
        )
    return (
        f"{case['geometry']}, {case['layers']} layer(s), P{case['degree']}–P0, κ = "
        f"{case['kappa']:g}, {case['type']}, {case['pc']}, {case['choices']}"
        f"{RIM[str(case['contact'])]}: {end}"
    )


def run(case: Record, wall: Wall, frame: Frame, part: Parts, *, most: int) -> Record:
    """Load a wall with its directions, torn into parts, and record what it took. Collective.

    The record is of the whole load step, or of the Newton steps before a linear solve that took
    more than ``most`` iterations (``iterations_exceed``) or failed (``failure``).
    """
    own = {"feti_type": case["type"], "feti_pc_type": case["pc"], "ksp_max_it": most}
    own["snes_max_it"] = NEWTON_STEPS[str(case["choices"])]
    body = first_step.create(wall, frame, case, part, own)
    ksp = body.problem.solver.getKSP()
    clock = "processor" if wall.mesh.comm.size == 1 else "wall"
    watch = Stopwatch(wall.mesh.comm, clock=clock)
    watch.hook(ksp)
    found: Record = {}
    try:
        first_step.load(body, case["pressure"], in_part=case["choices"] == "paper")
    except ConvergenceError as error:
        if ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT:
            found["iterations_exceed"] = most
        else:
            found["failure"] = str(error)
    cells = wall.mesh.topology.index_map(3).size_global
    found |= first_step.sizes(body) | {"cells": cells, "clock": clock}
    record = case | found | dict(_cost(body, watch))
    if is_solved(record):
        record |= summarise(volume_ratios(body.u), wall.mesh.comm)
    return record


def is_known(record: Record) -> bool:
    """Tell whether a record is one of this study."""
    return "contact" in record and "linear_iterations_per_newton" in record


def is_solved(record: Record) -> bool:
    """Tell whether the wall arrived."""
    return "failure" not in record and "iterations_exceed" not in record


def is_finished(record: Record | None, most: int) -> bool:
    """Tell whether a record needs no further run with so many iterations allowed."""
    return record is not None and record.get("iterations_exceed", most) >= most


def _cost(body: WallProblem, watch: Stopwatch) -> Iterator[tuple[str, object]]:
    """Yield iterations and seconds of the Newton steps that were completed."""
    steps = body.problem.history
    yield "newton_iterations", len(steps)
    yield "linear_iterations_per_newton", [s.linear_iterations for s in steps]
    yield "linear_methods", [s.linear_method for s in steps]
    yield "linear_residuals", [s.linear_residual for s in steps]
    yield "step_lengths", [s.step_length for s in steps]
    if steps:
        yield "linear_iterations_mean", float(np.mean([s.linear_iterations for s in steps]))
        yield "seconds_assembly_per_newton", float(np.mean([s.seconds_assembly for s in steps]))
    each = watch.each()
    setup, krylov = map(float, each.sum(axis=0) / max(len(each), 1))
    yield "seconds_setup_per_newton", setup
    yield "seconds_krylov_per_newton", krylov
