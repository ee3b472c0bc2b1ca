# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI beside MUMPS and GAMG on the paper's cube, P1, 512 subdomains.

    mpirun -n 2 python3 -m benchmarks.cube_solvers --level 2,3 --json build/solvers.json

FETI gets the torn matrix: with the Dirichlet preconditioner and the paper's choices, all-floating
and classical, and with this package's own. MUMPS (Cholesky) and GAMG (CG, six rigid body modes)
get the assembled one. All of them reduce the residual of the assembled system by 1e-8. `peak_mib`
is the most memory above what mesh and forms, and for the others the matrix, had taken before.

MUMPS is given the memory that there is, or --memory, and says after its analysis if that will not
do. A solver that stands in the file for this level and number of processes is not run again,
unless by --again.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from datetime import UTC, datetime

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from benchmarks.arguments import (
    add_records,
    count,
    create_parser,
    one_of,
    open_records,
    several,
)
from benchmarks.clock import Clock
from benchmarks.cube_case import LEVELS, Case
from benchmarks.cube_memory import estimate
from benchmarks.gamg import create_gamg, difference
from benchmarks.machine import PeakMemory, available_mib, bandwidth, describe
from benchmarks.records import Record
from dolfinx_feti import LinearProblem
from dolfinx_feti.comparison import assembled_system, create_mumps, measure, relative_residual

__all__ = ["SOLVERS", "main"]

#: Relative reduction of the residual of the assembled system.
RTOL = 1e-8

PAPERS = {"feti_scaling": "multiplicity", "feti_coarse_q": "identity", "feti_coarse_modes": 0}
FETI = {
    "feti_all_floating": PAPERS | {"feti_type": "all_floating"},
    "feti_classical": PAPERS | {"feti_type": "classical"},
    "feti_default": {},
}
SOLVERS = (*FETI, "gamg", "mumps")


def main(arguments: Sequence[str] | None = None, comm: MPI.Comm = MPI.COMM_WORLD) -> int:
    """Run the comparison.

    Args:
        arguments: The command line without the program's name.
        comm: Communicator of the meshes.

    Returns:
        The exit status, 0.

    Raises:
        SystemExit: Bad input, on all processes and before any work.

    Note:
        Collective.
    """
    parser = create_parser("cube_solvers", __doc__, comm)
    add = parser.add_argument
    add("--level", type=several(one_of(LEVELS)), default=[3], help="of the mesh, 1 to 5; 3")
    add("--subdomains-per-edge", type=count, default=8, metavar="M", help="M³ subdomains; 8")
    add("--solvers", type=several(one_of(SOLVERS)), default=list(SOLVERS), help=",".join(SOLVERS))
    add_records(parser)
    args = parser.parse_args(arguments)
    records = open_records(args.json, parser, comm)
    for level in args.level:
        case = Case(level=level, subdomains_per_edge=args.subdomains_per_edge)
        place = {"level": level, "subdomains": case.subdomains_per_edge**3, "processes": comm.size}
        keys = [place | {"solver": name} for name in args.solvers]
        keys = [key for key in keys if args.again or records.find(key) is None]
        for key, found in _solve(case, keys, comm, min(args.memory, available_mib(comm))):
            when = datetime.now(UTC).isoformat(timespec="seconds")
            record = key | found | {"machine": describe(), "date": when}
            records.put(key, record)
            if comm.rank == 0:
                print(_row(record), flush=True)
    return 0


def _solve(
    case: Case, keys: Sequence[Record], comm: MPI.Comm, room: float
) -> Iterator[tuple[Record, Record]]:
    """Solve a case with some solvers; MUMPS may take so much memory [MiB]."""
    names = [key["solver"] for key in keys]
    if not names:
        return
    problem = case.problem(comm)
    speed = bandwidth(comm)
    linear, x = None, None
    for key, name in zip(keys, names, strict=True):
        if name in FETI:
            linear = None  # its memory goes first
            linear, found = _feti(case, problem, FETI[name], speed)
            yield key, found
    if linear is None:
        linear, _ = _feti(case, problem, {}, speed)
    K, f = assembled_system(linear.A, linear.b)
    K.setOption(PETSc.Mat.Option.SPD, True)
    u = f.duplicate()
    u.array[:] = linear.u.x.array[: u.getLocalSize()]
    del linear
    for key, name in zip(keys, names, strict=True):
        if name not in FETI:
            found, x = _assembled(K, f, name, room / comm.size)
            if found["converged_reason"] > 0:
                found |= {"relative_residual": relative_residual(K, f, x)}
                found |= {"difference_to_feti": difference(u, x)}
            yield key, found
            x.destroy()
    for owned in (K, f, u):
        owned.destroy()


def _feti(
    case: Case, problem: object, options: dict[str, object], speed: float
) -> tuple[LinearProblem, Record]:
    """Solve by FETI; return the problem, which has the torn matrix, and a record."""
    linear = LinearProblem(
        problem.a,
        problem.L,
        bcs=problem.bcs,
        subdomains=problem.part,
        petsc_options_prefix="cube_",
        petsc_options=options | {"ksp_rtol": RTOL},
    )
    comm = linear.u.function_space.mesh.comm
    peak = PeakMemory()
    clock = Clock(comm)
    clock.watch(linear.solver)
    linear.solve()
    feti = linear.solver.getPythonContext()
    report = feti.report()
    kinds = {"all_floating": report.options.all_floating, "pc_type": report.options.pc_type}
    size = {"degree": case.degree, "cells": case.cells, "subdomains": case.subdomains_per_edge}
    kinds |= {
        "coarse_q": report.options.coarse_q,
        "interior": report.options.interior,
        "processes": comm.size,
    }
    alone = estimate(**size, **kinds).streamed if comm.rank == 0 else None
    return linear, clock.record() | {
        "dofs": report.dofs,
        "dofs_torn": report.torn_dofs,
        "coarse_size": report.coarse_size,
        "interior_is": report.interior,
        "iterations": feti.iterations,
        "converged_reason": int(linear.solver.getConvergedReason()),
        "relative_residual": feti.residual,
        "peak_mib": peak.mib_above_start(comm),
        "seconds_streaming": comm.bcast(alone) / speed,
        "bandwidth_gb_s": speed / 1e9,
    }


def _assembled(K: PETSc.Mat, f: PETSc.Vec, name: str, room: float) -> tuple[Record, PETSc.Vec]:
    """Solve with the assembled matrix; return a record and the solution."""
    factors = []

    def create() -> PETSc.KSP:
        if name == "gamg":
            return create_gamg(K, rtol=RTOL)
        ksp = create_mumps(K)
        factors.append(ksp.getPC().getFactorMatrix())
        factors[0].setMumpsIcntl(23, int(room * 2**20 / 1e6))
        return ksp

    cost, x = measure(create, f)
    found = asdict(cost) | {"dofs": f.getSize()}
    for F in factors:
        found["estimated_mib"] = 1e6 * F.getMumpsInfog(17) / 2**20
        F.destroy()
    if not np.isfinite(found["peak_mib"]):
        found["peak_mib"] = None
    return found, x


def _row(record: Record) -> str:
    """Format a record as a line."""
    if record["converged_reason"] < 0:
        room = record.get("estimated_mib")
        why = "did not converge" if room is None else f"needs about {room / 2**10:.1f} GiB"
        return f"level {record['level']}, {record['solver']}: {why}"
    return (
        f"level {record['level']}, {record['solver']:<18} {record['iterations']:>4} it., set-up "
        f"{record['seconds_setup']:.2f} s, solve {record['seconds_solve']:.2f} s"
    )


if __name__ == "__main__":
    sys.exit(main())
