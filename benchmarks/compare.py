# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI beside MUMPS and GAMG on the same matrix.

The two-layer tube, P2–P0, first Newton step at 1 mmHg:

    python3 -m benchmarks.compare --kappa 1000 --dofs 180000 --json build/compare.json

FETI gets the torn matrix; MUMPS (Cholesky) and GAMG (CG, six rigid body modes) the assembled one
that PETSc converts from it. Both are there before a solver begins. `peak_mib` is the most memory
that a solver took above that, from its creation to its solution, summed over the processes.

The file keeps the records of other κ, sizes and numbers of processes. Options with a single dash
are PETSc's, with the prefixes `tube_` (FETI), `mumps_` and `gamg_`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import petsc4py

petsc4py.init([word for word in sys.argv if not word.startswith("--")])

from mpi4py import MPI
from petsc4py import PETSc

from benchmarks.common.arguments import (
    create_parser,
    one_of,
    open_records,
    parse_words,
    several,
)
from benchmarks.common.gamg import create_gamg, difference
from benchmarks.common.progress import say
from benchmarks.common.records import Record
from benchmarks.walls.problem import WallProblem, right_hand_side
from benchmarks.walls.tube import create_clamped_tube
from dolfinx_feti import loads
from dolfinx_feti.comparison import assembled_system, create_mumps, measure, relative_residual
from meshes.arguments import count, positive

__all__ = ["main"]

RTOL = 1e-8
SOLVERS = ("feti", "mumps", "gamg")


def main(argv: Sequence[str] | None = None) -> list[Record]:
    """Run the comparison.

    Args:
        argv: The command line without the program's name; None for that of the process.

    Returns:
        A record for each solver.

    Raises:
        SystemExit: A word of the command line is wrong, or the file cannot be written.
    """
    comm = MPI.COMM_WORLD
    parser = create_parser("compare", __doc__, comm)
    add = parser.add_argument
    add("--kappa", type=positive, default=1000.0, help="[kPa], 1000")
    add("--dofs", type=count, default=180_000, help="approximate number of dofs, 180000")
    add("--subdomains", type=count, default=96, help="over all processes, 96")
    add("--solvers", type=several(one_of(SOLVERS)), default=list(SOLVERS), help=",".join(SOLVERS))
    add("--json", type=Path, metavar="FILE", help="where the records are kept")
    args = parse_words(parser, argv)
    file = open_records(args.json, parser, comm)
    tube = create_clamped_tube(
        comm,
        dofs=args.dofs,
        kappa=args.kappa,
        subdomains=args.subdomains,
        options={"ksp_rtol": RTOL},
    )
    records = compare(tube, args.solvers, kappa=args.kappa)
    for record in records:
        file.put({key: record[key] for key in ("solver", "kappa", "dofs", "processes")}, record)
        say(json.dumps(record), comm)
    return records


def compare(tube: WallProblem, solvers: Sequence[str], *, kappa: float) -> list[Record]:
    """Solve the first Newton step at 1 mmHg with each solver, FETI first.

    Args:
        tube: The tube at rest.
        solvers: Names out of ``SOLVERS``.
        kappa: κ [kPa], for the records.
    """
    b = first_step(tube)
    K, f = assembled_system(tube.problem.A, b)
    K.setOption(PETSc.Mat.Option.SPD, True)
    create: dict[str, tuple[Callable[[], PETSc.KSP], PETSc.Vec]] = {
        "feti": (lambda: share_feti(tube), b),
        "mumps": (lambda: create_mumps(K), f),
        "gamg": (lambda: create_gamg(K, rtol=RTOL), f),
    }
    records, solutions = [], {}
    for name in (name for name in SOLVERS if name in solvers):
        cost, solutions[name] = measure(*create[name])
        record = {"solver": name, "kappa": kappa, "dofs": f.getSize(), "processes": f.comm.size}
        records.append(record | asdict(cost))
    if "feti" in solvers:
        tube.problem.solver.getKSP().view()
    for record in records:
        x = solutions[record["solver"]]
        record["relative_residual"] = relative_residual(K, f, x)
        record["difference_to_mumps"] = difference(x, solutions.get("mumps"))
    return records


def first_step(tube: WallProblem) -> PETSc.Vec:
    """Assemble the torn tangent at 1 mmHg, and return the right-hand side −r."""
    tube.pressure.value = loads.mmhg(1.0)
    tube.problem.linearise()
    return right_hand_side(tube)


def share_feti(tube: WallProblem) -> PETSc.KSP:
    """Return the KSP of the problem as one that may be destroyed: the problem keeps its own."""
    ksp = tube.problem.solver.getKSP()
    ksp.setOperators(tube.problem.A)
    ksp.incRef()
    return ksp


if __name__ == "__main__":
    main()
