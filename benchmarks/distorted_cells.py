# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Cells that are inside out between quadrature points, and what prevents them.

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
from ufl.core.expr import Expr

from benchmarks.common import command
from benchmarks.common.bodies import Support, create_solid
from benchmarks.common.pages import Fields, groups
from benchmarks.common.plots import COLOURS, curve, picture
from benchmarks.common.records import Record, Records
from benchmarks.common.study import Arguments, Keep, Study
from benchmarks.common.walls.problem import tube_fibres
from dolfinx_feti import NonlinearProblem, kinematics, loads, materials
from dolfinx_feti.fem.elements import quadratic_with_bubbles
from dolfinx_feti.loading import LoadStep, Steps, follow_load
from dolfinx_feti.meshes.arguments import count
from dolfinx_feti.meshes.bricks import create_brick_tube
from dolfinx_feti.meshes.tube import ADVENTITIA, MEDIA
from dolfinx_feti.meshes.walls import create_tube_wall
from dolfinx_feti.wall import Clamp, Pressure, Spring, Wall, apply_conditions, facets

#: Length of the tube [mm].
LENGTH = 3.0

#: κ [kPa].
KAPPA = 1000.0

#: Pressures with a record [mmHg]; the last is that of an artery at systole.
PRESSURES = (20.0, 40.0, 80.0, 120.0)

#: Increments of the pressure [mmHg]: the first, and the least after failures.
STEPS = Steps(first=10.0, least=0.1)

#: Degree of the quadrature at whose points det F is evaluated: 81 points in a tetrahedron, many
#: more than those of the forms.
FINE_DEGREE = 10

#: Distance from the ends beyond which a cell counts as away from them: the wall's thickness [mm].
END_DISTANCE = MEDIA + ADVENTITIA

#: Stiffness of the springs at the ends [kPa/mm], like that of soft tissue around a vessel.
SPRINGS = 10.0


@dataclass(frozen=True, slots=True)
class Way:
    """One way to model the tube; the defaults are P2–P0 on tetrahedra with clamped ends.

    Args:
        name: Name on the page.
        quadrature: Degree of the quadrature of the forms.
        pressures: Family and degree of the pressure.
        has_bubbles: Whether the displacement has bubbles in the cells.
        has_hexahedra: Whether the cells are hexahedra, or else tetrahedra.
        ends: ``clamped``, on ``springs``, or ``sliding`` in their planes.
        fineness: Cells along and around, relative to those of ``--along``.
        shortening: Length of the cells in the middle over that of the cells at the ends.
    """

    name: str
    quadrature: int = 4
    pressures: tuple[str, int] = ("DG", 0)
    has_bubbles: bool = False
    has_hexahedra: bool = False
    ends: str = "clamped"
    fineness: float = 1.0
    shortening: float = 1.0


#: Compared ways, by their key in a record.
WAYS = {
    "clamped": Way("P2–P0"),
    "degree-6": Way("quadrature of degree 6", quadrature=6),
    "degree-8": Way("quadrature of degree 8", quadrature=8),
    "shorter": Way("cells at the ends 3 times shorter", shortening=3.0),
    "finer": Way("cells 1.5 times finer, along and around", fineness=1.5),
    "bubbles": Way(
        "P2⁺–P1disc, coarser", quadrature=6, pressures=("DG", 1), has_bubbles=True, fineness=0.625
    ),
    "bubbles-same-mesh": Way(
        "P2⁺–P1disc, the same mesh", quadrature=6, pressures=("DG", 1), has_bubbles=True
    ),
    "hexahedra": Way("Q2–P1disc", pressures=("DPC", 1), has_hexahedra=True),
    "springs": Way("P2–P0, ends on springs", ends="springs"),
    "sliding": Way("P2–P0, ends that slide", ends="sliding"),
    "hexahedra-springs": Way(
        "Q2–P1disc, ends on springs", pressures=("DPC", 1), has_hexahedra=True, ends="springs"
    ),
}


def _options(parser: argparse.ArgumentParser) -> None:
    command.add_choices(parser, "--way", list(WAYS))
    parser.add_argument("--along", type=count, default=16, help="cells along the axis, 16")


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    for way in args.way:
        yield {"way": way, "along": args.along, "processes": comm.size}


def _is_done(case: Record, records: Records, _args: Arguments) -> bool:
    """Return True if each of the pressures has a record."""
    return all(records.all(case | {"pressure_mmhg": pressure}) for pressure in PRESSURES)


def _run(case: Record, keep: Keep, _args: Arguments, comm: MPI.Comm) -> None:
    """Inflate the tube; keep a record for each pressure. Collective."""
    way = WAYS[case["way"]]
    wall = _create_wall(way, case["along"], comm)
    mesh = wall.mesh
    artery = materials.ArteryParameters()
    a1, a2 = tube_fibres(mesh)
    element = basix.ufl.element("Lagrange", mesh.basix_cell(), 2)

    def energy(C: Expr, J: Expr) -> Expr:
        return materials.holzapfel_gasser_ogden(
            C, a1, a2, c=artery.c, k1=artery.k1, k2=artery.k2, J=J
        )

    solid = create_solid(
        mesh,
        energy,
        kappa=KAPPA,
        supports=[
            (0, facets(wall, "symmetry_x")),
            (1, facets(wall, "symmetry_y")),
            *_sliding_ends(way, wall),
        ],
        degree=way.quadrature // 2,  # sets the quadrature only: the element is given below
        element=quadratic_with_bubbles("tetrahedron") if way.has_bubbles else element,
        pressures=way.pressures,
    )
    u = solid.u
    p = solid.p
    boundary = apply_conditions(wall, u, {"lumen": Pressure(), **_end_conditions(way)})
    problem = NonlinearProblem(
        solid.energy,
        u,
        bcs=solid.bcs,
        condense=p,
        boundary=boundary,
        quadrature_degree=way.quadrature,
    )

    def set_pressure(mmhg: float) -> None:
        boundary.set_pressure(loads.mmhg(mmhg))

    volume_ratios = _VolumeRatios(wall, u)
    steps: list[LoadStep] = []
    started = time.process_time()

    def report(step: LoadStep) -> None:
        steps.append(step)
        if step.load in PRESSURES:
            newton_steps = [newton for load_step in steps for newton in load_step.all_steps]
            cost = {
                "load_steps": len(steps),
                "newton": len(newton_steps),
                "iterations": sum(newton.linear_iterations for newton in newton_steps),
                "cpu_seconds": comm.allreduce(time.process_time() - started),
            }
            keep({"pressure_mmhg": step.load}, volume_ratios.measure(problem) | cost)

    follow_load(problem, set_pressure, PRESSURES, STEPS, state=[u, p], on_step=report, unit="mmHg")


def _create_wall(way: Way, along: int, comm: MPI.Comm) -> Wall:
    """Mesh a quarter of the tube. Collective.

    Args:
        way: Its cells, fineness and shortening.
        along: Cells along the axis at the fineness 1.
        comm: Communicator.
    """
    cells = round(way.fineness * along)
    shape = {
        "length": LENGTH,
        "quarter": True,
        "around": max(1, round(3 * cells / 8)),
        "along": cells,
        "through": (2, 1),
    }
    if way.has_hexahedra:
        wall = create_brick_tube(comm, size=LENGTH / cells, order=1, **shape)
    else:
        wall = create_tube_wall(comm, **shape)
    if way.shortening != 1.0:
        z = wall.mesh.geometry.x[:, 2]
        s = 2.0 * z / LENGTH - 1.0  # from −1 to 1
        slope = 1.0 / way.shortening  # at the ends
        z[:] = LENGTH / 2.0 * (1.0 + s + (1.0 - slope) / 2.0 * (s - s**3))
    return wall


def _sliding_ends(way: Way, wall: Wall) -> list[Support]:
    """Return the axial support of both ends if they slide, or else nothing."""
    if way.ends != "sliding":
        return []
    return [(2, facets(wall, end)) for end in ("opening_1", "opening_2")]


def _end_conditions(way: Way) -> dict[str, Clamp | Spring]:
    """Return the condition of each end that is clamped or on springs."""
    conditions = {"clamped": Clamp(), "springs": Spring(SPRINGS, direction="all")}
    if way.ends == "sliding":
        return {}
    return dict.fromkeys(("opening_1", "opening_2"), conditions[way.ends])


class _VolumeRatios:
    """det F of the owned cells at the points of a quadrature of degree FINE_DEGREE."""

    def __init__(self, wall: Wall, u: dolfinx.fem.Function) -> None:
        mesh = wall.mesh
        self._comm = mesh.comm
        self._u = u
        self._cells = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
        z = dolfinx.mesh.compute_midpoints(mesh, 3, self._cells)[:, 2]
        self._is_away = np.minimum(z, LENGTH - z) > END_DISTANCE
        J = kinematics.jacobian(kinematics.deformation_gradient(u))
        points, _ = basix.make_quadrature(mesh.basix_cell(), FINE_DEGREE)
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
        reported = problem.cell_volumes()
        least_away = least[self._is_away]
        greatest_away = greatest[self._is_away]
        return {
            "dofs": dofmap.index_map.size_global * dofmap.index_map_bs,
            "cells": comm.allreduce(len(self._cells)),
            "least": comm.allreduce(float(least.min(initial=np.inf)), op=MPI.MIN),
            "greatest": comm.allreduce(float(greatest.max(initial=-np.inf)), op=MPI.MAX),
            "inverted": comm.allreduce(int((least <= 0.0).sum())),
            "distorted": comm.allreduce(int(((least < 0.5) | (greatest > 2.0)).sum())),
            "least_away": comm.allreduce(float(least_away.min(initial=np.inf)), op=MPI.MIN),
            "greatest_away": comm.allreduce(float(greatest_away.max(initial=-np.inf)), op=MPI.MAX),
            "found_inverted": reported.inverted,
            "found_distorted": reported.distorted,
        }


def _fields(records: Sequence[Record]) -> Fields:
    """Return a table for each pressure, the highest first, a row for each way in their order."""
    order = list(WAYS)
    rows = [
        {**record, "name": WAYS[record["way"]].name, "share": record["distorted"] / record["cells"]}
        for record in records
    ]
    rows.sort(key=lambda row: (-row["pressure_mmhg"], order.index(row["way"])))
    tables = [
        {"mmhg": mmhg, "rows": of_pressure}
        for (mmhg,), of_pressure in groups(rows, "pressure_mmhg")
    ]
    return {
        "pressures": tables,
        "kappa": KAPPA,
        "look": FINE_DEGREE,
        "away": END_DISTANCE,
        "springs": SPRINGS,
    }


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
    recorded = {record["way"] for record in records}
    drawn = {way: named for way, named in DRAWN.items() if way in recorded}
    if not drawn:
        return []
    with picture(folder / "distorted_cells.png", 1, 2, dict(drawn.values())) as axes:
        share, away = axes[0]
        for way, (_, style) in drawn.items():
            of_way = sorted(
                (record for record in records if record["way"] == way),
                key=lambda record: record["pressure_mmhg"],
            )
            pressures = [record["pressure_mmhg"] for record in of_way]
            shares = [100.0 * record["distorted"] / record["cells"] for record in of_way]
            least = [record["least_away"] for record in of_way]
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
    done=_is_done,
    fields=_fields,
    draw=_draw,
)

if __name__ == "__main__":
    STUDY.main()
