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
`benchmarks.nonlinear_page` makes the page.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import petsc4py

petsc4py.init([word for word in sys.argv if not word.startswith("--")])

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from benchmarks.common.arguments import (
    create_parser,
    one_of,
    open_records,
    parse_words,
    several,
)
from benchmarks.common.machine import describe, now
from benchmarks.common.progress import Bar, say
from benchmarks.common.records import Record, Records
from benchmarks.common.repeatable import fix_partitions
from benchmarks.nonlinear_tables.groups import LAYERS, PRECONDITIONERS, TYPES, is_known
from benchmarks.walls.newton_case import CHOICES, Case, is_finished, run
from benchmarks.walls.rims import CONTACTS, partition
from dolfinx_feti.output import writable_folder
from dolfinx_feti.wall.fibres import fibre_frame
from meshes.arguments import count, positive
from meshes.walls import CREATE, create_wall

__all__ = ["main", "plan"]

KAPPA = (10.0, 100.0, 1000.0)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study, or what is left of it.

    Args:
        argv: The command line without the program's name; None for that of the process.

    Returns:
        The exit status, 0; what a case came to is in its record.

    Raises:
        SystemExit: A word of the command line is wrong, or the file cannot be used.
    """
    comm = MPI.COMM_WORLD
    fix_partitions()
    parser = _create_parser(comm)
    args = parse_words(parser, argv)
    records = open_records(args.json, parser, comm, known=is_known, writer="benchmarks.nonlinear")
    cases = [
        case
        for case in plan(args, comm.size)
        if args.again or not is_finished(records.find(case.key()), args.most_iterations)
    ]
    known = len(plan(args, comm.size)) - len(cases)
    if known:
        say(f"{known} case(s) are in the records already", comm)
    if cases:
        try:
            _run_all(cases, args, records, comm)
        except ValueError as error:  # of the decomposition, before any case
            parser.error(str(error))
    return 0


def plan(args: argparse.Namespace, processes: int) -> list[Case]:
    """Return the cases that a command line asks for, the strong preconditioners first."""
    return list(_cases(args, processes))


def _cases(args: argparse.Namespace, processes: int) -> Iterator[Case]:
    usual = Case(
        geometry=args.geometry,
        size=args.size,
        layers=1,
        degree=args.degree,
        subdomains=args.subdomains,
        contact="whole",
        kappa=max(args.kappa),
        pressure=args.pressure,
        type="all_floating",
        pc="dirichlet",
        choices="paper",
        processes=processes,
    )
    for layers in args.layers if "whole" in args.contact else ():
        for kappa in args.kappa if layers == 1 else [max(args.kappa)]:
            for pc in sorted(args.pc, key=PRECONDITIONERS.index, reverse=True):
                wall = replace(usual, layers=layers, kappa=kappa, pc=pc)
                yield from _variants(wall, args)
    if 1 in args.layers and "dirichlet" in args.pc:
        for contact in (contact for contact in CONTACTS[1:] if contact in args.contact):
            for kappa in dict.fromkeys((min(args.kappa), max(args.kappa))):
                yield from _variants(replace(usual, contact=contact, kappa=kappa), args)


def _variants(case: Case, args: argparse.Namespace) -> Iterator[Case]:
    """Both variants with both choices."""
    for choices in args.choices:
        for kind in args.type:
            yield replace(case, choices=choices, type=kind)


def _run_all(
    cases: Sequence[Case], args: argparse.Namespace, records: Records, comm: MPI.Comm
) -> None:
    """Run cases on one wall, each decomposition made once; the records are written after each."""
    folder = writable_folder(args.folder, comm)
    wall, _ = create_wall(args.geometry, comm, size=args.size, folder=folder)
    frame = fibre_frame(wall)
    contacts = dict.fromkeys(case.contact for case in cases)
    parts: dict[str, npt.NDArray[np.int32]] = {
        contact: partition(wall, args.subdomains, contact) for contact in contacts
    }
    bar = Bar(len(cases), comm)
    for case in cases:
        bar.begin(str(case))
        found = run(case, wall, frame, parts[case.contact], most=args.most_iterations)
        record = records.put(case.key(), found | {"machine": describe(), "date": now()})
        bar.end()
        say(_line(case, record), comm)


def _create_parser(comm: MPI.Comm) -> argparse.ArgumentParser:
    parser = create_parser("nonlinear", __doc__, comm)
    add = parser.add_argument

    def add_list(name: str, values: Sequence[object], about: str) -> None:
        text = ",".join(map(str, values))
        kind = several(one_of(values))
        add(name, type=kind, default=list(values), help=f"{about}{text}")

    add("--geometry", choices=tuple(CREATE), default="vessel")
    add("--size", type=positive, default=None, help="length of the elements' edges [mm]")
    add("--degree", type=one_of((1, 2)), default=1, help="of the displacements, 1")
    add("--kappa", type=several(positive), default=list(KAPPA), help="[kPa], 10,100,1000")
    add("--pressure", type=positive, default=1.0, help="the load [mmHg], 1")
    add("--subdomains", type=count, default=32, help="over all processes, 32")
    add_list("--layers", tuple(LAYERS), "of the wall, the paper's aorta and carotid artery: ")
    add_list("--type", tuple(TYPES), "")
    add_list("--pc", PRECONDITIONERS, "preconditioners, ")
    add_list("--choices", tuple(CHOICES), "the paper's and the package's own, ")
    add_list("--contact", CONTACTS, "of one subdomain with the rim: as it comes, points, none; ")
    add("--most-iterations", type=count, default=10_000, help="of a linear solve, 10000")
    add("--folder", type=Path, default=Path("build/walls"), help="where meshes are kept")
    add("--json", type=Path, metavar="FILE", help="records, added to what the file holds")
    add("--again", action="store_true", help="also run cases that the file has")
    return parser


def _line(case: Case, record: Record) -> str:
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
    return f"{case}: {end}"


if __name__ == "__main__":
    sys.exit(main())
