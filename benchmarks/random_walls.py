# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Random walls, from rest to 120 mmHg with the defaults.

    python3 -m benchmarks.random_walls --seeds 20 --json build/random_walls.json

A seed determines a wall: a bent tube or a bifurcation, with or without a sac, one to three layers
with their own stiffness and fibres, with or without a plaque up to a thousand times stiffer, and
openings that are clamped or on springs. If a wall does not reach the pressure, its record has the
message of the error.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np

import dolfinx
from ufl.core.expr import Expr

from benchmarks.common.bodies import Solid, create_solid
from benchmarks.common.pages import Fields, section
from benchmarks.common.records import Record
from benchmarks.common.study import Arguments, Keep, Study
from dolfinx_feti import ConvergenceError, NonlinearProblem, loads, materials
from dolfinx_feti.loading import LoadStep, Steps, follow_load
from dolfinx_feti.meshes.arguments import count
from dolfinx_feti.meshes.random_lumen import write_random_lumen
from dolfinx_feti.meshes.vessel import write_vessel
from dolfinx_feti.meshes.walls import generate_wall
from dolfinx_feti.wall import Clamp, Pressure, Spring, Wall, apply_conditions, by_layer, openings
from dolfinx_feti.wall.fibres import fibre_families, fibre_frame

#: Pressure that a wall has to reach [mmHg]: that of an artery at systole.
MMHG = 120.0

#: Bulk modulus of all layers [kPa].
KAPPA = 1000.0

#: Newton steps within which the page counts a wall as solved in time.
MAX_NEWTON_STEPS = 80

#: Exponent k₂ of the fibres in all layers [-].
K2 = materials.ArteryParameters().k2

#: Names of the layers from the inside; a wall with fewer layers has the first of them.
LAYERS = ("intima", "media", "adventitia")

#: Increments of the pressure [mmHg]: the first, and the least after failures.
STEPS = Steps(first=10.0, least=0.1)


@dataclass(frozen=True, slots=True)
class RandomWall:
    """Parameters of a random wall."""

    branches: int  # openings of the lumen: 2 for a bent tube, 3 for a bifurcation
    has_sac: bool
    thickness: float  # mm
    layers: tuple[str, ...]
    c: tuple[float, ...]  # of each layer [kPa]
    k1: tuple[float, ...]  # of each layer [kPa]
    angles: tuple[float, ...]  # of the fibres of each layer [degrees]
    plaque: float  # stiffness of the plaque over that of its layer; 1 without a plaque
    springs: tuple[float, ...]  # of each opening [kPa/mm]; 0 where it is clamped


def draw(seed: int) -> RandomWall:
    """Draw the parameters of the wall of a seed."""
    random = np.random.default_rng(seed)
    branches = int(random.integers(2, 4))
    layers = int(random.integers(1, 4))
    springs = random.random(branches) < 0.4
    return RandomWall(
        branches=branches,
        has_sac=bool(random.random() < 0.5),
        thickness=float(random.uniform(0.8, 1.1)),
        layers=LAYERS[:layers],
        c=tuple(random.uniform(10.0, 40.0, layers).tolist()),
        k1=tuple(random.uniform(0.0, 40.0, layers).tolist()),
        angles=tuple(random.uniform(10.0, 70.0, layers).tolist()),
        plaque=float(10 ** random.uniform(1.0, 3.0)) if random.random() < 0.6 else 1.0,
        springs=tuple((springs * 10 ** random.uniform(1.0, 3.0, branches)).tolist()),
    )


def inflate(seed: int, comm: MPI.Comm) -> Record:
    """Inflate a wall from rest to MMHG. Collective.

    Args:
        seed: Determines the wall.
        comm: Communicator.

    Returns:
        Measured values of the record; ``error`` is the message of a failure, or empty.
    """
    begun = time.perf_counter()
    parameters = draw(seed)
    wall = _create_wall(seed, parameters, comm)
    solid = _create_solid(wall, seed, parameters)
    u = solid.u
    p = solid.p
    supports = {
        name: Spring(stiffness, direction="all") if stiffness else Clamp()
        for name, stiffness in zip(openings(wall), parameters.springs, strict=True)
    }
    boundary = apply_conditions(wall, u, {"lumen": Pressure(), **supports})
    problem = NonlinearProblem(solid.energy, u, condense=p, boundary=boundary, quadrature_degree=4)

    def set_pressure(mmhg: float) -> None:
        boundary.set_pressure(loads.mmhg(mmhg))

    steps: list[LoadStep] = []
    error = ""
    try:
        follow_load(
            problem, set_pressure, [MMHG], STEPS, state=[u, p], on_step=steps.append, unit="mmHg"
        )
    except ConvergenceError as failure:
        error = str(failure)
    newton = [step for load_step in steps for step in load_step.all_steps]
    largest = np.linalg.norm(u.x.array.reshape(-1, 3), axis=1).max(initial=0.0)
    return {
        "wall": _describe(parameters),
        "dofs": 3 * u.function_space.dofmap.index_map.size_global,
        "subdomains": comm.allreduce(problem.decomposition.count),
        "reached": steps[-1].load if steps else 0.0,
        "load_steps": len(steps),
        "newton": len(newton),
        "iterations": sum(step.linear_iterations for step in newton),
        "largest_displacement": comm.allreduce(float(largest), op=MPI.MAX),
        "error": error,
        "seconds": time.perf_counter() - begun,
    }


def _create_solid(wall: Wall, seed: int, parameters: RandomWall) -> Solid:
    """Create the fibre-reinforced body of a wall, with the stiffness of each layer and a plaque."""
    c, k1, angles = (
        dict(zip(parameters.layers, values, strict=True))
        for values in (parameters.c, parameters.k1, parameters.angles)
    )
    stiffness = {"c": by_layer(wall, c), "k1": by_layer(wall, k1), "k2": K2}
    fibres = fibre_families(wall, fibre_frame(wall), angles)
    plaque = _plaque_factor(wall, seed, parameters)

    def energy(C: Expr, J: Expr) -> Expr:
        return plaque * materials.holzapfel_gasser_ogden(C, *fibres, **stiffness, J=J)

    return create_solid(wall.mesh, energy, kappa=KAPPA, supports=[], pressures=("DG", 0))


def _create_wall(seed: int, parameters: RandomWall, comm: MPI.Comm) -> Wall:
    """Mesh the wall around its lumen on the first process, and distribute it. Collective."""

    def write(path: Path) -> None:
        surface = path.with_suffix(".stl")
        random = np.random.default_rng([seed, 1])
        write_random_lumen(
            surface, random, branches=parameters.branches, has_sac=parameters.has_sac
        )
        write_vessel(
            path,
            size=1.6 * parameters.thickness,
            thickness=parameters.thickness,
            layers=dict.fromkeys(parameters.layers, 1 / len(parameters.layers)),
            surface=surface,
        )

    return generate_wall(write, comm)


def _plaque_factor(wall: Wall, seed: int, parameters: RandomWall) -> dolfinx.fem.Function:
    """Return the stiffness of each cell over that of its layer.

    The plaque is a ball of a random radius. Its centre lies 2.5 mm off the z axis, at z = 2 mm.
    """
    factor = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("DG", 0)))
    random = np.random.default_rng([seed, 2])
    angle = random.uniform(0.0, 2 * np.pi)
    radius = random.uniform(1.5, 2.5)
    centre = np.array([2.5 * np.cos(angle), 2.5 * np.sin(angle), 2.0])

    def stiffness(x: np.ndarray) -> np.ndarray:
        is_plaque = np.linalg.norm(x.T - centre, axis=1) < radius
        return np.where(is_plaque, parameters.plaque, 1.0)

    factor.interpolate(stiffness)
    return factor


def _describe(parameters: RandomWall) -> str:
    """Return the parameters of a wall in words."""
    words = ["bent tube" if parameters.branches == 2 else "bifurcation"]
    if parameters.has_sac:
        words.append("a sac")
    words.append(f"{len(parameters.layers)} layers" if len(parameters.layers) > 1 else "1 layer")
    if parameters.plaque > 1:
        words.append(f"a plaque {parameters.plaque:.0f} times stiffer")
    on_springs = sum(k > 0 for k in parameters.springs)
    if on_springs:
        words.append(f"{on_springs} of {parameters.branches} openings on springs")
    return ", ".join(words)


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each seed, in their order."""
    rows = sorted(records, key=lambda record: record["seed"])
    failed = [row for row in rows if row["error"]]
    return {
        "rows": rows,
        "arrived": len(rows) - len(failed),
        "within": sum(not row["error"] and row["newton"] <= MAX_NEWTON_STEPS for row in rows),
        "failures": section(failed),
        "mmhg": MMHG,
        "most": MAX_NEWTON_STEPS,
    }


def _is_known(record: Record) -> bool:
    return {"seed", "wall", "largest_displacement"} <= record.keys()


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seeds", type=count, default=20, help="seeds 0, 1, …; 20")


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    for seed in range(args.seeds):
        yield {"seed": seed, "processes": comm.size}


def _run(case: Record, keep: Keep, _args: Arguments, comm: MPI.Comm) -> None:
    """Inflate the wall of a case and keep its record. Collective."""
    keep({}, inflate(case["seed"], comm))


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="random_walls",
    known=_is_known,
    options=_options,
    cases=_cases,
    run=_run,
    fields=_fields,
)

if __name__ == "__main__":
    STUDY.main()
