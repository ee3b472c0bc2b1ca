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
`--again`. `benchmarks.load_stepping.page` draws the paper's figures. With `--augmented` multipliers
make the wall incompressible in the end: in the mean, no cell changes its volume by more than 1e-6.

At such pressures the wall of the vessel, a cerebral aneurysm with the material of a carotid artery,
is a numerical benchmark and no physiology.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from mpi4py import MPI

import numpy as np

from benchmarks.common import command
from benchmarks.common.machine import describe
from benchmarks.common.records import Record, Records
from benchmarks.common.walls.problem import WallProblem, create_wall_problem
from benchmarks.common.walls.volume import summarise, volume_ratios
from benchmarks.load_stepping.points import NAMES, at_points, five_points
from dolfinx_feti import ConvergenceError
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps
from dolfinx_feti.output import writable_folder
from dolfinx_feti.runtime.collective import on_first
from dolfinx_feti.wall import Wall
from meshes.arguments import count, positive
from meshes.walls import open_wall

__all__ = ["main"]

TYPES = ("all_floating", "classical")
PHYSICS = ("geometry", "size", "degree", "c", "kappa", "augmented")
LEAST = 0.05  # mmHg

#: With multipliers: the most that the mean volume of a cell may be off.
VOLUME = 1e-6

#: Newton steps that a load step may take: on the way down from fold to fold they are many.
NEWTON_STEPS = 100


def main(argv: Sequence[str] | None = None) -> int:
    """Run both variants; return how many of them did not arrive."""
    comm = MPI.COMM_WORLD
    parser = _create_parser(comm)
    args = command.parse_words(parser, argv)
    records = command.open_records(args.json, parser, comm)
    folder = writable_folder(args.folder, comm)
    wall, _ = open_wall(args.geometry, comm, size=args.size, folder=folder)
    shared = {name: getattr(args, name) for name in (*PHYSICS, "subdomains", "rtol")}
    lost = 0
    for kind in args.type:
        case: Record = shared | {"type": kind, "processes": comm.size}
        if not args.again and records.find(case | {"pressure_mmhg": args.pressure}) is not None:
            command.say(f"{kind}: {args.pressure:g} mmHg is in the records already", comm)
            continue
        checkpoint = _checkpoint(args, case, parser, comm)
        try:
            _inflate(case, wall, records, args, checkpoint)
        except ConvergenceError as error:
            command.say(f"{kind}: {error}", comm)
            lost += 1
    return lost


def _inflate(
    case: Record, wall: Wall, records: Records, args: argparse.Namespace, kept: Checkpoint | None
) -> None:
    """Inflate a wall by one variant, with a record for each accepted load step. Collective."""
    comm = wall.mesh.comm
    body = create_wall_problem(
        wall,
        **{name: case[name] for name in ("degree", "c", "kappa", "subdomains")},
        options={"feti_type": case["type"], "ksp_rtol": case["rtol"], "snes_max_it": NEWTON_STEPS},
        volume_tolerance=VOLUME if case["augmented"] else None,
    )
    points = five_points(wall.mesh)
    done = len(kept.record["steps"]) if kept is not None and kept.restart else 0

    def report(step: LoadStep) -> None:
        nonlocal done
        done += 1
        found = {"steps": done} | _cost(step) | _state(body, points) | {"machine": describe()}
        key = case | {"pressure_mmhg": step.load}
        command.say(_line(records.put(key, key | found)), comm)

    steps = Steps(first=args.first, least=min(LEAST, args.first))
    body.inflate([args.pressure], steps, on_step=report, checkpoint=kept)


def _cost(step: LoadStep) -> Record:
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


def _state(body: WallProblem, points: Sequence[np.ndarray]) -> Record:
    """Return displacement norm, stress magnitude at the points, and volume ratios. Collective."""
    norm, stress = at_points(body, points)
    return {
        "u_norm": dict(zip(NAMES, norm.tolist(), strict=True)),
        "stress_magnitude": dict(zip(NAMES, stress.tolist(), strict=True)),
        **summarise(volume_ratios(body.u), body.u.function_space.mesh.comm),
    }


def _create_parser(comm: MPI.Comm) -> argparse.ArgumentParser:
    parser = command.create_parser("load_stepping", __doc__, comm)
    add = parser.add_argument
    command.add_mesh(parser)
    add("--type", type=command.some_of(TYPES), default=list(TYPES), help=",".join(TYPES))
    add("--pressure", type=positive, default=300.0, help="[mmHg], 300")
    add("--first", type=positive, default=10.0, help="increment of the pressure [mmHg], 10")
    add("--degree", type=command.one_of((1, 2)), default=1, help="of the displacements, 1")
    add("--c", type=positive, default=6.0, help="[kPa], 6")
    add("--kappa", type=positive, default=1000.0, help="[kPa], 1000")
    add("--augmented", action="store_true", help="multipliers: the wall keeps its volume")
    add("--subdomains", type=count, default=32, help="over all processes, 32")
    add("--rtol", type=positive, default=1e-8, help="of the linear systems, 1e-8")
    add("--checkpoint", type=Path, metavar="FOLDER", help="where the last states are kept")
    command.add_records(parser)
    return parser


def _checkpoint(
    args: argparse.Namespace, case: Record, parser: argparse.ArgumentParser, comm: MPI.Comm
) -> Checkpoint | None:
    """Open the folder of a variant; a run that was interrupted is continued there."""
    if args.checkpoint is None:
        return None
    folder = args.checkpoint / f"{case['geometry']}-{case['type']}"
    kept = on_first(lambda: (folder / "state.npz").exists(), comm)
    if kept and args.again:
        parser.error(f"--again begins anew, but {folder} holds a run: name another folder")
    physics = {name: case[name] for name in (*PHYSICS, "type")}
    return command.open_checkpoint(folder, parser, comm, parameters=physics, restart=kept)


def _line(record: Record) -> str:
    """Format a record as a line."""
    return (
        f"{record['type']:<13}{record['pressure_mmhg']:8.3f} mmHg "
        f"{record['newton_iterations']:3d} Newton steps of {record['linear_iterations_mean']:.0f} "
        f"FETI iterations, {record['seconds']:.1f} s"
    )
