# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""FETI beside MUMPS, GAMG and others on the same matrix.

The two-layer tube, P2–P0, first Newton step at 1 mmHg:

    python3 -m benchmarks.compare --kappa 1000 --dofs 180000 --json build/compare.json

FETI gets the torn matrix; MUMPS (Cholesky) and GAMG (CG, six rigid body modes) the assembled one
that PETSc converts from it. Both are there before a solver begins. `peak_mib` is the most memory
that a solver took above that, from its creation to its solution, summed over the processes.
`--solvers` also takes hypre (BoomerAMG) and bddc (PETSc's, on the torn matrix), `--dofs` several
sizes.

The file keeps the records of other κ, sizes and numbers of processes. Options with a single dash
are PETSc's, with the prefixes `tube_` (FETI), `mumps_`, `gamg_`, …
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import petsc4py

petsc4py.init([word for word in sys.argv if not word.startswith("--")])

from mpi4py import MPI

import dolfinx_feti
from benchmarks.common.arguments import (
    create_parser,
    one_of,
    open_records,
    parse_words,
    several,
)
from benchmarks.common.progress import say
from benchmarks.common.records import Record
from benchmarks.walls.problem import WallProblem
from benchmarks.walls.tube import create_clamped_tube
from dolfinx_feti import loads
from dolfinx_feti.comparison.run import SOLVERS
from meshes.arguments import count, positive

__all__ = ["main"]

RTOL = 1e-8
USUAL = ("feti", "mumps", "gamg")


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
    add("--dofs", type=several(count), default=[180_000], help="approximate number; 180000")
    add("--subdomains", type=count, default=96, help="over all processes, 96")
    add("--solvers", type=several(one_of(SOLVERS)), default=list(USUAL), help=",".join(SOLVERS))
    add("--json", type=Path, metavar="FILE", help="where the records are kept")
    args = parse_words(parser, argv)
    file = open_records(args.json, parser, comm)
    records = []
    for dofs in args.dofs:
        tube = create_clamped_tube(
            comm,
            dofs=dofs,
            kappa=args.kappa,
            subdomains=args.subdomains,
            options={"ksp_rtol": RTOL, "ksp_view": None},
        )
        for record in compare(tube, args.solvers, kappa=args.kappa):
            key = {name: record[name] for name in ("solver", "kappa", "dofs", "processes")}
            records.append(file.put(key, record))
            say(json.dumps(records[-1]), comm)
    return records


def compare(tube: WallProblem, solvers: Sequence[str], *, kappa: float) -> list[Record]:
    """Solve the first Newton step at 1 mmHg with each solver, FETI first.

    Args:
        tube: The tube at rest, which it stays.
        solvers: Names out of ``SOLVERS``.
        kappa: κ [kPa], for the records.
    """
    tube.pressure.value = loads.mmhg(1.0)
    names = [name for name in SOLVERS if name in solvers]
    found = dolfinx_feti.compare(tube.problem, names, definite=True)
    return [
        {
            "solver": solved.solver,
            "kappa": kappa,
            "dofs": found.dofs,
            "processes": found.processes,
            "threads": int(os.environ.get("OMP_NUM_THREADS", 0)) or None,
            "subdomains": found.subdomains,
            **({} if solved.cost is None else asdict(solved.cost)),
            "relative_residual": solved.relative_residual,
            "difference_to_mumps": solved.difference_to_direct if "mumps" in names else None,
        }
        for solved in found.solved
    ]


if __name__ == "__main__":
    main()
