# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The inflated tube against its semi-analytical solution at the same κ.

A record for each pressure has radius, thickness, volume and stress with their exact values, and the
cost of the path from rest, failed attempts included.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from mpi4py import MPI

from benchmarks.common import command
from benchmarks.common.pages import Fields, groups, section
from benchmarks.common.plots import COLOURS, curve, picture
from benchmarks.common.records import Record
from benchmarks.common.study import Arguments, Keep
from benchmarks.common.walls.inflated_tube import ELEMENTS, create_inflated_tube, create_slice
from benchmarks.common.walls.oracle import KPA_PER_MMHG, Wall, inflate
from dolfinx_feti.loading import LoadStep, Steps
from dolfinx_feti.meshes.arguments import count, positive

#: With multipliers: bound of the relative change of volume of a cell, and κ of the exact solution.
VOLUME = 1e-6
INCOMPRESSIBLE = float("inf")

STEPS = Steps(first=10.0, least=0.5, growth=2.0)

#: Pressure at which κ is compared [mmHg]: that of an artery.
ARTERIAL = 100.0

CASE = ("element", "size", "c", "kappa", "augmented", "subdomains")

#: Elements: their name on the page and their style in the figure, which is dotted with multipliers.
WAYS = {
    "p2-p0": ("P2–P0", {"color": COLOURS[2], "marker": "^"}),
    "p2b-p1d": ("P2⁺–P1disc", {"color": COLOURS[0], "marker": "^"}),
    "q2-p1d": ("Q2–P1disc", {"color": COLOURS[1], "marker": "s"}),
}


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


def cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the tube that the options describe.

    Raises:
        ValueError: The pressures do not rise.
    """
    if args.pressures != sorted(args.pressures):
        raise ValueError(f"argument --pressures: {args.pressures} do not rise")
    degree = ELEMENTS[args.element].degree
    yield {name: getattr(args, name) for name in CASE} | {"degree": degree, "processes": comm.size}


def run(_case: Record, keep: Keep, args: Arguments, comm: MPI.Comm) -> None:
    """Inflate the tube; keep a record for each pressure. Collective."""
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
            found = _cost(steps) | {"dofs": tube.body.dofs} | tube.compare(truth)
            if args.augmented:
                changes = tube.body.problem.volume_changes
                found |= {"volume_change": changes[-1], "updates": len(changes)}
            keep({"pressure_mmhg": step.load}, found)

    tube.body.inflate(args.pressures, STEPS, on_step=report, unit="mmHg")


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
    """Return rows of elements and sizes at the highest pressure, and of each κ at ARTERIAL."""
    top = max((r["pressure_mmhg"] for r in records), default=0.0)
    rows = []
    for record in (r for r in records if r["pressure_mmhg"] == top):
        name, style = WAYS[record["element"]]
        more = {"way": name, "style": style}
        if record["augmented"]:
            more = {"way": f"{name}, λ", "style": style | {"ls": ":"}}
        rows.append(record | more | {"sources": [record]})
    order = list(WAYS)
    rows.sort(key=lambda r: (order.index(r["element"]), r["augmented"], -r["size"]))
    kappas = [
        {**record, "way": WAYS[record["element"]][0], "sources": [record]}
        for record in records
        if record["pressure_mmhg"] == ARTERIAL and not record["augmented"]
    ]
    kappas.sort(key=lambda r: (order.index(r["element"]), -r["size"], r["kappa"]))
    return {"ways": [{"rows": rows}], "kappas": section(kappas), "arterial": ARTERIAL}


def draw(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw the errors of both stresses over dofs and over seconds."""
    rows = fields(records)["ways"][0]["rows"]
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
