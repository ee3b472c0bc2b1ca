# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's load stepping: both variants up to 300 mmHg (section "Load stepping scheme").

    python3 -m benchmarks.load_stepping --geometry vessel --pressure 300 --json build/loading.json

The wall of `demos/demo_artery.py`, or the tube, with c = 6 kPa, κ = 1000 kPa, 32 subdomains and the
Dirichlet preconditioner, is inflated in load steps that adapt, once by all-floating and once by
classical FETI. A record for each accepted step holds its cost, displacement norm and stress
magnitude at five points A–E, and how well the elements keep their volume. With `--checkpoint
FOLDER` a run that was interrupted is continued.

The page has the paper's figures (Augustin_fig:timestepping, …Iterations): the stress magnitude over
the relative displacement u_rel = u_norm / u_max, u_norm (eq. 57) over the pressure, iterations of a
Newton step, seconds of a load step. At such pressures the wall of the vessel, a cerebral aneurysm
with the material of a carotid artery, is a numerical benchmark and no physiology.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

import dolfinx

from benchmarks.common import command
from benchmarks.common.pages import Fields, groups
from benchmarks.common.plots import COLOURS, curve, picture
from benchmarks.common.records import Record
from benchmarks.common.study import Keep, Study
from benchmarks.common.walls.problem import WallProblem, create_wall_problem
from benchmarks.common.walls.volume import summarise, volume_ratios
from dolfinx_feti import kinematics
from dolfinx_feti.loading import Checkpoint, LoadStep, Steps
from dolfinx_feti.output import cell_values, writable_folder
from dolfinx_feti.runtime.collective import on_first
from meshes.arguments import count, positive
from meshes.walls import open_wall

__all__ = ["NAMES", "STUDY", "at_points", "five_points"]


Array = npt.NDArray[np.float64]

NAMES = "ABCDE"


TYPES = ("all_floating", "classical")

PHYSICS = ("geometry", "size", "degree", "c", "kappa")

LEAST = 0.05  # mmHg

#: Newton steps that a load step may take: on the way down from fold to fold they are many.
NEWTON_STEPS = 100


VARIANTS = {
    "all-floating": {"color": "#8a8f98", "marker": "o"},
    "classical": {"color": "#1c1c1c", "marker": "s", "ls": "--"},
    "one subdomain, direct": {"color": COLOURS[1], "marker": "^", "ls": ":"},
}

DIRECT = "one subdomain, direct"

POINTS = {name: {"color": colour} for name, colour in zip(NAMES, COLOURS, strict=True)}

#: What tells one wall with its solver from another.
RUN = ("geometry", "size", "degree", "subdomains", "type")


def _options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    command.add_mesh(parser)
    command.add_choices(parser, "--type", TYPES)
    add("--pressure", type=positive, default=300.0, help="[mmHg], 300")
    add("--first", type=positive, default=10.0, help="increment of the pressure [mmHg], 10")
    add("--degree", type=int, choices=(1, 2), default=1, help="of the displacements, 1")
    add("--c", type=positive, default=6.0, help="[kPa], 6")
    add("--kappa", type=positive, default=1000.0, help="[kPa], 1000")
    add("--subdomains", type=count, default=32, help="over all processes, 32")
    add("--rtol", type=positive, default=1e-8, help="of the linear systems, 1e-8")
    add("--checkpoint", type=Path, metavar="FOLDER", help="where the last states are kept")


def _cases(
    args: argparse.Namespace, _parser: argparse.ArgumentParser, comm: MPI.Comm
) -> Iterator[Record]:
    shared = {name: getattr(args, name) for name in (*PHYSICS, "subdomains", "rtol")}
    for kind in args.type:
        yield shared | {"type": kind, "processes": comm.size}


def _run(case: Record, keep: Keep, args: argparse.Namespace, comm: MPI.Comm) -> None:
    """Inflate a wall by one variant, with a record for each accepted load step. Collective."""
    folder = writable_folder(args.folder, comm)
    wall, _ = open_wall(args.geometry, comm, size=args.size, folder=folder)
    body = create_wall_problem(
        wall,
        **{name: case[name] for name in ("degree", "c", "kappa", "subdomains")},
        options={"feti_type": case["type"], "ksp_rtol": case["rtol"], "snes_max_it": NEWTON_STEPS},
    )
    kept = _checkpoint(args, case, comm)
    points = five_points(wall.mesh)
    done = len(kept.record["steps"]) if kept is not None and kept.restart else 0

    def report(step: LoadStep) -> None:
        nonlocal done
        done += 1
        keep({"pressure_mmhg": step.load}, {"steps": done} | _cost(step) | _state(body, points))

    steps = Steps(first=args.first, least=min(LEAST, args.first))
    body.inflate([args.pressure], steps, on_step=report, checkpoint=kept)


def _checkpoint(args: argparse.Namespace, case: Record, comm: MPI.Comm) -> Checkpoint | None:
    """Open the folder of a variant; a run that was interrupted is continued there."""
    if args.checkpoint is None:
        return None
    folder = args.checkpoint / f"{case['geometry']}-{case['type']}"
    kept = on_first(lambda: (folder / "state.npz").exists(), comm)
    if kept and args.again:
        raise ValueError(f"--again begins anew, but {folder} holds a run: name another folder")
    physics = {name: case[name] for name in (*PHYSICS, "type")}
    return Checkpoint(folder, comm, parameters=physics, restart=kept)


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


def five_points(mesh: dolfinx.mesh.Mesh) -> list[npt.NDArray[np.int64]]:
    """Choose five cells far from each other; return which of this process's cells each is, or none.

    The first is the one farthest from the centre of the mesh, each further one the one farthest
    from those before it.

    Collective.
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


def at_points(body: WallProblem, points: Sequence[npt.NDArray[np.int64]]) -> tuple[Array, Array]:
    """Return u_norm [mm] (eq. 57) and σ_mag [kPa] at the points, on all processes. Collective."""
    mesh = body.u.function_space.mesh
    norm = np.linalg.norm(cell_values(body.u, mesh), axis=1)
    stress = cell_values(kinematics.stress_magnitude(body.stress), mesh)
    own = np.array([[norm[cell].sum(), stress[cell].sum()] for cell in points])
    return tuple(mesh.comm.allreduce(own).T)


def _fields(records: Sequence[Record]) -> Fields:
    runs = groups(records, *RUN)
    by_pressure = [sorted(mine, key=lambda step: step["pressure_mmhg"]) for _, mine in runs]
    first = {name: records[0][name] for name in ("c", "kappa")}
    return first | {"runs": [_summary(steps) for steps in by_pressure]}


def _draw(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw a picture for each mesh and degree that FETI ran on."""
    pictures = []
    for (geometry, size, degree), mine in groups(records, "geometry", "size", "degree"):
        if any(_variant(step) != DIRECT for step in mine):
            name, mesh = str(geometry), str(geometry)
            if size is not None:  # the generator's default
                name, mesh = f"{geometry}_{size:g}", f"{geometry}, edges of {size:g} mm"
            file = f"loading_{name}_p{degree}.png"
            _draw_panels(folder / file, mine)
            pictures.append({"picture": file, "mesh": mesh, "degree": degree})
    return pictures


def _summary(steps: Sequence[Record]) -> dict[str, object]:
    """Sum up a run, and give its last state."""
    seconds = [step["seconds"] for step in steps]
    mean = [step["linear_iterations_mean"] for step in steps]
    return dict(steps[-1]) | {
        "variant": _variant(steps[0]),
        "load_steps": len(steps),
        "newton": sum(step["newton_iterations"] for step in steps),
        "linear": sum(step["linear_iterations"] for step in steps),
        "fewest": min(mean),
        "most": max(mean),
        "worst": max(step["max_linear_residual"] for step in steps),
        "seconds_in_all": None if None in seconds else sum(seconds),
    }


def _variant(step: Record) -> str:
    return DIRECT if step["subdomains"] == 1 else str(step["type"]).replace("_", "-")


def _draw_panels(path: Path, records: Sequence[Record]) -> None:
    """Draw the four panels of one wall and degree."""
    records = sorted(records, key=lambda step: step["pressure_mmhg"])
    by_variant = {name: [s for s in records if _variant(s) == name] for name in VARIANTS}
    by_variant = {name: steps for name, steps in by_variant.items() if steps}
    legend = POINTS | {name: VARIANTS[name] for name in by_variant}
    with picture(path, 2, 2, legend) as ((stress, norm), (iterations, seconds)):
        farthest = max(by_variant.values(), key=lambda steps: steps[-1]["pressure_mmhg"])
        for name, style in POINTS.items():
            u = [0.0, *(step["u_norm"][name] for step in farthest)]
            sigma = [0.0, *(step["stress_magnitude"][name] for step in farthest)]
            relative = [value / (max(u) or 1.0) for value in u]
            curve(stress, list(zip(relative, sigma, strict=True)), marker=".", **style)
            curve(norm, [(0.0, 0.0), *_over(farthest, u[1:])], marker=".", **style)
        for name, steps in by_variant.items():
            style = VARIANTS[name] | {"ms": 4}
            if name != DIRECT:
                its = [step["linear_iterations_mean"] for step in steps]
                curve(iterations, _over(steps, its), **style)
            curve(seconds, _over(steps, [step["seconds"] for step in steps]), **style)
        stress.set(xlabel="relative displacement u_rel", ylabel="stress magnitude σ_mag [kPa]")
        _label(norm, "displacement norm u_norm [mm]")
        _label(iterations, "FETI iterations of a Newton step")
        _label(seconds, "seconds of a load step")


def _over(steps: Sequence[Record], values: Sequence[float]) -> list[tuple[float, float]]:
    """Return values over the pressure."""
    return list(zip((float(step["pressure_mmhg"]) for step in steps), values, strict=True))


def _label(ax: Axes, text: str) -> None:
    ax.set(xlabel="pressure [mmHg]", ylabel=text)
    ax.set_ylim(bottom=0)


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="loading",
    known=lambda record: "u_norm" in record,
    options=_options,
    cases=_cases,
    run=_run,
    done=lambda case, records, args: bool(records.all(case | {"pressure_mmhg": args.pressure})),
    fields=_fields,
    draw=_draw,
)

if __name__ == "__main__":
    STUDY.main()
