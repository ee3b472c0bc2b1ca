# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The paper's strong scaling: one load step on more and more processes, and what they send.

    python3 -m benchmarks.scaling --geometry vessel --processes 1,2 --json build/scaling.json

The load step to 0.2 mmHg with κ = 100 kPa, P1–P0 and the lumped preconditioner (section *Strong
scaling for nonlinear elasticity*, tables Augustin_tab:aorta_scaling and carotis_scaling):
all-floating FETI on the wall of one layer, classical FETI on that of two. --processes are measured,
at most as many as there are cores. --count are counted, any number on any machine: messages, bytes,
neighbours, reductions and coarse solves of an iteration and of a set-up. --converge are taken to
the end of the load step with one subdomain on each process, and --coarse set the cube up with 2048
on each, for the memory of the coarse problem. ``--predict DOFS PROCESSES`` runs nothing: it prints
what the model makes of the records.

Each number of processes is a program of its own, which this one starts with mpirun: so one command
makes the table, a case that fails takes no other one along, and the library that counts is in no
run that is measured. Do not run this with mpirun. A case that is in the file is not run again,
unless by --again. `benchmarks.scaling.page` makes the page.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from mpi4py import MPI

from benchmarks.common import command
from benchmarks.common.records import Record, Records
from benchmarks.common.walls.first_step import CHOICES
from benchmarks.scaling.predict import predict
from benchmarks.scaling.traffic import compile_library
from benchmarks.scaling.weak import EACH
from meshes.arguments import count

__all__ = ["INHERITED", "TYPES", "is_known", "main"]

#: Variant by layers of the wall: the paper's aorta, its carotid artery.
TYPES = {1: "all_floating", 2: "classical"}

#: Environment of a process that mpirun has started, which another mpirun must not see.
INHERITED = ("PMIX_", "PRTE_", "OMPI_COMM_WORLD_", "OMPI_FILE_", "OMPI_UNIVERSE_")

#: Records of the page.
KEPT = Path(__file__).parents[2] / "docs/results/scaling.json"

#: Preconditioners of the two choices.
PC = {"paper": "lumped", "default": "dirichlet"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study, or what is left of it; return how many cases failed."""
    comm = MPI.COMM_SELF
    parser = _create_parser(comm)
    args = command.parse_words(parser, argv)
    if args.predict:
        known = command.open_records(args.json or KEPT, parser, comm, is_known)
        command.say("\n".join(predict(list(known), *args.predict)), comm)
        return 0
    _check(args, parser)
    records = command.open_records(args.json, parser, comm, is_known)
    try:
        library = compile_library(args.folder) if args.count + args.converge else None
    except (OSError, subprocess.CalledProcessError) as error:
        parser.error(f"--count {args.count}: {error}; leave it out with --count 0")
    lost = 0
    for case in _plan(args):
        if not args.again and records.find(case) is not None:
            command.say(f"{_name(case)}: in the records already", comm)
        else:
            lost += not _run(case, args, records, library, comm)
    return lost


def is_known(record: Record) -> bool:
    """Tell whether a record is one of this study."""
    return record.get("study") == "scaling"


def _plan(args: argparse.Namespace) -> Iterator[Record]:
    """Yield the cases: counted first, for that is quick."""
    tasks = {"converge": args.converge, "count": args.count, "measure": args.processes}
    for task, numbers in tasks.items():
        for choices, layers, processes in itertools.product(args.choices, args.layers, numbers):
            if task == "converge" and choices == "paper":  # five steps do not arrive
                continue
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
                "subdomains": processes if task == "converge" else args.subdomains,
                "processes": processes,
            }

    for processes in args.coarse:
        own = {"study": "scaling", "task": "coarse", "geometry": "cube", "type": "all_floating"}
        own |= {"choices": "paper", "pc": "dirichlet", "subdomains": EACH * processes}
        yield own | {"processes": processes}


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
        if case["task"] in ("count", "converge"):
            words += ["-x", f"LD_PRELOAD={library}"]
        if case["task"] != "measure":
            environment["OMPI_MCA_mpi_yield_when_idle"] = "1"
        words += [sys.executable, "-m", "benchmarks.scaling.worker", inside, str(file)]
        ended = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
        if ended.returncode != 0 or not file.is_file():
            last = (ended.stderr or ended.stdout).strip()[-2000:]
            command.say(f"{_name(case)}: failed, exit status {ended.returncode}:\n{last}", comm)
            return False
        found = json.loads(file.read_text())
    record = records.keep(case, found)
    command.say(f"{_name(case)}: {_line(record)}", comm)
    return True


def _check(args: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """End with an error if the cases cannot be run here."""
    cores = len(os.sched_getaffinity(0))
    if MPI.COMM_WORLD.size > 1:
        parser.error("it starts mpirun itself: run it as python3 -m benchmarks.scaling")
    for name in ("processes", "count", "converge", "coarse"):
        setattr(args, name, [n for n in getattr(args, name) if n > 0])
    if any(round((EACH * P) ** (1.0 / 3.0)) ** 3 != EACH * P for P in args.coarse):
        parser.error(f"--coarse {args.coarse}: {EACH} subcubes on each of 2, 16, 54, … make a cube")
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
    parser = command.create_parser("scaling", __doc__, comm)
    add = parser.add_argument
    numbers = command.several(command.count_or_zero)
    command.add_mesh(parser)
    add("--processes", type=numbers, default=[1, 2], help="to measure, 1,2; 0 for none")
    some = [1, 2, 4, 8, 16, 32, 64]
    add("--count", type=numbers, default=some, help="to count, 1,2,4,8,16,32,64; 0 for none")
    add("--converge", type=numbers, default=[64], help="to take to the end, 64; 0 for none")
    add("--coarse", type=numbers, default=[2, 16], help="for the coarse memory, 2,16; 0 for none")
    add("--predict", type=count, nargs=2, metavar=("DOFS", "PROCESSES"), help="print the model's")
    add("--subdomains", type=count, default=512, help="over all processes, 512")
    layers = {"type": command.some_of(tuple(TYPES)), "default": list(TYPES)}
    add("--layers", **layers, help="1 with all-floating FETI, 2 with classical, 1,2")
    choices = {"type": command.some_of(tuple(CHOICES)), "default": list(CHOICES)}
    add("--choices", **choices, help="the paper's and the package's own, paper,default")
    command.add_records(parser)
    return parser


def _name(case: Record) -> str:
    return f"{case['task']}, {case['type']}, {case['choices']}, {case['processes']} process(es)"


def _line(record: Record) -> str:
    """Format what was found as a line."""
    if record["task"] == "converge":
        steps = record["linear_iterations_per_newton"]
        return (
            f"{record['multipliers']} multipliers, {len(steps)} Newton steps of {steps} iterations"
        )
    if record["task"] == "coarse":
        return (
            f"{record['coarse_size']} coarse unknowns, {record['coarse_solver']}, "
            f"{record['coarse_peak_mib']['max']:.0f} MiB at most"
        )
    if record["task"] == "count":
        sent = {name: record["iteration"][name]["max"] for name in ("messages", "bytes")}
        return (
            f"an iteration sends {sent['messages']:.0f} messages, {sent['bytes']:.0f} bytes, to "
            f"{record['neighbours']:.0f} neighbours"
        )
    return (
        f"local {record['seconds_local']:.2f} s, Krylov {record['seconds_krylov']:.2f} s, total "
        f"{record['seconds_total']:.2f} s, {record['newton_iterations']} Newton steps"
    )
