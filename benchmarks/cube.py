# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The linear study of the paper: the unit cube in 512 subdomains, in all variants.

    python3 -m benchmarks.cube --level 1,2,3 --json build/linear.json
    mpirun -n 2 python3 -m benchmarks.cube --degree 2 --type classical --pc lumped

An option that takes several values runs all combinations. The defaults are the paper's choices:
8 × 8 × 8 subdomains, multiplicity scaling, Q = I, full gluing, a reduction of the dual residual by
1e-8; E = 210, ν = 0.45, and on the whole surface the displacements of the fundamental solution with
its source at (2, 2, 2). A case that is in the JSON file is not run again, unless by --again.
The memory is estimated before each case, and a case that will not fit is refused; the exit status
then is 1. PETSC_OPTIONS in the environment serves PETSc's own options.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Iterator, Sequence

from mpi4py import MPI

from benchmarks.common.arguments import (
    add_records,
    count_or_zero,
    create_parser,
    names,
    one_of,
    open_records,
    several,
)
from benchmarks.unit_cube.case import LEVELS, Case
from benchmarks.unit_cube.problem import PATTERNS
from benchmarks.unit_cube.study import Study
from dolfinx_feti.feti.options import CHOICES
from meshes.arguments import count, positive

__all__ = ["main"]

#: Options that take several values.
SEVERAL = (
    *("degree", "level", "subdomains_per_edge", "jump"),
    *("type", "pc", "scaling", "coarse_q", "gluing", "interior"),
)


def main(arguments: Sequence[str] | None = None, comm: MPI.Comm = MPI.COMM_WORLD) -> int:
    """Run the study that the command line describes.

    Args:
        arguments: The command line without the program's name.
        comm: Communicator of the meshes.

    Returns:
        The exit status: 0 if all the cases have a record.

    Raises:
        SystemExit: Bad input, on all processes and before any work.

    Note:
        Collective.
    """
    parser = _create_parser(comm)
    args = parser.parse_args(arguments)
    fewest = min(args.subdomains_per_edge) ** 3
    if comm.size > fewest:
        parser.error(
            f"--subdomains-per-edge {min(args.subdomains_per_edge)} gives {fewest} subdomain(s) to "
            f"{comm.size} processes: take fewer processes, or as many subdomains at least"
        )
    if (args.pattern == "none") != (args.jump == [1.0]):
        parser.error(
            f"--jump {args.jump} and --pattern {args.pattern}: give both, how stiff and which "
            "subdomains, or none of them"
        )
    records = open_records(args.json, parser, comm)
    study = Study(list(_cases(args)), records, comm, limit=args.memory, again=args.again)
    study.run()
    return int(study.refused + study.failed > 0)


def _cases(args: argparse.Namespace) -> Iterator[Case]:
    """Combine the values of all options."""
    rest = ("coarse_modes", "reorthogonalize", "pattern", "source")
    single = {name: getattr(args, name) for name in rest}
    for values in itertools.product(*(getattr(args, name) for name in SEVERAL)):
        yield Case(**dict(zip(SEVERAL, values, strict=True)), **single)


def _create_parser(comm: MPI.Comm) -> argparse.ArgumentParser:
    parser = create_parser("cube", __doc__, comm)
    add = parser.add_argument
    add("--degree", type=several(one_of((1, 2))), default=[1], help="of displacements; 1")
    add("--level", type=several(_level), default=[1], help="of the mesh, 1 to 5; 1")
    edge = {"type": several(count), "default": [8], "metavar": "M"}
    add("--subdomains-per-edge", **edge, help="M³ subdomains; 8")
    for name, default in (
        ("type", "all_floating,classical"),
        ("pc", "identity,lumped,dirichlet"),
        ("scaling", "multiplicity"),
        ("coarse_q", "identity"),
        ("gluing", "full"),
        ("interior", "auto"),
    ):
        choices = CHOICES["pc_type" if name == "pc" else name]
        kind = {"type": several(one_of(choices)), "default": default.split(",")}
        add("--" + name.replace("_", "-"), **kind, help=f"{', '.join(choices)}; {default}")
    add("--coarse-modes", type=count_or_zero, default=0, help="soft modes in the coarse space; 0")
    add("--reorthogonalize", action="store_true", help="CG with full reorthogonalisation")
    add("--jump", type=several(positive), default=[1.0], help="factor of the stiff subdomains; 1")
    add("--pattern", choices=tuple(PATTERNS), default="none", help="which subdomains are stiff")
    point = {"type": _outside, "default": Case().source, "metavar": "X,Y,Z"}
    add("--source", **point, help="source point of the fundamental solution; 2,2,2")
    add_records(parser)
    return parser


def _level(text: str) -> object:
    if text.lstrip("-").isdecimal() and int(text) < LEVELS[0]:
        raise argparse.ArgumentTypeError(
            f"{text!r} would make more subdomains than cells: choose one of {names(LEVELS)}"
        )
    return one_of(LEVELS)(text)


def _outside(text: str) -> tuple[float, ...]:
    try:
        point = tuple(float(word) for word in text.split(","))
    except ValueError:
        point = ()
    if len(point) != 3 or not all(map(math.isfinite, point)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a point X,Y,Z")
    if all(0.0 <= c <= 1.0 for c in point):
        raise argparse.ArgumentTypeError(
            f"{text!r} lies in the unit cube, where the exact solution has to be smooth: choose a "
            "point outside, for example 2,2,2"
        )
    return point


if __name__ == "__main__":
    sys.exit(main())
