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
from dataclasses import dataclass
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

#: κ, the paper's values [kPa].
KAPPAS = (10, 100, 1000)


@dataclass(frozen=True, slots=True, kw_only=True)
class WallDefaults:
    """Parameters of a wall without options.

    Args:
        size: Length of the elements' edges [mm].
        subdomains: Their number.
        pressure: Load [mmHg].
    """

    size: float
    subdomains: int
    pressure: float


#: Walls by name. The paper's 1 mmHg would make the vessel buckle.
WALLS = {
    "tube": WallDefaults(size=0.3, subdomains=8, pressure=1.0),
    "vessel": WallDefaults(size=1.19, subdomains=64, pressure=0.2),
}

#: Keys that distinguish cases.
NAMES = ("geometry", "degree", "layers", "contact", "kappa", "pc", "choices", "type")
#: Sets of values of all keys but the last two. The cases are all combinations in a set, with all
#: choices and types.
SETS = (
    (["tube"], [1, 2], [1], ["whole"], KAPPAS, PRECONDITIONERS),
    (["tube"], [1, 2], [2], ["whole"], [1000], PRECONDITIONERS),
    (["tube"], [1, 2], [1], ["few", "none"], [10, 1000], ["dirichlet"]),
    (["vessel"], [1], [1], ["whole"], [10, 100], PRECONDITIONERS),
    (["vessel"], [1], [1], ["whole"], [1000], ["lumped", "dirichlet"]),
    (["vessel"], [2], [1], ["whole"], [10], PRECONDITIONERS),
    (["vessel"], [2], [1], ["whole"], [100], ["dirichlet"]),
)

#: Most Newton steps. With the paper's tangent they are as many as the paper took at least.
NEWTON_STEPS = {"paper": 4, "default": 20}

#: Keys of a mesh, its decomposition and load.
WALL_KEYS = ("geometry", "size", "degree", "layers", "subdomains", "processes", "pressure")


def _options(parser: argparse.ArgumentParser) -> None:
    possible = (WALLS, (1, 2), LAYERS, CONTACTS, KAPPAS, PRECONDITIONERS, CHOICES, TYPES)
    for name, values in zip(NAMES, possible, strict=True):
        command.add_choices(parser, f"--{name}", tuple(values))
    command.add_size(parser)
    parser.add_argument("--subdomains", type=count, help="over all processes; tube 8, vessel 64")
    parser.add_argument("--pressure", type=positive, help="the load [mmHg]; tube 1, vessel 0.2")


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the cases that a command line chooses."""
    for values_of_set in SETS:
        values_of_names = zip(NAMES, (*values_of_set, CHOICES, TYPES), strict=True)
        chosen = (
            [value for value in values if value in getattr(args, name)]
            for name, values in values_of_names
        )
        for combination in product(*chosen):
            case = dict(zip(NAMES, combination, strict=True))
            defaults = WALLS[case["geometry"]]
            yield case | {
                "kappa": float(case["kappa"]),
                "size": args.size or defaults.size,
                "subdomains": args.subdomains or defaults.subdomains,  # before a rim is cut off
                "pressure": args.pressure or defaults.pressure,
                "processes": comm.size,
            }


def _run(case: Record, keep: Keep, args: Arguments, comm: MPI.Comm) -> None:
    """Load the wall of a case, and keep a record of sizes, iterations and seconds. Collective.

    If Newton's method fails, the record has the reason as ``failure``.
    """
    folder = writable_folder(args.folder, comm)
    wall, _ = open_wall(case["geometry"], comm, size=case["size"], folder=folder)
    part = first_step.partition(wall, case["subdomains"], case["contact"])
    options = {
        "feti_type": case["type"],
        "feti_pc_type": case["pc"],
        "snes_max_it": NEWTON_STEPS[case["choices"]],
    }
    body = first_step.create(wall, case, part, options)
    ksp = body.problem.solver.getKSP()
    watch = Stopwatch(comm)
    watch.hook(ksp)
    values: Record = {}
    try:
        first_step.load(body, case["pressure"], allow_max_steps=case["choices"] == "paper")
    except ConvergenceError as error:
        values["failure"] = str(error)
    steps = body.problem.history
    has_processor_time = comm.size == 1
    seconds = watch.processor_times() if has_processor_time else watch.wall_times()
    setup, krylov = map(float, seconds.sum(axis=0) / max(len(seconds), 1))
    iterations = [step.linear_iterations for step in steps]
    values |= first_step.sizes(body) | {
        "cells": wall.mesh.topology.index_map(3).size_global,
        "clock": "processor" if has_processor_time else "wall",
        "newton_iterations": len(steps),
        "linear_iterations_per_newton": iterations,
        "linear_iterations_mean": float(np.mean(iterations)) if iterations else None,
        "linear_methods": [step.linear_method for step in steps],
        "linear_residuals": [step.linear_residual for step in steps],
        "seconds_setup_per_newton": setup,
        "seconds_krylov_per_newton": krylov,
    }
    if "failure" not in values:
        values |= summarise(volume_ratios(body.u), comm)
    keep({}, values)


def _fields(records: Sequence[Record]) -> Fields:
    """Return the sections of the page; a wall's section has cases with whole rims only."""
    with_whole_rims = [record for record in records if record["contact"] == "whole"]
    return {
        "compared": list(_compared_rows(with_whole_rims, "geometry", "choices")),
        "walls": [_wall_section(of_wall) for _, of_wall in groups(with_whole_rims, *WALL_KEYS)],
        "volumes": section(_volume_rows(with_whole_rims)),
        "contacts": section(_contact_rows(records)),
        "failures": section(_named(record) for record in records if "failure" in record),
    }


def _named(record: Record) -> Record:
    """Return a record with the names of its parameters."""
    return record | {
        "kind": TYPES[record["type"]],
        "wall": LAYERS[record["layers"]],
        "chosen": CHOICES[record["choices"]],
    }


def _wall_section(records: Sequence[Record]) -> dict[str, object]:
    """Return the section of one wall: its Newton steps in the paper and here, with both choices."""
    first = records[0]
    layers = first["layers"]
    degree = first["degree"]
    rows = []
    for (kind, kappa, pc), of_row in groups(records, "type", "kappa", "pc"):
        place = list(TYPES).index(kind), kappa, PRECONDITIONERS.index(pc)
        row = _named(of_row[0]) | {"place": place, "sources": of_row}
        row |= {record["choices"]: _costs(record) for record in of_row}
        printed = _printed_step(of_row[0])
        if printed is not None:
            iterations, row["their_seconds"] = printed
            row["their_its"] = FORMS["count"](iterations) if iterations else "> 10 000"
        rows.append(row)
    return first | {
        "artery": ARTERIES[layers],
        "wall": LAYERS[layers],
        "their_cells": paper.CELLS[layers],
        "their_dofs": paper.DOFS[layers, degree],
        "their_subdomains": paper.SUBDOMAINS[layers, degree],
        "compared": list(_compared_rows(records, "choices")),
        "rows": sorted(rows, key=lambda row: row["place"]),
    }


def _compared_rows(records: Sequence[Record], *names: str) -> Iterator[Record]:
    """Yield a row for each value of some parameters: iterations over the paper's.

    Args:
        records: Records of cases; those without iterations, here or in the paper, are left out.
        names: Keys of the parameters.
    """
    comparable = [record for record in records if _iterations_ratio(record) is not None]
    for _, of_row in sorted(groups(comparable, *names), key=lambda item: item[0], reverse=True):
        ratios = [_iterations_ratio(record) for record in of_row]
        yield _named(of_row[0]) | {
            "least": min(ratios),
            "most": max(ratios),
            "more": sum(ratio > 1 for ratio in ratios),
            "of": len(ratios),
            "sources": of_row,
        }


def _iterations_ratio(record: Record) -> float | None:
    """Return the mean iterations of a case over the paper's; None without one of them."""
    printed_iterations, _ = _printed_step(record) or (None, None)
    if "failure" in record or printed_iterations is None:
        return None
    return record["linear_iterations_mean"] / printed_iterations


def _printed_step(record: Record) -> tuple[int | None, float | None] | None:
    """Return iterations and seconds of the paper for a case, or None."""
    case = tuple(record[name] for name in ("layers", "degree", "type", "kappa", "pc"))
    return paper.NONLINEAR.get(case)


def _costs(record: Record) -> Record:
    """Return a record with its mean iterations and those of each step as text, or "failed"."""
    if "failure" in record:
        return {"its": "failed"}
    steps = ", ".join(map(str, record["linear_iterations_per_newton"]))
    return record | {"its": FORMS["count"](record["linear_iterations_mean"]), "steps": steps}


def _volume_rows(records: Sequence[Record]) -> list[Record]:
    """Return a row of volume ratios for each wall and κ; they do not depend on the solver."""
    solved = [r for r in records if "failure" not in r and r["choices"] == "default"]
    rows = [_named(of_row[0]) for _, of_row in groups(solved, *WALL_KEYS, "kappa")]
    names = ("geometry", "layers", "kappa", "degree", "cells")
    return sorted(rows, key=lambda r: tuple(r[name] for name in names))


def _contact_rows(records: Sequence[Record]) -> Iterator[Record]:
    """Yield a row for each case whose subdomain touches the rim in a few points, or not at all."""
    cut = [r for r in records if r["contact"] != "whole"]
    names = ("geometry", "degree", "kappa", "pc", "choices", "type")
    for _, of_row in sorted(groups(cut, *names), key=lambda item: item[0]):
        costs = {record["contact"]: _costs(record) for record in of_row}
        yield _named(of_row[0]) | costs | {"sources": of_row}


def _is_known(record: Record) -> bool:
    """Return True if a record is one of this study."""
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
