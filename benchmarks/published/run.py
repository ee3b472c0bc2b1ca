# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
r"""Published numbers, computed again on refined meshes.

    python3 -m benchmarks.published --case land-1,land-2 --mesh 1,2 --json build/published.json

The load is followed to its end by FETI. From the state at :data:`BEFORE` of the load MUMPS goes to
the end, too, by Newton's method in dolfinx alone: displacement and pressure in one matrix, and
nothing of this package but the energy. Bodies of revolution are computed in their meridian plane,
too. A case that is in the file is not run again.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from benchmarks.common import command
from benchmarks.common.records import Record
from benchmarks.published.cases import CASES
from benchmarks.published.mumps import solve_by_mumps
from dolfinx_feti.loading import LoadStep, follow_load
from meshes.arguments import count

__all__ = ["LIMIT", "main"]

BEFORE = 0.995  # share of the load from which MUMPS goes on
LIMIT = 0  # "mesh" of the record of a body of revolution in its meridian plane


def main(argv: Sequence[str] | None = None) -> list[Record]:
    """Compute the cases; return their records, also those that the file had."""
    comm = MPI.COMM_WORLD
    parser = command.create_parser("published", __doc__, comm)
    add = parser.add_argument
    add("--case", type=command.some_of(list(CASES)), default=list(CASES), help=",".join(CASES))
    add("--mesh", type=command.several(count), default=[1, 2, 3], help="refinements; 1,2,3")
    command.add_records(parser)
    args = command.parse_words(parser, argv)
    file = command.open_records(args.json, parser, comm)
    wanted = [(case, mesh) for case in args.case for mesh in (LIMIT, *args.mesh)]
    found = []
    for case, mesh in wanted:
        if mesh == LIMIT and CASES[case].limit is None:
            continue
        key: Record = {"case": case, "mesh": mesh, "processes": comm.size}
        record = None if args.again else file.find(key)
        if record is None:
            record = file.keep(key, _compute(case, mesh, comm))
        found.append(record)
        values = ", ".join(f"{name} {value:.6g}" for name, value in record["values"].items())
        command.say(f"{case} mesh {mesh}: {values}", comm)
    return found


def _compute(case: str, mesh: int, comm: MPI.Comm) -> Record:
    """Load a body by both solvers, or in its meridian plane."""
    begun = time.perf_counter()
    limit = CASES[case].limit
    if mesh == LIMIT and limit is not None:
        return {"values": limit()}
    body = CASES[case].create(comm, mesh)
    last: list[list[np.ndarray]] = []

    def keep(step: LoadStep) -> None:
        if step.load == BEFORE:
            last.append([f.x.array.copy() for f in (body.u, body.p)])

    accepted = follow_load(
        body.problem, body.set_load, [BEFORE, 1.0], CASES[case].steps,
        state=[body.u, body.p], on_step=keep,
    )  # fmt: skip
    newton = [step for load_step in accepted for step in load_step.all_steps]
    seconds = time.perf_counter() - begun
    values = body.measure()
    body.u.x.array[:], body.p.x.array[:] = last[0]
    solve_by_mumps(body)
    dofmap = body.u.function_space.dofmap
    return {
        "values": values,
        "mumps": body.measure(),
        "dofs": dofmap.index_map.size_global * dofmap.index_map_bs,
        "subdomains": comm.allreduce(body.problem.decomposition.count),
        "load_steps": len(accepted),
        "newton": len(newton),
        "iterations": sum(step.linear_iterations for step in newton),
        "method": newton[-1].linear_method,
        "seconds": seconds,
    }
