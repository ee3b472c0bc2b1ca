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
from benchmarks.common.records import Record, Records
from benchmarks.common.study import Arguments, Keep
from benchmarks.common.verification.part import Part
from benchmarks.common.walls.inflated_tube import ELEMENTS, create_inflated_tube, create_slice
from benchmarks.common.walls.oracle import KPA_PER_MMHG, Wall, inflate
from dolfinx_feti.loading import LoadStep, Steps
from dolfinx_feti.meshes.arguments import count, positive

#: Bound of the relative change of volume of each cell, with multipliers.
VOLUME_TOLERANCE = 1e-6
#: κ of the exact solution, with multipliers [kPa].
INCOMPRESSIBLE = float("inf")

#: Increments of the pressure [mmHg], and their growth.
STEPS = Steps(first=10.0, least=0.5, growth=2.0)

#: Pressure at which κ is compared [mmHg]: that of an artery.
ARTERIAL = 100.0

#: Options that are keys of a case.
CASE = ("element", "size", "c", "kappa", "augmented", "subdomains")

#: Name of each pair on the page, and its style in the figure, which is dotted with multipliers.
STYLES = {
    "p2-p0": ("P2–P0", {"color": COLOURS[2], "marker": "^"}),
    "p2b-p1d": ("P2⁺–P1disc", {"color": COLOURS[0], "marker": "^"}),
    "q2-p1d": ("Q2–P1disc", {"color": COLOURS[1], "marker": "s"}),
}


def _options(parser: argparse.ArgumentParser) -> None:
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


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    """Yield the tube that the options describe.

    Raises:
        ValueError: The pressures do not rise.
    """
    if args.pressures != sorted(args.pressures):
        raise ValueError(f"argument --pressures: {args.pressures} do not rise")
    degree = ELEMENTS[args.element].degree
    yield {name: getattr(args, name) for name in CASE} | {"degree": degree, "processes": comm.size}


def _run(case: Record, keep: Keep, args: Arguments, comm: MPI.Comm) -> None:
    """Inflate the tube; keep a record for each pressure. Collective."""
    tube = create_inflated_tube(
        create_slice(comm, size=case["size"], element=case["element"]),
        c=case["c"],
        kappa=case["kappa"],
        subdomains=case["subdomains"],
        element=case["element"],
        volume_tolerance=VOLUME_TOLERANCE if case["augmented"] else None,
    )
    steps: list[LoadStep] = []

    def report(step: LoadStep) -> None:
        steps.append(step)
        if step.load in args.pressures:
            kappa = INCOMPRESSIBLE if case["augmented"] else case["kappa"]
            truth = inflate(step.load * KPA_PER_MMHG, Wall(c=case["c"], kappa=kappa))
            values = _cost(steps) | {"dofs": tube.body.dofs} | tube.compare(truth)
            if case["augmented"]:
                changes = tube.body.problem.volume_changes
                values |= {"volume_change": changes[-1], "updates": len(changes)}
            keep({"pressure_mmhg": step.load}, values)

    tube.body.inflate(args.pressures, STEPS, on_step=report, unit="mmHg")


def _is_done(case: Record, records: Records, args: Arguments) -> bool:
    """Return True if each of the pressures has a record."""
    return all(records.all(case | {"pressure_mmhg": p}) for p in args.pressures)


def _cost(steps: Sequence[LoadStep]) -> Record:
    """Return the cost of all load steps, with their failed attempts."""
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


def _fields(records: Sequence[Record]) -> Fields:
    """Return rows of elements and sizes at the highest pressure, and of each κ at ARTERIAL."""
    highest = max((record["pressure_mmhg"] for record in records), default=0.0)
    rows = []
    for record in records:
        if record["pressure_mmhg"] == highest:
            name, style = STYLES[record["element"]]
            if record["augmented"]:
                name = f"{name}, λ"
                style = style | {"ls": ":"}
            rows.append(record | {"way": name, "style": style, "sources": [record]})
    order = list(STYLES)
    rows.sort(key=lambda r: (order.index(r["element"]), r["augmented"], -r["size"]))
    kappas = [
        {**record, "way": STYLES[record["element"]][0], "sources": [record]}
        for record in records
        if record["pressure_mmhg"] == ARTERIAL and not record["augmented"]
    ]
    kappas.sort(key=lambda r: (order.index(r["element"]), -r["size"], r["kappa"]))
    return {"ways": [{"rows": rows}], "kappas": section(kappas), "arterial": ARTERIAL}


def _draw(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw the errors of both stresses over dofs and over seconds."""
    rows = _fields(records)["ways"][0]["rows"]
    if not rows:
        return []
    with picture(folder / "tube.png", 2, 2, {r["way"]: r["style"] for r in rows}) as axes:
        for line, stress in zip(axes, ("tt", "rr"), strict=True):
            for ax, over in zip(line, ("dofs", "seconds"), strict=True):
                for _, of_element in groups(rows, "way"):
                    points = [(row[over], row[f"recovered_{stress}_error"]) for row in of_element]
                    curve(ax, points, **of_element[0]["style"])
                ax.set(xscale="log", yscale="log", xlabel=over)
                ax.set_ylabel({"tt": "error of σ_θθ", "rr": "error of σ_rr"}[stress])
    return [{"picture": "tube.png"}]


TUBE = Part(
    key="element",
    values=ELEMENTS,
    options=_options,
    cases=_cases,
    run=_run,
    fields=_fields,
    done=_is_done,
    draw=_draw,
)
