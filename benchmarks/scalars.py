# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What volumes cost beside given pressures.

    mpirun -n 2 python3 -m benchmarks.scalars --json build/scalars.json

A body is inflated in two steps by given pressures, then by the volumes that these have reached in
none, one or all of its cavities. The second step counts, by processor time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl

from benchmarks.common import command
from benchmarks.common.bodies import Solid, create_block, create_solid, plane
from benchmarks.common.pages import Fields, groups
from benchmarks.common.records import Record
from benchmarks.common.study import Arguments, Study
from dolfinx_feti import NonlinearProblem, materials
from dolfinx_feti.mechanics.loads import pressure_potential
from dolfinx_feti.scalars import Cavity

__all__ = ["BODIES", "STUDY"]

Array = npt.NDArray[np.float64]
Marker = Callable[[Array], npt.NDArray[np.bool_]]

KAPPA, OPTIONS = 1000.0, {"snes_rtol": 1e-8, "snes_max_it": 20}

COUNTS = ("newton_steps", "linear_iterations")


@dataclass(frozen=True, slots=True)
class Body:
    """A body at rest and its cavities; the shear modulus is 1 kPa."""

    solid: Solid
    surfaces: list[ufl.Measure]
    cavities: list[Cavity]
    axis: tuple[float, float, float] | None

    def problem(self, m: int, pressures: Sequence[dolfinx.fem.Constant]) -> NonlinearProblem:
        """Return the problem with volumes in the first m cavities, and pressures in the others."""
        energy, u = self.solid.energy, self.solid.u
        for pressure, surface in list(zip(pressures, self.surfaces, strict=True))[m:]:
            energy += pressure_potential(pressure, u, surface, self.axis)
        return NonlinearProblem(
            energy, u, bcs=self.solid.bcs, condense=self.solid.p, scalars=self.cavities[:m],
            subdomains=16, quadrature_degree=4, petsc_options=OPTIONS,
        )  # fmt: skip


def create_tube(comm: MPI.Comm) -> Body:
    """Return a quarter of a tube of 23 085 dofs, radii 1 and 1.5 mm, between planes."""
    size = [(1.0, 0.0, 0.0), (1.5, np.pi / 2, 2.0)]
    mesh = dolfinx.mesh.create_box(comm, size, (4, 9, 22), dolfinx.mesh.CellType.hexahedron)
    r, angle, _ = mesh.geometry.x.T.copy()
    mesh.geometry.x[:, :2] = np.column_stack((r * np.cos(angle), r * np.sin(angle)))
    planes = [(0, 0.0), (1, 0.0), (2, 0.0), (2, 2.0)]
    lumen = [lambda x: np.hypot(x[0], x[1]) < 1.0 + 1e-6]
    return _body(mesh, planes, lumen, axis=(0.0, 0.0, 1.0))


def create_holes(comm: MPI.Comm) -> Body:
    """Return a block of 9 × 3 × 4 mm in three planes, with four cubic holes of 1 mm³."""
    box = create_block(comm, (9.0, 3.0, 4.0), (18, 6, 8))
    cells = np.arange(box.topology.index_map(3).size_local, dtype=np.int32)
    middles = dolfinx.mesh.compute_midpoints(box, 3, cells).T
    holes = [_around((1.5 + 2.0 * k, 1.5, 1.5)) for k in range(4)]
    wall = np.flatnonzero(~np.any([hole(middles) for hole in holes], axis=0)).astype(np.int32)
    mesh = dolfinx.mesh.create_submesh(box, 3, wall)[0]
    return _body(mesh, [(0, 0.0), (1, 0.0), (2, 0.0)], holes)


def _around(centre: Sequence[float]) -> Marker:
    return lambda x: np.abs(x - np.array(centre)[:, None]).max(axis=0) < 0.5 + 1e-6


def _body(
    mesh: dolfinx.mesh.Mesh,
    planes: Sequence[tuple[int, float]],
    surfaces: Sequence[Marker],
    axis: tuple[float, float, float] | None = None,
) -> Body:
    """Return a body that slides in planes (axis, place)."""
    solid = create_solid(
        mesh, lambda C, J: materials.neo_hookean(C, c=1.0, J=J),
        kappa=KAPPA, held=[(k, plane(mesh, k, place)) for k, place in planes],
    )  # fmt: skip
    marked = [dolfinx.mesh.locate_entities_boundary(mesh, 2, where) for where in surfaces]
    facets = np.concatenate(marked)
    values = np.repeat(np.arange(1, len(marked) + 1), [len(m) for m in marked]).astype(np.int32)
    order = np.argsort(facets, kind="stable")
    tags = dolfinx.mesh.meshtags(mesh, 2, facets[order], values[order])
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)
    measures = [ds(k + 1) for k in range(len(marked))]
    cavities = [Cavity(solid.u, measure, 1.0, axis=axis) for measure in measures]
    for cavity in cavities:
        cavity.volume.value = cavity.present_volume()
    return Body(solid, measures, cavities, axis)


#: Bodies, and the given pressures of the last step [kPa].
BODIES = {"tube": (create_tube, (0.15,)), "block": (create_holes, (0.2, 0.1, 0.2, 0.1))}


def _cases(args: Arguments, comm: MPI.Comm) -> Iterator[Record]:
    for body in args.body:
        for m in sorted({0, 1, len(BODIES[body][1])}):
            yield {"study": "speed", "body": body, "scalars": m, "processes": comm.size}


def _inflated(key: Record, comm: MPI.Comm) -> Record:
    """Inflate a body by pressures, then again with volumes in the first cavities in their place."""
    create, last = BODIES[str(key["body"])]
    body, m = create(comm), int(str(key["scalars"]))
    u, p = body.solid.u, body.solid.p
    pressures = [dolfinx.fem.Constant(u.function_space.mesh, 0.0) for _ in last]
    steps = (0.5, 1.0)
    reference = body.problem(0, pressures)
    volumes, record = [], {}
    for share in steps:
        for constant, pressure in zip(pressures, last, strict=True):
            constant.value = share * pressure
        record = _timed(reference, comm)
        volumes.append([cavity.present_volume() for cavity in body.cavities])
    if m:
        u.x.array[:] = p.x.array[:] = 0.0
        problem = body.problem(m, pressures)
        for share, reached in zip(steps, volumes, strict=True):
            for k, constant in enumerate(pressures):
                constant.value = share * last[k]
                body.cavities[k].volume.value = reached[k]
            record = _timed(problem, comm)
        record["pressure_error"] = max(
            abs(float(body.cavities[k].pressure.value) / last[k] - 1.0) for k in range(m)
        )
    V = u.function_space
    return record | {"dofs": V.dofmap.index_map.size_global * V.dofmap.index_map_bs}


def _timed(problem: NonlinearProblem, comm: MPI.Comm) -> Record:
    """Solve; return Newton steps, linear iterations and the processor time of all processes."""
    before = time.process_time()
    problem.solve()
    return {
        "cpu_seconds": comm.allreduce(time.process_time() - before),
        "newton_steps": len(problem.history),
        "linear_iterations": sum(step.linear_iterations for step in problem.history),
    }


def _fields(records: Sequence[Record]) -> Fields:
    """Return a row for each body and number of processes."""
    rows = []
    for (body, processes), mine in groups(records, "body", "processes"):
        at = {int(r["scalars"]): r for r in mine}
        seconds = {m: float(r["cpu_seconds"]) for m, r in at.items()}
        rows.append(
            {"body": body, "processes": processes, "dofs": at[0]["dofs"]}
            | {name: ", ".join(str(at[m][name]) for m in sorted(at)) for name in COUNTS}
            | {"ratio": {m: f"{each / seconds[0]:.2f}" for m, each in seconds.items()}}
        )
    return {"speed": rows}


STUDY = Study(
    file=__file__,
    about=__doc__,
    page="scalars",
    known=lambda record: record.get("study") == "speed",
    options=lambda parser: command.add_choices(parser, "--body", list(BODIES)),
    cases=_cases,
    run=lambda case, keep, _args, comm: keep({}, _inflated(case, comm)),
    fields=_fields,
)

if __name__ == "__main__":
    STUDY.main()
