# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's nonlinear study: iterations and seconds per Newton step of a first load step.

    mpirun -n 2 python3 -m benchmarks.nonlinear --geometry vessel --json build/nonlinear.json

Both variants, three preconditioners and κ = 10, 100, 1000 kPa, with the paper's choices and with
the package's own (section *Arterial model on a realistic mesh geometry*). A wall of one layer
stands for the paper's aorta, one of two layers, at the highest κ, for its carotid artery. Last come
decompositions in which one subdomain touches the clamped rim in three points, and not at all.

A thin wall at rest would buckle under 1 mmHg: the vessel takes `--pressure 0.2`. A case that took
more than --most-iterations is run again if more are allowed; a failure is recorded with the reason.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import product

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from benchmarks.common import command, paper
from benchmarks.common.clock import Stopwatch
from benchmarks.common.pages import FORMS, Fields, groups, section
from benchmarks.common.records import Record
from benchmarks.common.study import Arguments, Keep, Study
from benchmarks.common.walls import first_step
from benchmarks.common.walls.first_step import (
    ARTERIES,
    CHOICES,
    CONTACTS,
    LAYERS,
    PRECONDITIONERS,
    TYPES,
)
from benchmarks.common.walls.problem import summarise, volume_ratios
from dolfinx_feti import ConvergenceError
from dolfinx_feti.output import writable_folder
from meshes.arguments import count, positive
from meshes.walls import open_wall

KAPPA = (10.0, 100.0, 1000.0)

#: Most Newton steps: with the paper's tangent as many as it took at least.
NEWTON_STEPS = {"paper": 4, "default": 20}

#: What a mesh and its decomposition are told by.
WALL = ("geometry", "size", "degree", "layers", "subdomains", "processes", "pressure")


def _options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    command.add_mesh(parser)
    add("--degree", type=int, choices=(1, 2), default=1, help="of the displacements, 1")
    add("--kappa", type=command.several(positive), default=list(KAPPA), help="[kPa], 10,100,1000")
    add("--pressure", type=positive, default=1.0, help="the load [mmHg], 1")
    add("--subdomains", type=count, default=32, help="over all processes, 32")
    command.add_choices(parser, "--layers", tuple(LAYERS))
    command.add_choices(parser, "--type", tuple(TYPES))
    command.add_choices(parser, "--pc", PRECONDITIONERS)
    command.add_choices(parser, "--choices", tuple(CHOICES))
    add("--most-iterations", type=count, default=10_000, help="of a linear solve, 10000")


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases that a command line asks for, the strong preconditioners first."""
    shared = {name: getattr(args, name) for name in ("geometry", "size", "degree", "pressure")}
    shared |= {"subdomains": args.subdomains, "processes": comm.size}  # before a rim is cut off
    ends = dict.fromkeys((min(args.kappa), max(args.kappa)))
    walls = [
        ("whole", layers, kappa, pc)
        for layers in args.layers
        for kappa in (args.kappa if layers == 1 else [max(args.kappa)])
        for pc in reversed(PRECONDITIONERS)
    ]
    walls += [(contact, 1, kappa, "dirichlet") for contact in CONTACTS[1:] for kappa in ends]
    for wall, choices, kind in product(walls, args.choices, args.type):
        case = dict(zip(("contact", "layers", "kappa", "pc"), wall, strict=True))
        if case["layers"] in args.layers and case["pc"] in args.pc:
            yield shared | case | {"choices": choices, "type": kind}


def _run(case: Record, keep: Keep, args: Arguments, comm: MPI.Comm) -> None:
    """Load a wall, torn into parts, and record what it took. Collective.

    The record is of the whole load step, or of the Newton steps before a linear solve that took
    more than --most-iterations (``iterations_exceed``) or failed (``failure``).
    """
    folder = writable_folder(args.folder, comm)
    wall, _ = open_wall(args.geometry, comm, size=args.size, folder=folder)
    part = first_step.partition(wall, args.subdomains, str(case["contact"]))
    most = args.most_iterations
    own = {"feti_type": case["type"], "feti_pc_type": case["pc"], "ksp_max_it": most}
    own["snes_max_it"] = NEWTON_STEPS[str(case["choices"])]
    body = first_step.create(wall, case, part, own)
    ksp, watch = body.problem.solver.getKSP(), Stopwatch(comm)
    watch.hook(ksp)
    found: Record = {}
    try:
        first_step.load(body, case["pressure"], in_part=case["choices"] == "paper")
    except ConvergenceError as error:
        if ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT:
            found["iterations_exceed"] = most
        else:
            found["failure"] = str(error)
    steps, own_clock = body.problem.history, comm.size == 1
    each = watch.processor() if own_clock else watch.each()
    setup, krylov = map(float, each.sum(axis=0) / max(len(each), 1))
    its = [step.linear_iterations for step in steps]
    found |= first_step.sizes(body) | {
        "cells": wall.mesh.topology.index_map(3).size_global,
        "clock": "processor" if own_clock else "wall",
        "newton_iterations": len(steps),
        "linear_iterations_per_newton": its,
        "linear_iterations_mean": float(np.mean(its)) if its else None,
        "linear_methods": [step.linear_method for step in steps],
        "linear_residuals": [step.linear_residual for step in steps],
        "seconds_setup_per_newton": setup,
        "seconds_krylov_per_newton": krylov,
    }
    if is_solved(found):
        found |= summarise(volume_ratios(body.u), comm)
    keep({}, found)


def is_solved(record: Record) -> bool:
    """Tell whether the wall arrived."""
    return "failure" not in record and "iterations_exceed" not in record


def _fields(records: Sequence[Record]) -> Fields:
    usual = [record for record in records if record["contact"] == "whole"]
    return {
        "walls": [_newton_step(mine) for _, mine in groups(usual, *WALL)],
        "volumes": section(_volumes(usual)),
        "contacts": section(_contacts(records)),
        "failures": section(_named(r) for r in records if not is_solved(r)),
    }


def _named(record: Record) -> Record:
    """Return a record with the names of its parameters."""
    return record | {
        "kind": TYPES[str(record["type"])],
        "wall": LAYERS[int(record["layers"])],
        "chosen": CHOICES[str(record["choices"])],
        "why": record.get("failure", f"more than {record.get('iterations_exceed')} iterations"),
    }


def _newton_step(records: Sequence[Record]) -> dict[str, object]:
    """Return a Newton step on one wall, in the paper and here, with both choices."""
    first = records[0]
    layers, degree = int(first["layers"]), int(first["degree"])
    by_case = {(r["type"], r["kappa"], r["pc"], r["choices"]): r for r in records}
    rows = []
    for case in product(TYPES, sorted({r["kappa"] for r in records}), PRECONDITIONERS):
        ours = {name: by_case.get((*case, name)) for name in CHOICES}
        if any(ours.values()):
            row = {"kind": TYPES[case[0]], "kappa": case[1], "pc": case[2]}
            if theirs := paper.NONLINEAR.get((layers, degree, *case)):
                its, seconds = theirs
                its = FORMS["count"](its) if its else "> 10 000"
                row |= {"their_its": its, "their_seconds": seconds}
            rows.append(row | {name: _cells(r) for name, r in ours.items()})
    known = [r for r in records if "multipliers" in r]
    most = {name: max((r[name] for r in known), default=0) for name in ("dofs", "cells")}
    edges = "" if first["size"] is None else f", edges of {first['size']:g} mm"
    names = {"artery": ARTERIES[layers], "wall": LAYERS[layers], "edges": edges}
    names |= dict(zip(("their_cells", "their_vertices"), paper.MESHES[layers], strict=True))
    names |= {"their_subdomains": paper.SUBDOMAINS[layers, degree]}
    return {name: first[name] for name in WALL} | most | names | {"rows": rows}


def _cells(record: Record | None) -> dict[str, object]:
    """Return mean iterations, those of each step, and seconds; or what was missing."""
    if record is None:
        return {}
    if "iterations_exceed" in record:
        return {"its": f"> {FORMS['count'](record['iterations_exceed'])}"}
    if "failure" in record:
        return {"its": "failed"}
    steps = " ".join(map(str, record["linear_iterations_per_newton"]))
    return record | {"its": FORMS["count"](record["linear_iterations_mean"]), "steps": steps}


def _volumes(usual: Sequence[Record]) -> list[Record]:
    """Return J by wall, which does not depend on how a system is solved."""
    solved = [r for r in usual if is_solved(r) and r["choices"] == "default"]
    rows = [_named(mine[0]) for _, mine in groups(solved, *WALL, "kappa")]
    names = ("geometry", "layers", "kappa", "degree", "cells")
    return sorted(rows, key=lambda r: tuple(r[name] for name in names))


def _contacts(records: Sequence[Record]) -> Iterator[Record]:
    """Yield the cases of a subdomain that touches the clamped rim in a few points, or not."""
    touched = [r for r in records if r["contact"] != "whole"]
    names = ("geometry", "degree", "kappa", "pc", "choices", "type")
    for _, mine in sorted(groups(touched, *names), key=lambda item: item[0]):
        yield _named(mine[0]) | {str(r["contact"]): _cells(r) for r in mine}


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="nonlinear",
    known=lambda record: "contact" in record and "linear_iterations_per_newton" in record,
    options=_options,
    cases=_cases,
    run=_run,
    done=lambda case, records, args: all(
        r.get("iterations_exceed", args.most_iterations) >= args.most_iterations
        for r in records.all(case) or [{"iterations_exceed": 0}]
    ),
    fields=_fields,
)

if __name__ == "__main__":
    STUDY.main()
