# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's strong scaling: one load step on more and more processes, and what they send.

    python3 -m benchmarks.scaling --geometry vessel --processes 1,2 --json build/scaling.json

The load step to 0.2 mmHg with κ = 100 kPa, P1–P0 and the lumped preconditioner (section *Strong
scaling for nonlinear elasticity*, tables Augustin_tab:aorta_scaling and carotis_scaling):
all-floating FETI on the wall of one layer, classical FETI on that of two. --processes are measured,
at most as many as there are cores. --count are counted, any number on any machine: messages, bytes,
neighbours, reductions and coarse solves of an iteration and of a set-up.

Each number of processes is a program of its own, which this one starts with mpirun: so one command
makes the table, a case that fails takes no other one along, and the library that counts is in no
run that is measured. Do not run this with mpirun. A case that is in the file is not run again,
unless by --again. `benchmarks.scaling_page` makes the page.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from mpi4py import MPI

from benchmarks.common.arguments import (
    count_or_zero,
    create_parser,
    one_of,
    open_records,
    parse_words,
    several,
)
from benchmarks.common.machine import describe, now
from benchmarks.common.progress import say
from benchmarks.common.records import Record, Records
from benchmarks.common.traffic import compile_library
from benchmarks.strong_scaling.groups import CHOICES, TYPES, is_known
from meshes.arguments import count, positive
from meshes.walls import CREATE

__all__ = ["main"]

#: Environment of a process that mpirun has started, which another mpirun must not see.
INHERITED = ("PMIX_", "PRTE_", "OMPI_COMM_WORLD_", "OMPI_FILE_", "OMPI_UNIVERSE_")

#: Preconditioners of the two choices.
PC = {"paper": "lumped", "default": "dirichlet"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study, or what is left of it.

    Args:
        argv: The command line without the program's name; None for that of the process.

    Returns:
        How many cases failed.

    Raises:
        SystemExit: A word of the command line is wrong, or the file cannot be used.
    """
    comm = MPI.COMM_SELF
    parser = _create_parser(comm)
    args = parse_words(parser, argv)
    _check(args, parser)
    records = open_records(args.json, parser, comm, known=is_known, writer="benchmarks.scaling")
    try:
        library = compile_library(args.folder) if args.count else None
    except (OSError, subprocess.CalledProcessError) as error:
        parser.error(f"--count {args.count}: {error}; leave it out with --count 0")
    lost = 0
    for case in _plan(args):
        if not args.again and records.find(case) is not None:
            say(f"{_name(case)}: in the records already", comm)
        else:
            lost += not _run(case, args, records, library, comm)
    return lost


def _plan(args: argparse.Namespace) -> Iterator[Record]:
    """Yield the cases: counted first, for that is quick."""
    for task, numbers in (("count", args.count), ("measure", args.processes)):
        for choices in args.choices:
            for layers in args.layers:
                for processes in numbers:
                    yield {
                        "study": "scaling",
                        "task": task,
                        "geometry": args.geometry,
                        "size": args.size,
                        "layers": layers,
                        "degree": 1,
                        "kappa": 100.0,
                        "type": TYPES[layers],
                        "pc": PC[choices],
                        "choices": choices,
                        "subdomains": args.subdomains,
                        "processes": processes,
                    }


def _run(
    case: Record, args: argparse.Namespace, records: Records, library: Path | None, comm: MPI.Comm
) -> bool:
    """Run a case on its processes; return whether it came to its end."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "record.json"
        inside = json.dumps(case | {"folder": str(args.folder)})
        words = ["mpirun", "-n", str(case["processes"]), "--oversubscribe"]
        environment = {k: v for k, v in os.environ.items() if not k.startswith(INHERITED)}
        environment["OMP_NUM_THREADS"] = "1"
        if case["task"] == "count":
            words += ["-x", f"LD_PRELOAD={library}"]
            environment["OMPI_MCA_mpi_yield_when_idle"] = "1"
        words += [sys.executable, "-m", "benchmarks.walls.parallel_run", inside, str(file)]
        ended = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
        if ended.returncode != 0 or not file.is_file():
            last = (ended.stderr or ended.stdout).strip()[-2000:]
            say(f"{_name(case)}: failed, exit status {ended.returncode}:\n{last}", comm)
            return False
        found = json.loads(file.read_text())
    record = records.put(case, case | found | {"machine": describe(), "date": now()})
    say(f"{_name(case)}: {_line(record)}", comm)
    return True


def _check(args: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """End with an error if the cases cannot be run here."""
    cores = len(os.sched_getaffinity(0))
    if MPI.COMM_WORLD.size > 1:
        parser.error("it starts mpirun itself: run it as python3 -m benchmarks.scaling")
    args.processes, args.count = ([n for n in ns if n > 0] for ns in (args.processes, args.count))
    if max(args.processes, default=0) > cores:
        parser.error(
            f"--processes {max(args.processes)}: there are {cores} cores, and shared ones measure "
            "nothing; --count takes any number"
        )
    most = max(*args.processes, *args.count, 0, 0)
    if most > args.subdomains:
        parser.error(f"{most} processes need as many --subdomains, and there are {args.subdomains}")
    if shutil.which("mpirun") is None:
        parser.error("mpirun is missing")


def _create_parser(comm: MPI.Comm) -> argparse.ArgumentParser:
    parser = create_parser("scaling", __doc__, comm)
    add = parser.add_argument
    numbers = several(count_or_zero)
    add("--geometry", choices=tuple(CREATE), default="vessel")
    add("--size", type=positive, default=None, help="length of the elements' edges [mm]")
    add("--processes", type=numbers, default=[1, 2], help="to measure, 1,2; 0 for none")
    some = [1, 2, 4, 8, 16, 32, 64]
    add("--count", type=numbers, default=some, help="to count, 1,2,4,8,16,32,64; 0 for none")
    add("--subdomains", type=count, default=512, help="over all processes, 512")
    layers = {"type": several(one_of(tuple(TYPES))), "default": list(TYPES)}
    add("--layers", **layers, help="1 with all-floating FETI, 2 with classical, 1,2")
    choices = {"type": several(one_of(tuple(CHOICES))), "default": list(CHOICES)}
    add("--choices", **choices, help="the paper's and the package's own, paper,default")
    add("--folder", type=Path, default=Path("build/walls"), help="where meshes are kept")
    add("--json", type=Path, metavar="FILE", help="records, added to what the file holds")
    add("--again", action="store_true", help="also run cases that the file has")
    return parser


def _name(case: Record) -> str:
    return f"{case['task']}, {case['type']}, {case['choices']}, {case['processes']} process(es)"


def _line(record: Record) -> str:
    """Format what was found as a line."""
    if record["task"] == "count":
        each = record["iteration"]
        return (
            f"an iteration sends {each['messages']['max']:.0f} messages, "
            f"{each['bytes']['max']:.0f} bytes, to {record['neighbours']:.0f} neighbours, with "
            f"{each['reductions']['max']:.1f} reductions and {record['coarse_solves']:.1f} coarse "
            "solves"
        )
    return (
        f"local {record['seconds_local']:.2f} s, Krylov {record['seconds_krylov']:.2f} s, total "
        f"{record['seconds_total']:.2f} s, {record['newton_iterations']} Newton steps of "
        f"{record['linear_iterations_mean']:.0f} iterations"
    )


if __name__ == "__main__":
    sys.exit(main())
