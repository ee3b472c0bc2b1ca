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
do. A solver that is in the file for this level and number of processes is not run again,
unless by --again.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from mpi4py import MPI

from benchmarks.common.arguments import add_records, create_parser, one_of, open_records, several
from benchmarks.common.machine import available_mib, describe, now
from benchmarks.common.progress import say
from benchmarks.common.records import Record
from benchmarks.unit_cube.case import LEVELS, Case
from benchmarks.unit_cube.solvers import SOLVERS, solve
from meshes.arguments import count

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None, comm: MPI.Comm = MPI.COMM_WORLD) -> int:
    """Run the comparison that the command line describes, see :func:`benchmarks.cube.main`."""
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
        wanted = [
            name
            for name in args.solvers
            if args.again or records.find(place | {"solver": name}) is None
        ]
        for name, found in solve(case, wanted, comm, min(args.memory, available_mib(comm))):
            key = place | {"solver": name}
            record = records.put(key, key | found | {"machine": describe(), "date": now()})
            say(_row(record), comm)
    return 0


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
