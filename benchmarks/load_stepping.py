# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's load stepping: both variants up to 300 mmHg (section "Load stepping scheme").

    python3 -m benchmarks.load_stepping --geometry vessel --pressure 300 --json build/loading.json

A wall is inflated in adaptive load steps, by all-floating and by classical FETI with the Dirichlet
preconditioner. There is a record for each accepted step. It has the cost of the step, displacement
norm and stress magnitude at five points A–E, and how well the elements keep their volume. With
`--checkpoint FOLDER` an interrupted run is continued. The page has the paper's figures
(Augustin_fig:timestepping, …Iterations): the stress magnitude over the relative displacement u_rel
= u_norm / u_max, and u_norm (eq. 57), iterations and seconds over the pressure.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from mpi4py import MPI

import numpy as np

import dolfinx

from benchmarks.common import command
from benchmarks.common.bodies import Body
from benchmarks.common.pages import Fields, groups
from benchmarks.common.plots import COLOURS, picture
from benchmarks.common.records import Record, Records
from benchmarks.common.study import Arguments, Keep, Study
from benchmarks.common.walls.problem import create_wall_problem, summarise, volume_ratios
from dolfinx_feti import kinematics
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps
from dolfinx_feti.meshes.arguments import count, positive
from dolfinx_feti.meshes.walls import open_wall
from dolfinx_feti.output import cell_values, writable_folder
from dolfinx_feti.runtime.arrays import Array, Numbers
from dolfinx_feti.runtime.collective import on_root

#: Names of the points.
NAMES = "ABCDE"

#: Keys that the states of one run have in common.
RUN = ("geometry", "size", "degree", "subdomains", "type")

TYPES = ("all_floating", "classical")

#: Parameters of all cases: stiffness of the matrix material and κ [kPa], and the relative tolerance
#: of the linear systems.
FIXED = {"c": 6.0, "kappa": 1000.0, "rtol": 1e-8}

#: Least increment of the pressure after failures [mmHg].
MIN_INCREMENT = 0.05

#: Most Newton steps of a load step. It takes many of them after a fold, where the wall buckles.
NEWTON_STEPS = 100

#: Name of a run with one subdomain, which is a direct solver.
DIRECT = "one subdomain, direct"

#: Curve of each kind of run.
VARIANTS = {
    "all-floating": {"color": "#8a8f98", "marker": "o"},
    "classical": {"color": "#1c1c1c", "marker": "s", "ls": "--"},
    DIRECT: {"color": COLOURS[1], "marker": "^", "ls": ":"},
}

#: Curve of each point.
POINTS = {name: {"color": colour} for name, colour in zip(NAMES, COLOURS, strict=True)}


def _options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    command.add_mesh(parser)
    command.add_choices(parser, "--type", TYPES)
    add("--pressure", type=positive, default=300.0, help="[mmHg], 300")
    add("--first", type=positive, default=10.0, help="increment of the pressure [mmHg], 10")
    add("--degree", type=int, choices=(1, 2), default=1, help="of the displacements, 1")
    add("--subdomains", type=count, default=32, help="over all processes, 32")
    add("--checkpoint", type=Path, metavar="FOLDER", help="where the last states are kept")


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    names = ("geometry", "size", "degree", "subdomains")
    shared = FIXED | {name: getattr(args, name) for name in names}
    yield from (shared | {"type": kind, "processes": comm.size} for kind in args.type)


def _run(case: Record, keep: Keep, args: Arguments, comm: MPI.Comm) -> None:
    """Inflate the wall of a case, and keep a record of each accepted load step. Collective."""
    folder = writable_folder(args.folder, comm)
    wall, _ = open_wall(args.geometry, comm, size=args.size, folder=folder)
    options = {"feti_type": case["type"], "ksp_rtol": case["rtol"], "snes_max_it": NEWTON_STEPS}
    names = ("degree", "c", "kappa", "subdomains")
    body = create_wall_problem(wall, petsc_options=options, **{name: case[name] for name in names})
    checkpoint = _checkpoint(args, case, comm)
    points = five_points(wall.mesh)
    count_of_steps = 0
    if checkpoint is not None and checkpoint.restart:
        count_of_steps = len(checkpoint.record["steps"])

    def report(step: LoadStep) -> None:
        nonlocal count_of_steps
        count_of_steps += 1
        values = {"steps": count_of_steps} | _cost(step) | _state(body, points)
        keep({"pressure_mmhg": step.load}, values)

    steps = Steps(first=args.first, least=min(MIN_INCREMENT, args.first))
    body.inflate([args.pressure], steps, on_step=report, checkpoint=checkpoint, unit="mmHg")


def _checkpoint(args: Arguments, case: Record, comm: MPI.Comm) -> Checkpoint | None:
    """Return the checkpoint of a variant, which continues an interrupted run, or None.

    Raises:
        ValueError: ``--again`` would overwrite a run.
    """
    if args.checkpoint is None:
        return None
    folder = args.checkpoint / f"{case['geometry']}-{case['type']}"
    has_state = on_root(lambda: (folder / "state.npz").exists(), comm)
    if has_state and args.again:
        raise ValueError(f"--again begins anew, but {folder} holds a run: name another folder")
    return Checkpoint(folder, comm, restart=has_state)


def _cost(step: LoadStep) -> Record:
    """Return the cost of an accepted load step."""
    newton_steps = step.all_steps
    return {
        "increment_mmhg": step.increment,
        "newton_iterations": len(newton_steps),
        "linear_iterations": sum(s.linear_iterations for s in newton_steps),
        "linear_iterations_mean": float(np.mean([s.linear_iterations for s in step.history])),
        "max_linear_residual": max(s.linear_residual for s in step.history),
        "failures": step.failures,
        "largest_shift": max(s.shift for s in newton_steps),
        "negative": step.history[-1].negative,
        "seconds": step.seconds,
    }


def _state(body: Body, points: Sequence[np.ndarray]) -> Record:
    """Return displacement norm, stress magnitude at the points, and volume ratios. Collective."""
    norm, stress = at_points(body, points)
    return {
        "u_norm": dict(zip(NAMES, norm.tolist(), strict=True)),
        "stress_magnitude": dict(zip(NAMES, stress.tolist(), strict=True)),
        **summarise(volume_ratios(body.u), body.u.function_space.mesh.comm),
    }


def five_points(mesh: dolfinx.mesh.Mesh) -> list[Numbers]:
    """Choose five cells far from each other. Collective.

    The first is the cell farthest from the centre of the mesh. Each further one is the cell
    farthest from those before it.

    Returns:
        For each point the number of its cell on the process that owns it, (1,), or nothing, (0,).
    """
    n = mesh.topology.index_map(3).size_local
    X = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(n, dtype=np.int32))
    count = mesh.comm.allreduce(n)
    total = mesh.comm.allreduce(X.sum(axis=0))
    distance = np.linalg.norm(X - total / count, axis=1)
    points = []
    for _ in NAMES:
        best = (float(distance.max(initial=-1.0)), -mesh.comm.rank)
        owner = -mesh.comm.allreduce(best, op=MPI.MAX)[1]
        cell = [int(distance.argmax())] if mesh.comm.rank == owner else []
        points.append(np.array(cell, dtype=np.int64))
        x = mesh.comm.bcast(X[cell[0]] if cell else None, root=owner)
        nearest = np.linalg.norm(X - x, axis=1)
        distance = nearest if len(points) == 1 else np.minimum(distance, nearest)
    return points


def at_points(body: Body, points: Sequence[Numbers]) -> tuple[Array, Array]:
    """Return u_norm [mm] (eq. 57) and σ_mag [kPa] at points, (n_points,) each. Collective.

    Args:
        body: The wall.
        points: For each point its cell on the process that owns it, (1,), or nothing, (0,).
    """
    mesh = body.u.function_space.mesh
    norm = np.linalg.norm(cell_values(body.u, mesh), axis=1)
    stress = cell_values(kinematics.stress_magnitude(body.stress), mesh)
    of_process = np.array([[norm[cell].sum(), stress[cell].sum()] for cell in points])
    return tuple(mesh.comm.allreduce(of_process).T)


def _fields(records: Sequence[Record]) -> Fields:
    """Return the parameters of all runs, and a row for each run."""
    runs = [_by_pressure(of_run) for _, of_run in groups(records, *RUN)]
    parameters = {name: records[0][name] for name in ("c", "kappa")}
    return parameters | {"runs": [_summary(steps) for steps in runs]}


def _by_pressure(steps: Sequence[Record]) -> list[Record]:
    """Return the records of load steps in the order of their pressure."""
    return sorted(steps, key=lambda step: step["pressure_mmhg"])


def _summary(steps: Sequence[Record]) -> dict[str, object]:
    """Return a row with the sums of a run and its last state."""
    columns = {name: [step[name] for step in steps] for name in steps[0]}
    mean_iterations = columns["linear_iterations_mean"]
    seconds = columns["seconds"]
    return steps[-1] | {
        "variant": _variant(steps[0]),
        "sources": steps,
        "load_steps": len(steps),
        "newton": sum(columns["newton_iterations"]),
        "linear": sum(columns["linear_iterations"]),
        "fewest": min(mean_iterations),
        "most": max(mean_iterations),
        "worst": max(columns["max_linear_residual"]),
        "seconds_in_all": None if None in seconds else sum(seconds),
    }


def _variant(step: Record) -> str:
    """Return the name of a run: a key of VARIANTS."""
    return DIRECT if step["subdomains"] == 1 else step["type"].replace("_", "-")


def _draw(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw a picture for each mesh and degree that FETI ran on."""
    pictures = []
    for (geometry, size, degree), of_mesh in groups(records, "geometry", "size", "degree"):
        if any(_variant(step) != DIRECT for step in of_mesh):
            name = str(geometry)
            mesh = str(geometry)
            if size is not None:  # the generator's default
                name = f"{geometry}_{size:g}"
                mesh = f"{geometry}, edges of {size:g} mm"
            file = f"loading_{name}_p{degree}.png"
            _draw_panels(folder / file, _by_pressure(of_mesh))
            pictures.append({"picture": file, "mesh": mesh, "degree": degree})
    return pictures


def _draw_panels(path: Path, records: Sequence[Record]) -> None:
    """Draw the four panels of one wall and degree."""
    runs = {name: [s for s in records if _variant(s) == name] for name in VARIANTS}
    runs = {name: steps for name, steps in runs.items() if steps}
    labels = "displacement norm u_norm [mm]", "FETI iterations of a Newton step"
    with picture(path, 2, 2, POINTS | {name: VARIANTS[name] for name in runs}) as axes:
        stress, *over_pressure = axes.flat
        norm, iterations, seconds = over_pressure
        for ax, label in zip(over_pressure, (*labels, "seconds of a load step"), strict=True):
            ax.set(xlabel="pressure [mmHg]", ylabel=label)
        stress.set(xlabel="relative displacement u_rel", ylabel="stress magnitude σ_mag [kPa]")
        farthest = max(runs.values(), key=lambda steps: steps[-1]["pressure_mmhg"])
        p = [0.0, *(step["pressure_mmhg"] for step in farthest)]
        for name, style in POINTS.items():
            u, sigma = (
                np.array([0.0, *(step[what][name] for step in farthest)])
                for what in ("u_norm", "stress_magnitude")
            )
            stress.plot(u / (u.max() or 1.0), sigma, marker=".", **style)
            norm.plot(p, u, marker=".", **style)
        for name, steps in runs.items():
            p = [step["pressure_mmhg"] for step in steps]
            seconds.plot(p, [step["seconds"] for step in steps], **VARIANTS[name], ms=4)
            if name != DIRECT:
                its = [step["linear_iterations_mean"] for step in steps]
                iterations.plot(p, its, **VARIANTS[name], ms=4)
        for ax in over_pressure:
            ax.set_ylim(bottom=0)


def _is_known(record: Record) -> bool:
    """Return True if a record is a state of a run."""
    return record.keys() >= {*RUN, "pressure_mmhg", "u_norm"}


def _is_done(case: Record, records: Records, args: Arguments) -> bool:
    """Return True if a run has reached the last pressure."""
    return bool(records.all(case | {"pressure_mmhg": args.pressure}))


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="loading",
    known=_is_known,
    options=_options,
    cases=_cases,
    run=_run,
    done=_is_done,
    fields=_fields,
    draw=_draw,
)

if __name__ == "__main__":
    STUDY.main()
