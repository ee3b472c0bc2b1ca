# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""All cases of the linear study in one run, which can be interrupted and resumed.

    mpirun -n 2 python3 -m benchmarks.linear --json build/linear.json

The paper's table comes first, then what goes beyond it. A case that is in the file is not run
again, unless by --again; a case that will not fit into the memory is refused, with the estimate in
the file. The study ends well with refusals, too.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace

from mpi4py import MPI

from benchmarks.common.arguments import add_records, create_parser, one_of, open_records, several
from benchmarks.unit_cube.case import Case
from benchmarks.unit_cube.study import Study

__all__ = ["SETS", "main", "plan"]

TYPES = ("all_floating", "classical")
PRECONDITIONERS = ("identity", "lumped", "dirichlet")

#: Coefficients of the stiff subcubes, and the scalings and weights Q that are tried on them.
JUMPS = (1e2, 1e4, 1e6)
WEIGHTS = tuple(itertools.product(("multiplicity", "stiffness"), ("identity", "preconditioner")))


def papers() -> Iterator[Case]:
    """The paper's table, and the same with quadratic elements."""
    for degree, levels in ((1, (1, 2, 3)), (2, (1, 2))):
        for level in levels:
            yield from _all(Case(degree=degree, level=level))


def choices() -> Iterator[Case]:
    """One choice at a time that is not the paper's, and this package's own."""
    own = {"scaling": "stiffness", "coarse_q": "preconditioner"}
    changes = (
        {"reorthogonalize": True},
        {"coarse_q": "diagonal"},
        {"coarse_q": "preconditioner"},
        {"scaling": "stiffness"},
        {"gluing": "nonred"},
        own,
        own | {"coarse_modes": 12},
    )
    for kind, change in itertools.product(TYPES, changes):
        yield Case(level=2, type=kind, **change)
    for kind, pc in itertools.product(TYPES, ("identity", "lumped")):
        yield Case(level=2, type=kind, pc=pc, reorthogonalize=True)


def jumps() -> Iterator[Case]:
    """Young's modulus jumps between subcubes: a checkerboard, and a stiff layer."""
    patterns = [("none", 1.0), *itertools.product(("checkerboard", "layer"), JUMPS)]
    for (pattern, jump), kind, (scaling, q) in itertools.product(patterns, TYPES, WEIGHTS):
        choice = {"type": kind, "scaling": scaling, "coarse_q": q}
        yield Case(subdomains_per_edge=4, level=2, pattern=pattern, jump=jump, **choice)


def growth() -> Iterator[Case]:
    """More cells in a subdomain, in a cube of 64."""
    for level in (1, 2, 3, 4):
        yield from _all(Case(subdomains_per_edge=4, level=level))


def numbers() -> Iterator[Case]:
    """More subdomains of the same size, with the paper's weight Q and this package's."""
    for level, edge, q in itertools.product((1, 2), (2, 4, 8, 16), ("identity", "preconditioner")):
        yield from _both(Case(level=level, subdomains_per_edge=edge, coarse_q=q))
    yield from _both(Case(subdomains_per_edge=32))


def largest() -> Iterator[Case]:
    """What takes the most memory: the paper's fourth level, and the third of quadratic elements."""
    for degree, level in ((1, 4), (2, 3)):
        yield from _all(Case(degree=degree, level=level))


#: Parts of the study by name.
SETS = {each.__name__: each for each in (papers, choices, jumps, growth, numbers, largest)}


def plan(sets: Sequence[str] = tuple(SETS)) -> list[Case]:
    """Return the cases of some sets, each once."""
    return list(dict.fromkeys(case for name in sets for case in SETS[name]()))


def main(arguments: Sequence[str] | None = None, comm: MPI.Comm = MPI.COMM_WORLD) -> int:
    """Run the study, or what is left of it, see :func:`benchmarks.cube.main`."""
    parser = create_parser("linear", __doc__, comm)
    kind = {"type": several(one_of(tuple(SETS))), "default": list(SETS)}
    parser.add_argument("--sets", **kind, help=f"parts of the study; {','.join(SETS)}")
    add_records(parser)
    args = parser.parse_args(arguments)
    cases = [case for case in plan(args.sets) if case.subdomains_per_edge**3 >= comm.size]
    records = open_records(args.json, parser, comm)
    Study(cases, records, comm, limit=args.memory, again=args.again).run()
    return 0


def _both(case: Case) -> Iterator[Case]:
    """Both types."""
    for kind in TYPES:
        yield replace(case, type=kind)


def _all(case: Case) -> Iterator[Case]:
    """Both types and all preconditioners."""
    for kind, pc in itertools.product(TYPES, PRECONDITIONERS):
        yield replace(case, type=kind, pc=pc)


if __name__ == "__main__":
    sys.exit(main())
