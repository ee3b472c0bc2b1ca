# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's load stepping: both variants up to 300 mmHg (section "Load stepping scheme").

    python3 -m benchmarks.load_stepping --geometry vessel --pressure 300 --json build/loading.json

The wall of `demos/demo_artery.py`, or the tube, with c = 6 kPa, κ = 1000 kPa, 32 subdomains and the
Dirichlet preconditioner, is inflated in load steps that adapt, once by all-floating and once by
classical FETI. A record for each accepted step says what it cost, and displacement norm and stress
magnitude at five points A–E. A run that is ended goes on where it was (`--checkpoint FOLDER`); one
that is finished is not repeated (`--again`). `benchmarks.load_figures` draws the paper's figures.

At such pressures the wall of the vessel, a cerebral aneurysm with the material of a carotid artery,
is a numerical benchmark and no physiology.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import petsc4py

petsc4py.init([word for word in sys.argv if not word.startswith("--")])

from mpi4py import MPI  # noqa: E402

import numpy as np  # noqa: E402
import numpy.typing as npt  # noqa: E402

import dolfinx  # noqa: E402

from benchmarks.arguments import (  # noqa: E402
    add_records,
    count,
    count_or_none,
    create_parser,
    one_of,
    open_records,
    parse_words,
    positive,
    several,
)
from benchmarks.machine import describe  # noqa: E402
from benchmarks.records import Record, Records  # noqa: E402
from benchmarks.wall_problem import WallProblem, create_wall_problem  # noqa: E402
from benchmarks.walls import CREATE, create_wall  # noqa: E402
from dolfinx_feti import ConvergenceError, kinematics, loads  # noqa: E402
from dolfinx_feti.loading import (  # noqa: E402
    Checkpoint,
    LoadStep,
    Steps,
    follow_load,
)
from dolfinx_feti.output import cell_values, writable_folder  # noqa: E402
from dolfinx_feti.wall import Wall  # noqa: E402

__all__ = ["main"]

Array = npt.NDArray[np.float64]

TYPES = ("all_floating", "classical")
NAMES = "ABCDE"
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
    add("--recycle", type=count_or_none, default=100, help="most recycled directions, 100")
    add("--checkpoint", type=Path, metavar="FOLDER", help="where the last states are kept")
    add("--folder", type=Path, default=Path("build/walls"), help="where meshes are kept")
    add_records(parser)
    args = parse_words(parser, argv)
    records = open_records(args.json, parser, comm)
    folder = writable_folder(args.folder, comm)
    wall, _ = create_wall(args.geometry, comm, size=args.size, folder=folder)
    lost = 0
    for kind in args.type:
        case = {key: getattr(args, key) for key in ("geometry", "size", "degree", "c", "kappa")}
        case |= {"type": kind, "subdomains": args.subdomains, "processes": comm.size}
        case |= {"rtol": args.rtol, "recycle": args.recycle}
        if not args.again and records.find(case | {"pressure_mmhg": args.pressure}) is not None:
            _say(f"{kind}: {args.pressure:g} mmHg stand in the records already", comm)
            continue
        folder = args.checkpoint and args.checkpoint / f"{args.geometry}-{kind}"
        checkpoint = None
        if folder is not None:
            there = comm.bcast((folder / "latest.json").exists())
            if there and args.again:
                parser.error(f"--again begins anew, but {folder} holds a run: name another folder")
            physics = {key: case[key] for key in ("geometry", "size", "degree", "c", "kappa")}
            try:
                checkpoint = Checkpoint(
                    folder, comm, parameters=physics | {"type": kind}, restart=there
                )
            except (OSError, ValueError) as error:
                parser.error(str(error))
        steps = Steps(first=args.first, least=min(LEAST, args.first))
        lost += not _Run(case, wall, records, checkpoint).inflate(args.pressure, steps)
    return lost


class _Run:
    """One variant on its way."""

    def __init__(
        self, case: Record, wall: Wall, records: Records, checkpoint: Checkpoint | None
    ) -> None:
        self._case, self._records, self._checkpoint = case, records, checkpoint
        self._comm = wall.mesh.comm
        self._body = create_wall_problem(
            wall,
            degree=case["degree"],
            c=case["c"],
            kappa=case["kappa"],
            subdomains=case["subdomains"],
            options={
                "feti_type": case["type"],
                "feti_dual_recycle": case["recycle"],
                "ksp_rtol": case["rtol"],
                "snes_max_it": NEWTON_STEPS,
            },
        )
        self._points = five_points(wall.mesh)
        restarted = checkpoint is not None and checkpoint.restart
        self._steps = len(checkpoint.record["steps"]) if restarted else 0

    def inflate(self, pressure: float, steps: Steps) -> bool:
        """Go up to a pressure [mmHg]; return whether it was reached."""
        body = self._body

        def set_load(mmhg: float) -> None:
            body.pressure.value = loads.mmhg(mmhg)

        try:
            follow_load(
                body.problem,
                set_load,
                [pressure],
                steps,
                state=[body.u, body.p],
                on_step=self._report,
                checkpoint=self._checkpoint,
                unit="mmHg",
            )
        except ConvergenceError as error:
            _say(f"{self._case['type']}: {error}", self._comm)
            return False
        return True

    def _report(self, step: LoadStep) -> None:
        """Write a record of an accepted step, and say it."""
        solved = step.all_steps
        self._steps += 1
        norm, stress = at_points(self._body, self._points)
        record = self._case | {
            "pressure_mmhg": step.load,
            "increment_mmhg": step.increment,
            "steps": self._steps,
            "newton_iterations": len(solved),
            "linear_iterations": sum(s.linear_iterations for s in solved),
            "linear_iterations_mean": float(np.mean([s.linear_iterations for s in step.history])),
            "max_linear_residual": max(s.linear_residual for s in step.history),
            "failures": step.failures,
            "largest_shift": max(s.shift for s in solved),
            "negative": step.history[-1].negative,
            "seconds": step.seconds,
            "u_norm": dict(zip(NAMES, norm.tolist(), strict=True)),
            "stress_magnitude": dict(zip(NAMES, stress.tolist(), strict=True)),
            "machine": describe(),
        }
        self._records.put(self._case | {"pressure_mmhg": step.load}, record)
        _say(
            f"{self._case['type']:<13}{step.load:8.3f} mmHg {len(solved):3d} Newton steps of "
            f"{record['linear_iterations_mean']:.0f} FETI iterations, {step.seconds:.1f} s",
            self._comm,
        )


def five_points(mesh: dolfinx.mesh.Mesh) -> list[Array]:
    """Choose five cells far from each other; return which of this process's cells each is, or none.

    The first is the one farthest from the centre of the mesh, each further one the one farthest
    from those before it.
    """
    n = mesh.topology.index_map(3).size_local
    X = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(n, dtype=np.int32))
    count, total = mesh.comm.allreduce(n), mesh.comm.allreduce(X.sum(axis=0))
    distance = np.linalg.norm(X - total / count, axis=1)
    points = []
    for _ in NAMES:
        best = (float(distance.max(initial=-1.0)), -mesh.comm.rank)
        owner = -mesh.comm.allreduce(best, op=MPI.MAX)[1]
        mine = [int(distance.argmax())] if mesh.comm.rank == owner else []
        points.append(np.array(mine, dtype=np.int64))
        x = mesh.comm.bcast(X[mine[0]] if mine else None, root=owner)
        nearest = np.linalg.norm(X - x, axis=1)
        distance = nearest if len(points) == 1 else np.minimum(distance, nearest)
    return points


def at_points(body: WallProblem, points: Sequence[Array]) -> tuple[Array, Array]:
    """Return u_norm [mm] and σ_mag [kPa] at the points, on all processes."""
    mesh = body.u.function_space.mesh
    norm = np.linalg.norm(cell_values(body.u, mesh), axis=1)
    stress = cell_values(kinematics.stress_magnitude(body.stress), mesh)
    own = np.array([[norm[cell].sum(), stress[cell].sum()] for cell in points])
    return tuple(mesh.comm.allreduce(own).T)


def _say(text: str, comm: MPI.Comm) -> None:
    if comm.rank == 0:
        print(text, flush=True)


if __name__ == "__main__":
    sys.exit(main())
