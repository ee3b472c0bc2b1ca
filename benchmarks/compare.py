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

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import petsc4py

petsc4py.init([word for word in sys.argv if not word.startswith("--")])

from mpi4py import MPI  # noqa: E402
from petsc4py import PETSc  # noqa: E402

from benchmarks.arguments import count, open_records, parse_words, positive  # noqa: E402
from benchmarks.gamg import create_gamg, difference  # noqa: E402
from benchmarks.records import Record  # noqa: E402
from benchmarks.tube_problem import create_tube_problem  # noqa: E402
from benchmarks.wall_problem import WallProblem  # noqa: E402
from dolfinx_feti import loads  # noqa: E402
from dolfinx_feti.comparison import (  # noqa: E402
    assembled_system,
    create_mumps,
    measure,
    relative_residual,
)

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
    parser = create_parser()
    args = parse_words(parser, argv)
    file = open_records(args.json, parser, comm)
    tube = create_tube_problem(
        comm,
        dofs=args.dofs,
        kappa=args.kappa,
        subdomains=args.subdomains,
        options={"ksp_rtol": RTOL},
    )
    records = compare(tube, args.solvers, kappa=args.kappa)
    for record in records:
        file.put({key: record[key] for key in ("solver", "kappa", "dofs", "processes")}, record)
        if comm.rank == 0:
            print(json.dumps(record))
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
    """Assemble the torn tangent at 1 mmHg and return the right-hand side −r."""
    tube.pressure.value = loads.mmhg(1.0)
    b = tube.problem.A.createVecLeft()
    b.array[:] = -tube.problem._system.residual().condensed
    tube.problem._system.linearise()
    return b


def share_feti(tube: WallProblem) -> PETSc.KSP:
    """Return the KSP of the problem; who destroys it lets the problem keep it."""
    ksp = tube.problem.solver.getKSP()
    ksp.setOperators(tube.problem.A)
    ksp.incRef()
    return ksp


def create_parser() -> argparse.ArgumentParser:
    """Create a parser of the options with two dashes."""
    parser = argparse.ArgumentParser(
        "compare", description=__doc__.splitlines()[0], allow_abbrev=False
    )
    parser.add_argument("--kappa", type=positive, default=1000.0, help="[kPa], 1000")
    parser.add_argument("--dofs", type=count, default=180_000, help="about so many, 180000")
    parser.add_argument("--subdomains", type=count, default=96, help="over all processes, 96")
    parser.add_argument("--solvers", type=_solvers, default=list(SOLVERS), help=",".join(SOLVERS))
    parser.add_argument("--json", type=Path, metavar="FILE", help="where the records are kept")
    return parser


def _solvers(text: str) -> list[str]:
    names = text.split(",")
    if not set(names) <= set(SOLVERS):
        raise argparse.ArgumentTypeError(f"{text!r}: name some of {', '.join(SOLVERS)}")
    return names


if __name__ == "__main__":
    main()
