# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's load stepping: both variants up to 300 mmHg (section "Load stepping scheme").

    python3 -m benchmarks.load_stepping --geometry vessel --pressure 300 --json build/loading.json

The wall of `demos/demo_artery.py`, or the tube, with c = 6 kPa, κ = 1000 kPa, 32 subdomains and the
Dirichlet preconditioner, is inflated in load steps that adapt, once by all-floating and once by
classical FETI. A record for each accepted step holds its cost, displacement norm and stress
magnitude at five points A–E, and how well the elements keep their volume. With `--checkpoint
FOLDER` a run that was interrupted is continued; one that is finished is not repeated, unless by
`--again`. `benchmarks.load_figures` draws the paper's figures.

At such pressures the wall of the vessel, a cerebral aneurysm with the material of a carotid artery,
is a numerical benchmark and no physiology.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import petsc4py

petsc4py.init([word for word in sys.argv if not word.startswith("--")])

from mpi4py import MPI

import numpy as np

from benchmarks.common.arguments import (
    add_records,
    count_or_zero,
    create_parser,
    one_of,
    open_checkpoint,
    open_records,
    parse_words,
    several,
)
from benchmarks.common.machine import describe
from benchmarks.common.progress import say
from benchmarks.common.records import Record, Records
from benchmarks.walls.points import NAMES, at_points, five_points
from benchmarks.walls.problem import WallProblem, create_wall_problem
from benchmarks.walls.volume import summarise, volume_ratios
from dolfinx_feti import ConvergenceError
from dolfinx_feti.collective import on_first
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps
from dolfinx_feti.output import writable_folder
from dolfinx_feti.wall import Wall
from meshes.arguments import count, positive
from meshes.walls import CREATE, create_wall

__all__ = ["main"]

TYPES = ("all_floating", "classical")
PHYSICS = ("geometry", "size", "degree", "c", "kappa")
LEAST = 0.05  # mmHg

#: Newton steps that a load step may take: on the way down from fold to fold they are many.
NEWTON_STEPS = 100


def main(argv: Sequence[str] | None = None) -> int:
    """Run both variants.

    Args:
        argv: The command line without the program's name; None for that of the process.

    Returns:
        How many of them did not arrive.

    Raises:
        SystemExit: A word of the command line is wrong, or a file cannot be written.
    """
    comm = MPI.COMM_WORLD
    parser = _create_parser(comm)
    args = parse_words(parser, argv)
    records = open_records(args.json, parser, comm)
    wall, _ = create_wall(
        args.geometry, comm, size=args.size, folder=writable_folder(args.folder, comm)
    )
    shared = {name: getattr(args, name) for name in (*PHYSICS, "subdomains", "rtol", "recycle")}
    lost = 0
    for kind in args.type:
        case: Record = shared | {"type": kind, "processes": comm.size}
        if not args.again and records.find(case | {"pressure_mmhg": args.pressure}) is not None:
            say(f"{kind}: {args.pressure:g} mmHg is in the records already", comm)
            continue
        checkpoint = _checkpoint(args, case, parser, comm)
        try:
            inflate(case, wall, records, args.pressure, args.first, checkpoint)
        except ConvergenceError as error:
            say(f"{kind}: {error}", comm)
            lost += 1
    return lost


def inflate(
    case: Record,
    wall: Wall,
    records: Records,
    pressure: float,
    first: float,
    checkpoint: Checkpoint | None,
) -> None:
    """Inflate a wall by one variant, with a record for each accepted load step.

    Args:
        case: Parameters of the run, for the records.
        wall: Mesh, layers and surfaces.
        records: Where the records go.
        pressure: Where to arrive [mmHg].
        first: The first increment [mmHg].
        checkpoint: Where load steps are kept.

    Raises:
        ConvergenceError: The wall did not arrive.

    Note:
        Collective.
    """
    comm = wall.mesh.comm
    body = create_wall_problem(
        wall,
        degree=case["degree"],
        c=case["c"],
        kappa=case["kappa"],
        subdomains=case["subdomains"],
        options={
            "feti_type": case["type"],
            "feti_recycle": case["recycle"],
            "ksp_rtol": case["rtol"],
            "snes_max_it": NEWTON_STEPS,
        },
    )
    points = five_points(wall.mesh)
    restarted = checkpoint is not None and checkpoint.restart
    done = len(checkpoint.record["steps"]) if restarted else 0

    def report(step: LoadStep) -> None:
        nonlocal done
        done += 1
        found = {"steps": done} | cost(step) | state(body, points) | {"machine": describe()}
        key = case | {"pressure_mmhg": step.load}
        say(_line(records.put(key, key | found)), comm)

    steps = Steps(first=first, least=min(LEAST, first))
    body.inflate([pressure], steps, on_step=report, checkpoint=checkpoint)


def cost(step: LoadStep) -> Record:
    """Return what an accepted load step took."""
    solved = step.all_steps
    return {
        "increment_mmhg": step.increment,
        "newton_iterations": len(solved),
        "linear_iterations": sum(s.linear_iterations for s in solved),
        "linear_iterations_mean": float(np.mean([s.linear_iterations for s in step.history])),
        "max_linear_residual": max(s.linear_residual for s in step.history),
        "failures": step.failures,
        "largest_shift": max(s.shift for s in solved),
        "negative": step.history[-1].negative,
        "seconds": step.seconds,
    }


def state(body: WallProblem, points: Sequence[np.ndarray]) -> Record:
    """Return displacement norm and stress magnitude at the points, and the volume ratios.

    Note:
        Collective.
    """
    norm, stress = at_points(body, points)
    return {
        "u_norm": dict(zip(NAMES, norm.tolist(), strict=True)),
        "stress_magnitude": dict(zip(NAMES, stress.tolist(), strict=True)),
        **asdict(summarise(volume_ratios(body.u), body.u.function_space.mesh.comm)),
    }


def _create_parser(comm: MPI.Comm) -> argparse.ArgumentParser:
    parser = create_parser("load_stepping", __doc__, comm)
    add = parser.add_argument
    add("--geometry", choices=tuple(CREATE), default="vessel")
    add("--size", type=positive, default=None, help="length of the elements' edges [mm]")
    add("--type", type=several(one_of(TYPES)), default=list(TYPES), help=",".join(TYPES))
    add("--pressure", type=positive, default=300.0, help="[mmHg], 300")
    add("--first", type=positive, default=10.0, help="increment of the pressure [mmHg], 10")
    add("--degree", type=one_of((1, 2)), default=1, help="of the displacements, 1")
    add("--c", type=positive, default=6.0, help="[kPa], 6")
    add("--kappa", type=positive, default=1000.0, help="[kPa], 1000")
    add("--subdomains", type=count, default=32, help="over all processes, 32")
    add("--rtol", type=positive, default=1e-8, help="of the linear systems, 1e-8")
    add("--recycle", type=count_or_zero, default=0, help="most recycled directions, 0")
    add("--checkpoint", type=Path, metavar="FOLDER", help="where the last states are kept")
    add("--folder", type=Path, default=Path("build/walls"), help="where meshes are kept")
    add_records(parser)
    return parser


def _checkpoint(
    args: argparse.Namespace, case: Record, parser: argparse.ArgumentParser, comm: MPI.Comm
) -> Checkpoint | None:
    """Open the folder of a variant; a run that was interrupted is continued there."""
    if args.checkpoint is None:
        return None
    folder = args.checkpoint / f"{case['geometry']}-{case['type']}"
    there = on_first(lambda: (folder / "latest.json").exists(), comm)
    if there and args.again:
        parser.error(f"--again begins anew, but {folder} holds a run: name another folder")
    physics = {name: case[name] for name in (*PHYSICS, "type")}
    return open_checkpoint(folder, parser, comm, parameters=physics, restart=there)


def _line(record: Record) -> str:
    """Format a record as a line."""
    return (
        f"{record['type']:<13}{record['pressure_mmhg']:8.3f} mmHg "
        f"{record['newton_iterations']:3d} Newton steps of {record['linear_iterations_mean']:.0f} "
        f"FETI iterations, {record['seconds']:.1f} s"
    )


if __name__ == "__main__":
    sys.exit(main())
