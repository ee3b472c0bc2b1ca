# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Nonlinear study of the paper: iterations and seconds per Newton step of a first load step.

    python3 -m benchmarks.nonlinear --geometry vessel --degree 1 --json build/nonlinear.json

The cases have both variants, three preconditioners and κ = 10, 100, 1000 kPa, with the paper's
choices and with the package's own (section *Arterial model on a realistic mesh geometry*). A wall
of one layer represents the paper's aorta. A wall of two layers, at the highest κ, represents its
carotid artery. In some decompositions one subdomain touches the clamped rim in three points, or not
at all. The options select cases. The cases of the vessel are those that take less than two hours. A
case that fails is recorded with the reason.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import product

from mpi4py import MPI

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
from dolfinx_feti.meshes.arguments import count, positive
from dolfinx_feti.meshes.walls import open_wall
from dolfinx_feti.output import writable_folder

KAPPA = (10, 100, 1000)

#: Edges [mm], subdomains and load [mmHg]. The paper's 1 mmHg would make the vessel buckle.
WALLS = {"tube": (0.3, 8, 1.0), "vessel": (1.19, 64, 0.2)}

#: Keys that distinguish cases, and sets of values: all combinations, with all choices and types.
NAMES = ("geometry", "degree", "layers", "contact", "kappa", "pc", "choices", "type")
SETS = (
    (["tube"], [1, 2], [1], ["whole"], KAPPA, PRECONDITIONERS),
    (["tube"], [1, 2], [2], ["whole"], [1000], PRECONDITIONERS),
    (["tube"], [1, 2], [1], ["few", "none"], [10, 1000], ["dirichlet"]),
    (["vessel"], [1], [1], ["whole"], [10, 100], PRECONDITIONERS),
    (["vessel"], [1], [1], ["whole"], [1000], ["lumped", "dirichlet"]),
    (["vessel"], [2], [1], ["whole"], [10], PRECONDITIONERS),
    (["vessel"], [2], [1], ["whole"], [100], ["dirichlet"]),
)

#: Most Newton steps. With the paper's tangent they are as many as the paper took at least.
NEWTON_STEPS = {"paper": 4, "default": 20}

#: Keys of a mesh and its decomposition.
WALL = ("geometry", "size", "degree", "layers", "subdomains", "processes", "pressure")


def _options(parser: argparse.ArgumentParser) -> None:
    known = (WALLS, (1, 2), LAYERS, CONTACTS, KAPPA, PRECONDITIONERS, CHOICES, TYPES)
    for name, values in zip(NAMES, known, strict=True):
        command.add_choices(parser, f"--{name}", tuple(values))
    command.add_size(parser)
    parser.add_argument("--subdomains", type=count, help="over all processes; tube 8, vessel 64")
    parser.add_argument("--pressure", type=positive, help="the load [mmHg]; tube 1, vessel 0.2")


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases that a command line chooses."""
    asked = [getattr(args, name) for name in NAMES]
    for some in SETS:
        pairs = zip((*some, CHOICES, TYPES), asked, strict=True)
        chosen = ([value for value in values if value in wanted] for values, wanted in pairs)
        for each in product(*chosen):
            case = dict(zip(NAMES, each, strict=True))
            size, subdomains, pressure = WALLS[case["geometry"]]
            yield case | {
                "kappa": float(case["kappa"]),
                "size": args.size or size,
                "subdomains": args.subdomains or subdomains,  # before a rim is cut off
                "pressure": args.pressure or pressure,
                "processes": comm.size,
            }


def _run(case: Record, keep: Keep, args: Arguments, comm: MPI.Comm) -> None:
    """Load the wall of a case, and keep a record of sizes, iterations and seconds. Collective.

    If Newton's method fails, the record has the reason as ``failure``.
    """
    folder = writable_folder(args.folder, comm)
    wall, _ = open_wall(case["geometry"], comm, size=case["size"], folder=folder)
    part = first_step.partition(wall, case["subdomains"], case["contact"])
    own = {"feti_type": case["type"], "feti_pc_type": case["pc"]}
    own["snes_max_it"] = NEWTON_STEPS[case["choices"]]
    body = first_step.create(wall, case, part, own)
    ksp = body.problem.solver.getKSP()
    watch = Stopwatch(comm)
    watch.hook(ksp)
    found: Record = {}
    try:
        first_step.load(body, case["pressure"], allow_max_steps=case["choices"] == "paper")
    except ConvergenceError as error:
        found["failure"] = str(error)
    steps = body.problem.history
    own_clock = comm.size == 1
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
    if "failure" not in found:
        found |= summarise(volume_ratios(body.u), comm)
    keep({}, found)


def _fields(records: Sequence[Record]) -> Fields:
    usual = [record for record in records if record["contact"] == "whole"]
    return {
        "compared": list(_compared(usual, "geometry", "choices")),
        "walls": [_newton_step(mine) for _, mine in groups(usual, *WALL)],
        "volumes": section(_volumes(usual)),
        "contacts": section(_contacts(records)),
        "failures": section(_named(r) for r in records if "failure" in r),
    }


def _named(record: Record) -> Record:
    """Return a record with the names of its parameters."""
    return record | {
        "kind": TYPES[record["type"]],
        "wall": LAYERS[record["layers"]],
        "chosen": CHOICES[record["choices"]],
    }


def _newton_step(records: Sequence[Record]) -> dict[str, object]:
    """Return a Newton step on one wall, in the paper and here, with both choices."""
    first = records[0]
    layers = first["layers"]
    degree = first["degree"]
    rows = []
    for (kind, kappa, pc), mine in groups(records, "type", "kappa", "pc"):
        place = list(TYPES).index(kind), kappa, PRECONDITIONERS.index(pc)
        row = _named(mine[0]) | {"place": place, "sources": mine}
        row |= {r["choices"]: _cells(r) for r in mine}
        if theirs := _papers(mine[0]):
            its, row["their_seconds"] = theirs
            row["their_its"] = FORMS["count"](its) if its else "> 10 000"
        rows.append(row)
    return first | {
        "artery": ARTERIES[layers],
        "wall": LAYERS[layers],
        "their_cells": paper.CELLS[layers],
        "their_dofs": paper.DOFS[layers, degree],
        "their_subdomains": paper.SUBDOMAINS[layers, degree],
        "compared": list(_compared(records, "choices")),
        "rows": sorted(rows, key=lambda row: row["place"]),
    }


def _compared(records: Sequence[Record], *names: str) -> Iterator[Record]:
    """Yield, for each value of some parameters, iterations over the paper's of the same case."""
    known = [r for r in records if "failure" not in r and (_papers(r) or [None])[0]]
    for _, mine in sorted(groups(known, *names), key=lambda item: item[0], reverse=True):
        ratios = [r["linear_iterations_mean"] / _papers(r)[0] for r in mine]
        more = sum(ratio > 1 for ratio in ratios)
        found = {"least": min(ratios), "most": max(ratios), "more": more, "of": len(ratios)}
        found["sources"] = mine
        yield _named(mine[0]) | found


def _papers(record: Record) -> tuple[int | None, float | None] | None:
    """Return iterations and seconds of the paper for a case, or None."""
    case = tuple(record[name] for name in ("layers", "degree", "type", "kappa", "pc"))
    return paper.NONLINEAR.get(case)


def _cells(record: Record) -> Record:
    """Return mean iterations, those of each step, and seconds; "failed" for a failure."""
    if "failure" in record:
        return {"its": "failed"}
    steps = ", ".join(map(str, record["linear_iterations_per_newton"]))
    return record | {"its": FORMS["count"](record["linear_iterations_mean"]), "steps": steps}


def _volumes(usual: Sequence[Record]) -> list[Record]:
    """Return a row of volume ratios for each wall and κ; they do not depend on the solver."""
    solved = [r for r in usual if "failure" not in r and r["choices"] == "default"]
    rows = [_named(mine[0]) for _, mine in groups(solved, *WALL, "kappa")]
    names = ("geometry", "layers", "kappa", "degree", "cells")
    return sorted(rows, key=lambda r: tuple(r[name] for name in names))


def _contacts(records: Sequence[Record]) -> Iterator[Record]:
    """Yield a row for each case whose subdomain touches the rim in a few points, or not at all."""
    touched = [r for r in records if r["contact"] != "whole"]
    names = ("geometry", "degree", "kappa", "pc", "choices", "type")
    for _, mine in sorted(groups(touched, *names), key=lambda item: item[0]):
        yield _named(mine[0]) | {"sources": mine} | {r["contact"]: _cells(r) for r in mine}


def _is_known(record: Record) -> bool:
    return record.keys() >= {"contact", "linear_iterations_per_newton", "commit"}


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="nonlinear",
    known=_is_known,
    options=_options,
    cases=_cases,
    run=_run,
    fields=_fields,
)

if __name__ == "__main__":
    STUDY.main()
