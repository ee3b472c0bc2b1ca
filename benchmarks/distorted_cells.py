# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Cells that are inside out between the points of the quadrature, and what cures it.

    python3 -m benchmarks.distorted_cells --json build/distorted_cells.json
    python3 -m benchmarks.distorted_cells --way clamped,second-order --along 8

A quarter of the two-layer tube is inflated: six cells around and three through the wall, cut into
tetrahedra, with κ = 1000 kPa. det F is evaluated in each cell at the points of a quadrature of high
degree, in all cells and away from the ends. One thing is changed at a time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np

import basix
import dolfinx
import ufl

from benchmarks.common import command
from benchmarks.common.bodies import create_solid
from benchmarks.common.pages import Fields, groups
from benchmarks.common.plots import COLOURS, curve, picture
from benchmarks.common.records import Record
from benchmarks.common.study import Arguments, Keep, Study
from benchmarks.common.walls.problem import tube_fibres
from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.fem.elements import quadratic_with_bubbles
from dolfinx_feti.loading import LoadStep, Steps, follow_load
from dolfinx_feti.meshes.arguments import count
from dolfinx_feti.meshes.bricks import create_brick_tube
from dolfinx_feti.meshes.tube import ADVENTITIA, MEDIA
from dolfinx_feti.meshes.walls import create_tube_wall
from dolfinx_feti.runtime.arrays import Array
from dolfinx_feti.wall import Clamp, Pressure, Spring, Wall, apply_conditions, facets

LENGTH = 3.0  # mm

KAPPA = 1000.0  # kPa

PRESSURES = (20.0, 40.0, 80.0, 120.0)  # mmHg

STEPS = Steps(first=10.0, least=0.1)

#: Degree of the quadrature at whose points det F is evaluated: 81 points in a tetrahedron, many
#: more than those of the forms.
LOOK = 10

#: Distance from the ends beyond which a cell counts as away from them: the wall's thickness [mm].
AWAY = MEDIA + ADVENTITIA

#: Stiffness of the springs at the ends [kPa/mm], like that of soft tissue around a vessel.
SPRINGS = 10.0


@dataclass(frozen=True, slots=True)
class Way:
    """One way to model the tube; the defaults are P2–P0 on tetrahedra with clamped ends."""

    name: str
    quadrature: int = 4  # degree
    pressures: tuple[str, int] = ("DG", 0)
    bubbles: bool = False
    hexahedra: bool = False
    ends: str = "clamped"
    fineness: float = 1.0  # cells in each direction, relative to --along
    layers: int = 1  # cells through the wall, relative to three
    shortening: float = 1.0  # length of the cells in the middle over that at the ends


WAYS = {
    "clamped": Way("P2–P0"),
    "degree-6": Way("quadrature of degree 6", quadrature=6),
    "degree-8": Way("quadrature of degree 8", quadrature=8),
    "shorter": Way("cells at the ends 3 times shorter", shortening=3.0),
    "finer": Way("cells 1.5 times finer, along and around", fineness=1.5),
    "bubbles": Way(
        "P2⁺–P1disc, coarser", quadrature=6, pressures=("DG", 1), bubbles=True, fineness=0.625
    ),
    "bubbles-same-mesh": Way(
        "P2⁺–P1disc, the same mesh", quadrature=6, pressures=("DG", 1), bubbles=True
    ),
    "hexahedra": Way("Q2–P1disc", pressures=("DPC", 1), hexahedra=True),
    "springs": Way("P2–P0, ends on springs", ends="springs"),
    "sliding": Way("P2–P0, ends that slide", ends="sliding"),
    "hexahedra-springs": Way(
        "Q2–P1disc, ends on springs", pressures=("DPC", 1), hexahedra=True, ends="springs"
    ),
}


def _options(parser: argparse.ArgumentParser) -> None:
    command.add_choices(parser, "--way", list(WAYS))
    parser.add_argument("--along", type=count, default=16, help="cells along the axis, 16")


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    for way in args.way:
        yield {"way": way, "along": args.along, "processes": comm.size}


def _done(case: Record, records: object, _args: Arguments) -> bool:
    return all(records.all(case | {"pressure_mmhg": p}) for p in PRESSURES)


def _run(case: Record, keep: Keep, _args: Arguments, comm: MPI.Comm) -> None:
    """Inflate the tube; keep a record for each pressure. Collective."""
    way = WAYS[str(case["way"])]
    wall = _mesh(way, int(case["along"]), comm)
    mesh = wall.mesh
    artery = materials.ArteryParameters()
    a1, a2 = tube_fibres(mesh)
    element = basix.ufl.element("Lagrange", mesh.basix_cell(), 2)
    solid = create_solid(
        mesh,
        lambda C, J: materials.holzapfel_gasser_ogden(
            C, a1, a2, c=artery.c, k1=artery.k1, k2=artery.k2, J=J
        ),
        kappa=KAPPA,
        held=[
            (0, facets(wall, "symmetry_x")),
            (1, facets(wall, "symmetry_y")),
            *_slides(way, wall),
        ],
        degree=way.quadrature // 2,
        element=quadratic_with_bubbles("tetrahedron") if way.bubbles else element,
        pressures=way.pressures,
    )
    u = solid.u
    p = solid.p
    conditions = {"lumen": Pressure(), **_ends(way)}
    boundary = apply_conditions(wall, u, conditions)
    v = ufl.TestFunction(u.function_space)
    q = ufl.TestFunction(p.function_space)
    inside = ufl.derivative(solid.energy, u, v)
    problem = NonlinearProblem(
        [inside + boundary.residual, ufl.derivative(solid.energy, p, q)],
        u,
        bcs=[*solid.bcs, *boundary.bcs],
        J=ufl.derivative(inside, u, ufl.TrialFunction(u.function_space)) + boundary.tangent,
        condense=p,
        energy=None if boundary.energy is None else solid.energy + boundary.energy,
        quadrature_degree=way.quadrature,
    )

    def set_load(mmhg: float) -> None:
        boundary.pressure.value = loads.mmhg(mmhg)

    look = _Look(wall, u)
    steps: list[LoadStep] = []
    begun = time.process_time()

    def report(step: LoadStep) -> None:
        steps.append(step)
        if step.load in PRESSURES:
            newton = [each for load_step in steps for each in load_step.all_steps]
            cost = {
                "load_steps": len(steps),
                "newton": len(newton),
                "iterations": sum(each.linear_iterations for each in newton),
                "cpu_seconds": comm.allreduce(time.process_time() - begun),
            }
            keep({"pressure_mmhg": step.load}, look.measure(problem) | cost)

    follow_load(problem, set_load, PRESSURES, STEPS, state=[u, p], on_step=report, unit="mmHg")


def _mesh(way: Way, along: int, comm: MPI.Comm) -> Wall:
    """Mesh a quarter of the tube, with shorter cells at its ends if the way says so."""
    cells = round(way.fineness * along)
    shape = {
        "length": LENGTH,
        "quarter": True,
        "around": max(1, round(3 * cells / 8)),
        "along": cells,
        "through": (2, 1),
    }
    if way.hexahedra:
        wall = create_brick_tube(comm, size=LENGTH / cells, order=1, **shape)
    else:
        wall = create_tube_wall(comm, **shape)
    if way.shortening != 1.0:
        z = wall.mesh.geometry.x[:, 2]
        s = 2.0 * z / LENGTH - 1.0  # from −1 to 1
        slope = 1.0 / way.shortening  # at the ends
        z[:] = LENGTH / 2.0 * (1.0 + s + (1.0 - slope) / 2.0 * (s - s**3))
    return wall


def _slides(way: Way, wall: Wall) -> list[tuple[int, Array]]:
    """Return the ends, held along the axis, if they slide."""
    if way.ends != "sliding":
        return []
    return [(2, facets(wall, end)) for end in ("opening_1", "opening_2")]


def _ends(way: Way) -> dict[str, Clamp | Spring]:
    """Return the conditions at the ends."""
    held = {"clamped": Clamp(), "springs": Spring(SPRINGS, direction="all")}
    if way.ends == "sliding":
        return {}
    return dict.fromkeys(("opening_1", "opening_2"), held[way.ends])


class _Look:
    """det F at the points of a quadrature of high degree in the owned cells."""

    def __init__(self, wall: Wall, u: dolfinx.fem.Function) -> None:
        mesh = wall.mesh
        self._comm = mesh.comm
        self._u = u
        self._cells = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
        z = dolfinx.mesh.compute_midpoints(mesh, 3, self._cells)[:, 2]
        self._is_away = np.minimum(z, LENGTH - z) > AWAY
        J = kinematics.jacobian(kinematics.deformation_gradient(u))
        points, _ = basix.make_quadrature(mesh.basix_cell(), LOOK)
        self._expression = dolfinx.fem.Expression(J, points)

    def measure(self, problem: NonlinearProblem) -> Record:
        """Return the range of det F and the numbers of cells. Collective.

        Keys that begin with ``found_`` have the numbers that the problem reports.
        """
        comm = self._comm
        dofmap = self._u.function_space.dofmap
        values = self._expression.eval(self._u.function_space.mesh, self._cells)
        values = np.asarray(values).reshape(len(self._cells), -1)
        least = values.min(axis=1)
        greatest = values.max(axis=1)
        found = problem.cell_volumes()
        away = least[self._is_away], greatest[self._is_away]
        return {
            "dofs": dofmap.index_map.size_global * dofmap.index_map_bs,
            "cells": comm.allreduce(len(self._cells)),
            "least": comm.allreduce(float(least.min(initial=np.inf)), op=MPI.MIN),
            "greatest": comm.allreduce(float(greatest.max(initial=-np.inf)), op=MPI.MAX),
            "inverted": comm.allreduce(int((least <= 0.0).sum())),
            "distorted": comm.allreduce(int(((least < 0.5) | (greatest > 2.0)).sum())),
            "least_away": comm.allreduce(float(away[0].min(initial=np.inf)), op=MPI.MIN),
            "greatest_away": comm.allreduce(float(away[1].max(initial=-np.inf)), op=MPI.MAX),
            "found_inverted": found.inverted,
            "found_distorted": found.distorted,
        }


def _fields(records: Sequence[Record]) -> Fields:
    """Return a table for each pressure, the highest first, a row for each way in their order."""
    order = list(WAYS)
    rows = [
        {
            **record,
            "name": WAYS[str(record["way"])].name,
            "share": record["distorted"] / record["cells"],
        }
        for record in records
    ]
    rows.sort(key=lambda row: (-row["pressure_mmhg"], order.index(row["way"])))
    tables = [{"mmhg": mmhg, "rows": mine} for (mmhg,), mine in groups(rows, "pressure_mmhg")]
    return {"pressures": tables, "kappa": KAPPA, "look": LOOK, "away": AWAY, "springs": SPRINGS}


#: The ways of the picture: their names there, and how they are drawn.
DRAWN = {
    "clamped": ("P2–P0", {"color": COLOURS[2], "marker": "^"}),
    "degree-8": ("degree 8", {"color": COLOURS[2], "marker": "^", "ls": ":"}),
    "finer": ("finer", {"color": COLOURS[2], "marker": "^", "ls": "--"}),
    "bubbles-same-mesh": ("P2⁺–P1disc", {"color": COLOURS[0], "marker": "o"}),
    "hexahedra": ("Q2–P1disc", {"color": COLOURS[1], "marker": "s"}),
    "springs": ("P2–P0, springs", {"color": COLOURS[3], "marker": "^"}),
    "hexahedra-springs": ("Q2–P1disc, springs", {"color": COLOURS[3], "marker": "s"}),
}


def _draw(records: Sequence[Record], folder: Path) -> list[Fields]:
    """Draw the distorted cells, and the least det F away from the ends, over the pressure."""
    known = {record["way"] for record in records}
    drawn = {way: named for way, named in DRAWN.items() if way in known}
    if not drawn:
        return []
    with picture(folder / "distorted_cells.png", 1, 2, dict(drawn.values())) as axes:
        share, away = axes[0]
        for way, (_, style) in drawn.items():
            mine = sorted(
                (record for record in records if record["way"] == way),
                key=lambda record: float(record["pressure_mmhg"]),
            )
            pressures = [float(record["pressure_mmhg"]) for record in mine]
            shares = [100.0 * record["distorted"] / record["cells"] for record in mine]
            least = [float(record["least_away"]) for record in mine]
            curve(share, list(zip(pressures, shares, strict=True)), **style)
            curve(away, list(zip(pressures, least, strict=True)), **style)
        share.set(xlabel="pressure [mmHg]", ylabel="distorted cells [%]")
        away.set(xlabel="pressure [mmHg]", ylabel="least det F away from the ends")
    return [{"picture": "distorted_cells.png"}]


def _is_known(record: Record) -> bool:
    return record.get("way") in WAYS and "least_away" in record


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="distorted_cells",
    known=_is_known,
    options=_options,
    cases=_cases,
    run=_run,
    done=_done,
    fields=_fields,
    draw=_draw,
)

if __name__ == "__main__":
    STUDY.main()
