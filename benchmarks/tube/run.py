# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""The inflated tube against its semi-analytical solution at the same κ.

    python3 -m benchmarks.tube --pressures 10,100,300 --c 3 --kappa 1000 --quarter \
        --subdomains 8 --json build/tube.json

A record for each pressure: radius, thickness, volume and stress beside the truth, and what it took
to get there from rest, failed attempts included. A run that does not arrive leaves a record of
where it ended. With --checkpoint FOLDER a run that was killed is continued by --restart.

Options with a single dash are PETSc's, with the prefix `tube_`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from mpi4py import MPI

from benchmarks.common import command
from benchmarks.common.records import Record
from benchmarks.common.walls.inflated_tube import (
    ELEMENTS,
    TANGENTS,
    create_inflated_tube,
    create_slice,
)
from benchmarks.common.walls.oracle import KPA_PER_MMHG, Wall, inflate
from benchmarks.common.walls.problem import WallProblem
from dolfinx_feti import ConvergenceError
from dolfinx_feti.loading import LoadStep, Steps
from dolfinx_feti.loading.steps import load_step
from meshes.arguments import count, positive

__all__ = ["STEPS", "main"]

#: With multipliers: the most that the mean volume of a cell may be off, and κ of the truth [kPa].
VOLUME, INCOMPRESSIBLE = 1e-6, float("inf")

STEPS = Steps(first=10.0, least=0.5, growth=2.0)


def main(argv: Sequence[str] | None = None) -> list[Record]:
    """Inflate a tube; return a record for each pressure reached, and one of the failure, if any."""
    comm = MPI.COMM_WORLD
    parser = command.create_parser("tube", __doc__, comm)
    add = parser.add_argument
    pressures = {"type": command.several(positive), "default": [10.0, 100.0, 300.0]}
    add("--pressures", **pressures, help="[mmHg], rising")
    add("--c", type=positive, default=3.0, help="[kPa], 3")
    add("--kappa", type=positive, default=1000.0, help="[kPa], 1000")
    add("--size", type=positive, default=0.09, help="length of the elements' edges [mm], 0.09")
    add("--element", choices=ELEMENTS, default="p2-p0", help="displacements and pressure, p2-p0")
    degree = {"dest": "element", "choices": ("p1-p0", "p2-p0"), "default": argparse.SUPPRESS}
    add("--degree", type="p{}-p0".format, metavar="1|2", **degree, help="--element p1-p0 or p2-p0")
    add("--augmented", action="store_true", help="multipliers: the tube keeps its volume")
    add("--quarter", action="store_true", help="only a quarter, between planes of symmetry")
    add("--tangent", choices=TANGENTS, default="symmetric", help="of the follower pressure")
    add("--subdomains", type=count, default=8, help="over all processes, 8")
    add("--checkpoint", type=Path, metavar="FOLDER", help="keep each load step")
    add("--restart", action="store_true", help="continue from the checkpoint")
    add("--json", type=Path, metavar="FILE", help="records, added to what the file holds")
    args = command.parse_words(parser, argv)
    if args.pressures != sorted(args.pressures):
        parser.error(f"argument --pressures: {args.pressures} do not rise")
    if args.restart and args.checkpoint is None:
        parser.error("argument --restart: it needs --checkpoint FOLDER, the run to continue")
    continuous = ELEMENTS[args.element].pressures[0] == "Lagrange"
    if continuous and (args.augmented or args.checkpoint or args.tangent != "symmetric"):
        parser.error(f"argument --element: {args.element} goes without --augmented and the like")
    names = ("c", "kappa", "size", "element", "augmented", "quarter", "subdomains", "tangent")
    case: Record = {name: getattr(args, name) for name in names} | {
        "degree": ELEMENTS[args.element].degree,
        "processes": comm.size,
    }
    file = command.open_records(args.json, parser, comm)
    physics = {name: case[name] for name in ("c", "kappa", "element", "augmented")}
    checkpoint = command.open_checkpoint(
        args.checkpoint, parser, comm, parameters=physics, restart=args.restart
    )
    tube = create_inflated_tube(
        create_slice(comm, size=args.size, quarter=args.quarter, element=args.element),
        **{name: case[name] for name in ("element", "c", "kappa", "subdomains", "tangent")},
        volume_tolerance=VOLUME if args.augmented else None,
    )
    records: list[Record] = []
    steps: list[LoadStep] = []
    if checkpoint is not None and checkpoint.record is not None:
        steps = [load_step(step, LoadStep) for step in checkpoint.record["steps"]]

    def put(pressure: float, found: Record) -> None:
        key = case | {"pressure_mmhg": pressure}
        records.append(file.put(key, key | _cost(steps) | found))
        command.say(_line(records[-1]), comm)

    def report(step: LoadStep) -> None:
        steps.append(step)
        if step.load in args.pressures:
            kappa = INCOMPRESSIBLE if args.augmented else args.kappa
            truth = inflate(step.load * KPA_PER_MMHG, Wall(c=args.c, kappa=kappa))
            found = {"dofs": tube.body.dofs} | tube.compare(truth)
            if isinstance(tube.body, WallProblem) and args.augmented:
                changes = tube.body.problem.volume_changes
                found |= {"volume_change": changes[-1], "updates": len(changes)}
            put(step.load, found)

    try:
        tube.body.inflate(args.pressures, STEPS, on_step=report, checkpoint=checkpoint)
    except ConvergenceError as error:
        reached = steps[-1].load if steps else 0.0
        missed = next(pressure for pressure in args.pressures if pressure > reached)
        put(missed, {"reached_mmhg": reached, "error": str(error)})
    return records


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


def _line(record: Record) -> str:
    """Format a record as a line."""
    cost = (
        f"{record['steps']:3d} steps {record['newton_iterations']:4d} Newton "
        f"{record['linear_iterations']:6d} FETI"
    )
    if "error" in record:
        return f"{record['reached_mmhg']:7.1f} mmHg {cost}, and no further: {record['error']}"
    error = record["u_r_inner"] / record["u_r_inner_exact"] - 1.0
    return (
        f"{record['pressure_mmhg']:7.1f} mmHg {cost}  u_r {record['u_r_inner']:.5f} mm "
        f"({100 * error:+.2f} %)  J {record['min_J']:.3f} … {record['max_J']:.3f}"
    )
