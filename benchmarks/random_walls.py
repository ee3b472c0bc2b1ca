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
import ufl

from benchmarks.common.bodies import create_solid
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

LAYERS = ("intima", "media", "adventitia")

STEPS = Steps(first=10.0, least=0.1)


@dataclass(frozen=True, slots=True)
class Chance:
    """Parameters of a random wall."""

    branches: int
    sac: bool
    thickness: float  # mm
    layers: tuple[str, ...]
    c: tuple[float, ...]  # of each layer [kPa]
    k1: tuple[float, ...]  # of each layer [kPa]
    angles: tuple[float, ...]  # of the fibres of each layer [degrees]
    plaque: float  # how many times as stiff; 1 for none
    springs: tuple[float, ...]  # of each opening [kPa/mm]; 0 where it is clamped


def draw(seed: int) -> Chance:
    """Return the parameters that a seed determines."""
    random = np.random.default_rng(seed)
    branches = int(random.integers(2, 4))
    layers = int(random.integers(1, 4))
    springs = random.random(branches) < 0.4
    return Chance(
        branches=branches,
        sac=bool(random.random() < 0.5),
        thickness=float(random.uniform(0.8, 1.1)),
        layers=LAYERS[:layers],
        c=tuple(random.uniform(10.0, 40.0, layers).tolist()),
        k1=tuple(random.uniform(0.0, 40.0, layers).tolist()),
        angles=tuple(random.uniform(10.0, 70.0, layers).tolist()),
        plaque=float(10 ** random.uniform(1.0, 3.0)) if random.random() < 0.6 else 1.0,
        springs=tuple((springs * 10 ** random.uniform(1.0, 3.0, branches)).tolist()),
    )


def inflate(seed: int, comm: MPI.Comm) -> Record:
    """Inflate a wall from rest to its pressure; return its record. Collective."""
    chance = draw(seed)
    begun = time.perf_counter()
    wall = _create(seed, chance, comm)
    c, k1, angles = (
        dict(zip(chance.layers, values, strict=True))
        for values in (chance.c, chance.k1, chance.angles)
    )
    parameters = {"c": by_layer(wall, c), "k1": by_layer(wall, k1), "k2": 0.8393}
    fibres = fibre_families(wall, fibre_frame(wall), angles)
    plaque = _plaque(wall, seed, chance)
    solid = create_solid(
        wall.mesh,
        lambda C, J: plaque * materials.holzapfel_gasser_ogden(C, *fibres, **parameters, J=J),
        kappa=KAPPA,
        held=[],
        pressures=("DG", 0),
    )
    u = solid.u
    p = solid.p
    energy = solid.energy
    V = u.function_space
    v = ufl.TestFunction(V)
    q = ufl.TestFunction(p.function_space)
    held = {
        name: Spring(stiffness, direction="all") if stiffness else Clamp()
        for name, stiffness in zip(openings(wall), chance.springs, strict=True)
    }
    boundary = apply_conditions(wall, u, {"lumen": Pressure(), **held})
    inside = ufl.derivative(energy, u, v)
    problem = NonlinearProblem(
        [inside + boundary.residual, ufl.derivative(energy, p, q)],
        u,
        bcs=boundary.bcs,
        J=ufl.derivative(inside, u, ufl.TrialFunction(V)) + boundary.tangent,
        condense=p,
        energy=None if boundary.energy is None else energy + boundary.energy,
        quadrature_degree=4,
    )

    def set_load(mmhg: float) -> None:
        boundary.pressure.value = loads.mmhg(mmhg)

    steps: list[LoadStep] = []
    error = ""
    try:
        follow_load(
            problem, set_load, [MMHG], STEPS, state=[u, p], on_step=steps.append, unit="mmHg"
        )
    except ConvergenceError as failure:
        error = str(failure)
    newton = [step for load_step in steps for step in load_step.all_steps]
    largest = np.linalg.norm(u.x.array.reshape(-1, 3), axis=1).max(initial=0.0)
    return {
        "wall": _describe(chance),
        "dofs": 3 * V.dofmap.index_map.size_global,
        "subdomains": comm.allreduce(problem.decomposition.count),
        "reached": steps[-1].load if steps else 0.0,
        "load_steps": len(steps),
        "newton": len(newton),
        "iterations": sum(step.linear_iterations for step in newton),
        "largest_displacement": comm.allreduce(float(largest), op=MPI.MAX),
        "error": error,
        "seconds": time.perf_counter() - begun,
    }


def _create(seed: int, chance: Chance, comm: MPI.Comm) -> Wall:
    """Grow the wall on its lumen, on the first process, and distribute it."""

    def write(path: Path) -> None:
        surface = path.with_suffix(".stl")
        random = np.random.default_rng([seed, 1])
        write_random_lumen(surface, random, branches=chance.branches, has_sac=chance.sac)
        write_vessel(
            path,
            size=1.6 * chance.thickness,
            thickness=chance.thickness,
            layers=dict.fromkeys(chance.layers, 1 / len(chance.layers)),
            surface=surface,
        )

    return generate_wall(write, comm)


def _plaque(wall: Wall, seed: int, chance: Chance) -> dolfinx.fem.Function:
    """Return the stiffness of each cell relative to that of its layer."""
    factor = dolfinx.fem.Function(dolfinx.fem.functionspace(wall.mesh, ("DG", 0)))
    random = np.random.default_rng([seed, 2])
    angle = random.uniform(0.0, 2 * np.pi)
    radius = random.uniform(1.5, 2.5)
    middle = 2.5 * np.array([np.cos(angle), np.sin(angle), 0.0]) + [0.0, 0.0, 2.0]

    def near(x: np.ndarray) -> np.ndarray:
        inside = np.linalg.norm(x.T - middle, axis=1) < radius
        return np.where(inside, chance.plaque, 1.0)

    factor.interpolate(near)
    return factor


def _describe(chance: Chance) -> str:
    """Return the parameters of a wall in words."""
    words = ["bent tube" if chance.branches == 2 else "bifurcation"]
    if chance.sac:
        words.append("a sac")
    words.append(f"{len(chance.layers)} layers" if len(chance.layers) > 1 else "1 layer")
    if chance.plaque > 1:
        words.append(f"a plaque {chance.plaque:.0f} times stiffer")
    on_springs = sum(k > 0 for k in chance.springs)
    if on_springs:
        words.append(f"{on_springs} of {chance.branches} openings on springs")
    return ", ".join(words)


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each seed, in their order."""
    rows = sorted(records, key=lambda record: int(record["seed"]))
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
    return "seed" in record and "wall" in record


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seeds", type=count, default=20, help="seeds 0, 1, …; 20")


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    for seed in range(args.seeds):
        yield {"seed": seed, "processes": comm.size}


def _run(case: Record, keep: Keep, _args: Arguments, comm: MPI.Comm) -> None:
    """Inflate a wall. Collective."""
    keep({}, inflate(int(case["seed"]), comm))


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
