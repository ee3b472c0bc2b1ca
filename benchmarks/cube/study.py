# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Cases of the cube one after the other, each with a record, if the memory allows it."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from mpi4py import MPI

from benchmarks.common import command
from benchmarks.common.cube import CubeProblem
from benchmarks.common.machine import available_mib, bandwidth, resident_mib
from benchmarks.common.records import Record, Records
from benchmarks.cube.case import Case, run
from dolfinx_feti import ConvergenceError
from dolfinx_feti.runtime.collective import on_first

__all__ = ["is_solved", "run_all"]

HEAD = f"{'':<52}{'it.':>5}{'κ':>10}{'L2 error':>10}{'set-up':>10}{'solve':>10}{'MiB':>7}"

#: Parameters of the mesh and the form; cases that agree in them share a problem.
SHARED = ("degree", "level", "subdomains_per_edge", "jump", "pattern", "source")


def run_all(
    cases: Sequence[Case], records: Records, comm: MPI.Comm, *, limit: float, again: bool
) -> int:
    """Run cases that the records lack, and return how many were refused or have failed. Collective.

    The records are written after each case; one that was refused or has failed is there without
    results, and tried again. Cases next to each other share a mesh, if they can. No more memory is
    taken than there is, and than ``limit`` [MiB].
    """
    left = [case for case in cases if again or not is_solved(records.find(case.key()))]
    if len(left) < len(cases):
        command.say(f"{len(cases) - len(left)} case(s) are in the records already", comm)
    if not left:
        return 0
    command.say(HEAD, comm)
    speed = bandwidth(comm)
    lost, mesh, problem = 0, None, None
    for case in left:
        if mesh != [getattr(case, name) for name in SHARED]:
            mesh, problem = [getattr(case, name) for name in SHARED], None
        found, problem = _measure(case, problem, speed, comm, limit)
        record = records.keep(case.key(), found)
        lost += not is_solved(record)
        command.say(_line(case, record), comm, None if is_solved(record) else sys.stderr)
    return lost


def is_solved(record: Record | None) -> bool:
    """Tell whether a record holds results, and no refusal or failure."""
    return record is not None and "iterations" in record


def _measure(
    case: Case, problem: CubeProblem | None, speed: float, comm: MPI.Comm, limit: float
) -> tuple[Record, CubeProblem | None]:
    """Solve a case that fits; return what is to be recorded, and the problem for others."""
    estimated = on_first(lambda: case.estimate(comm.size), comm)
    known: Record = {"estimated_mib": estimated.mib, "processes": comm.size}
    room = min(resident_mib(comm) + available_mib(comm), limit)
    if estimated.mib > room:
        return known | {"available_mib": room}, problem
    problem = problem or case.problem(comm)
    try:
        found = run(case, problem, comm)
    except ConvergenceError as failure:
        return {"failure": str(failure), "processes": comm.size}, problem
    streaming = {"seconds_streaming": estimated.streamed / speed, "bandwidth_gb_s": speed / 1e9}
    return found | known | streaming, problem


def _line(case: Case, record: Record) -> str:
    """Format a record as a line, below :data:`HEAD` if there are results."""
    if "failure" in record:
        return f"failed: {case}: {record['failure']}"
    if not is_solved(record):
        need, room = (f"{record[f'{n}_mib'] / 2**10:.1f} GiB" for n in ("estimated", "available"))
        return (
            f"refused: {case} needs about {need}, and {room} are available: choose a lower "
            "--level, fewer --subdomains-per-edge, or --pc lumped or identity."
        )
    condition = _format(record["condition_number"], ".4g", 10)
    error = _format(record["l2_error"], ".2e", 10)
    times = "".join(f"{record[f'seconds_{phase}']:>8.2f} s" for phase in ("setup", "solve"))
    peak = _format(record["peak_mib"], ".0f", 7)
    return f"{case!s:<52}{record['iterations']:>5}{condition}{error}{times}{peak}"


def _format(value: object, form: str, width: int) -> str:
    return ("–" if value is None else format(value, form)).rjust(width)
