# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The inflated tube against its semi-analytical solution at the same κ.

    python3 -m benchmarks.verification --part tube --pressures 10,100,300  --json FILE

A record for each pressure: radius, thickness, volume and stress beside the truth, and what it took
to get there from rest, failed attempts included. A run that does not arrive leaves a record of
where it ended.

Options with a single dash are PETSc's, with the prefix `tube_`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from mpi4py import MPI

from benchmarks.common import command
from benchmarks.common.pages import Fields, groups
from benchmarks.common.plots import COLOURS, curve, picture
from benchmarks.common.records import Record, Records
from benchmarks.common.study import Keep
from benchmarks.common.walls.inflated_tube import (
    ELEMENTS,
    create_inflated_tube,
    create_slice,
)
from benchmarks.common.walls.oracle import KPA_PER_MMHG, Wall, inflate
from dolfinx_feti import ConvergenceError
from dolfinx_feti.loading import LoadStep, Steps
from meshes.arguments import count, positive

__all__ = ["STEPS", "cases", "done", "draw", "fields", "known", "options", "run"]


#: With multipliers: the most that the mean volume of a cell may be off, and κ of the truth [kPa].
VOLUME, INCOMPRESSIBLE = 1e-6, float("inf")

STEPS = Steps(first=10.0, least=0.5, growth=2.0)

CASE = (
    "element",
    "size",
    "c",
    "kappa",
    "augmented",
    "subdomains",
    "processes",
)


#: Ways to solve one problem: element, multipliers, name and how it is drawn.
WAYS = (
    ("p2-p0", False, "P2–P0", {"color": COLOURS[2], "marker": "^"}),
    ("p2-p0", True, "P2–P0, λ", {"color": COLOURS[2], "ls": ":", "marker": "^"}),
    ("p2b-p1d", False, "P2⁺–P1disc", {"color": COLOURS[0], "marker": "^"}),
    ("p2b-p1d", True, "P2⁺–P1disc, λ", {"color": COLOURS[0], "ls": ":", "marker": "^"}),
    ("q2-p1d", False, "Q2–P1disc", {"color": COLOURS[1], "marker": "s"}),
    ("q2-p1d", True, "Q2–P1disc, λ", {"color": COLOURS[1], "ls": ":", "marker": "s"}),
)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this part."""
    add = parser.add_argument
    pressures = {"type": command.several(positive), "default": [10.0, 100.0, 300.0]}
    add("--pressures", **pressures, help="[mmHg], rising")
    add("--c", type=positive, default=3.0, help="[kPa], 3")
    add("--kappa", type=positive, default=1000.0, help="[kPa], 1000")
    add("--size", type=positive, default=0.09, help="length of the elements' edges [mm], 0.09")
    add("--element", choices=ELEMENTS, default="p2-p0", help="displacements and pressure, p2-p0")
    add("--augmented", action="store_true", help="multipliers: the tube keeps its volume")
    add("--subdomains", type=count, default=8, help="over all processes, 8")


def cases(
    args: argparse.Namespace, parser: argparse.ArgumentParser, comm: MPI.Comm
) -> Iterator[Record]:
    """Yield the tube that the options describe."""
    if args.pressures != sorted(args.pressures):
        parser.error(f"argument --pressures: {args.pressures} do not rise")
    degree = ELEMENTS[args.element].degree
    yield {name: getattr(args, name) for name in CASE[:-1]} | {
        "degree": degree, "processes": comm.size
    }  # fmt: skip


def done(case: Record, records: Records, args: argparse.Namespace) -> bool:
    """Tell whether each pressure has a record."""
    return all(records.all(case | {"pressure_mmhg": p}) for p in args.pressures)


def run(case: Record, keep: Keep, args: argparse.Namespace, comm: MPI.Comm) -> None:
    """Inflate the tube; keep a record for each pressure reached, and one of the failure, if any."""
    tube = create_inflated_tube(
        create_slice(comm, size=args.size, element=args.element),
        c=args.c,
        kappa=args.kappa,
        subdomains=args.subdomains,
        element=args.element,
        volume_tolerance=VOLUME if args.augmented else None,
    )
    steps: list[LoadStep] = []

    def report(step: LoadStep) -> None:
        steps.append(step)
        if step.load in args.pressures:
            kappa = INCOMPRESSIBLE if args.augmented else args.kappa
            truth = inflate(step.load * KPA_PER_MMHG, Wall(c=args.c, kappa=kappa))
            found = {"dofs": tube.body.dofs} | tube.compare(truth)
            if args.augmented:
                changes = tube.body.problem.volume_changes
                found |= {"volume_change": changes[-1], "updates": len(changes)}
            keep({"pressure_mmhg": step.load}, _cost(steps) | found)

    try:
        tube.body.inflate(args.pressures, STEPS, on_step=report)
    except ConvergenceError as error:
        reached = steps[-1].load if steps else 0.0
        missed = next(pressure for pressure in args.pressures if pressure > reached)
        lost = {"reached_mmhg": reached, "error": str(error)}
        keep({"pressure_mmhg": missed}, _cost(steps) | lost)


def known(record: Record) -> bool:
    """Tell whether a record is one of this part."""
    return "element" in record


def _cost(steps: Sequence[LoadStep]) -> Record:
    """Count what load steps took, their failed attempts included."""
    newton = [s for step in steps for s in step.all_steps]
    ratios = [s.linear_residual / s.linear_rtol for s in newton if s.linear_rtol > 0.0]
    return {
        "steps": len(steps),
        "failures": sum(step.failures for step in steps),
        "newton_iterations": len(newton),
        "linear_iterations": sum(s.linear_iterations for s in newton),
        "max_linear_ratio": max(ratios, default=0.0),
        "linear_methods": sorted({s.linear_method for s in newton}),
        "seconds": sum(step.seconds for step in steps),
    }


def fields(records: Sequence[Record]) -> Fields:
    """Return each way at the highest pressure, and where a run did not arrive."""
    return {"lost": [r for r in records if "error" in r], "ways": [{"rows": _ways(records)}]}


def _ways(records: Sequence[Record]) -> list[Fields]:
    """Return each way at the highest pressure, coarse and fine."""
    reached = [r for r in records if "error" not in r]
    top = max((r["pressure_mmhg"] for r in reached), default=0.0)
    return [
        record | {"way": name, "style": style}
        for element, augmented, name, style in WAYS
        for record in sorted(reached, key=lambda r: -float(r["size"]))
        if (record["element"], record["augmented"]) == (element, augmented)
        and record["pressure_mmhg"] == top
    ]


def draw(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw the errors of both stresses over dofs and over seconds."""
    rows = _ways(records)
    if not rows:
        return []
    with picture(folder / "tube.png", 2, 2, {r["way"]: r["style"] for r in rows}) as axes:
        for line, stress in zip(axes, ("tt", "rr"), strict=True):
            for ax, over in zip(line, ("dofs", "seconds"), strict=True):
                for _, mine in groups(rows, "way"):
                    points = [(r[over], r[f"recovered_{stress}_error"]) for r in mine]
                    curve(ax, points, **mine[0]["style"])
                ax.set(xscale="log", yscale="log", xlabel=over)
                ax.set_ylabel({"tt": "error of σ_θθ", "rr": "error of σ_rr"}[stress])
    return [{"picture": "tube.png"}]
