# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The linear study in small: a command line of a second, and records with the paper's values."""

from __future__ import annotations

import json
from pathlib import Path

from collective import COMM
from wall_files import on_first

from benchmarks.common import machine
from benchmarks.cube import paper
from benchmarks.cube import run as cube
from benchmarks.cube.case import Case

#: A study of a second, with a subdomain for each of three processes.
SMALL = ["--subdomains-per-edge", "2", "--pc", "dirichlet", "--type", "all_floating"]


def run_cube(file: Path, *arguments: object) -> tuple[int, list[dict]]:
    """Run the study of the cube; return its exit status and the records of its file."""
    status = cube.main([*map(str, arguments), "--json", str(file)], COMM)
    return status, on_first(lambda: json.loads(file.read_text() or "[]"))


def record_of(kind: str, pc: str, level: int, **changes: object) -> dict:
    """Return a record with the paper's own values."""
    its, condition = paper.SOLVES[kind, pc, level]
    key = Case(type=kind, pc=pc, level=level).key()
    values = {"iterations": its, "condition_number": condition, "lambda_min": 1.0}
    values |= {"lambda_max": condition, "l2_error": 0.5 * paper.L2_ERRORS[kind, level]}
    values |= {"dofs": 1, "dofs_torn": 2, "multipliers": 38052, "coarse_size": 3072}
    times = ("seconds_setup", "seconds_solve", "seconds_coarse", "seconds_streaming")
    values |= dict.fromkeys((*times, "cpu_seconds_setup", "cpu_seconds_solve"), 1.0)
    values |= {"coarse_mib": 12.0}
    values |= {"interior_is": "kept", "peak_mib": 1234.0, "estimated_mib": 1300.0}
    values |= {"machine": machine.describe(), "processes": 1, "bandwidth_gb_s": 10.0}
    values |= {"date": "2026-01-02T03:04:05+00:00"}
    return key | values | changes


#: The paper's whole table.
EVERYTHING = [record_of(*key) for key in paper.SOLVES]
