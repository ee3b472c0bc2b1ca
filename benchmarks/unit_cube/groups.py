# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Which records of the linear study belong together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from benchmarks.common.records import Record
from benchmarks.unit_cube.case import Case
from benchmarks.unit_cube.study import is_solved

__all__ = [
    "PRECONDITIONERS",
    "TYPES",
    "differs_in",
    "group",
    "is_papers",
    "is_solved",
    "order",
    "seconds_an_iteration",
]

TYPES = {"all_floating": "all-floating", "classical": "classical"}
PRECONDITIONERS = ("identity", "lumped", "dirichlet")

#: Parameters that the paper's own cases do not vary.
FIXED = {
    name: value
    for name, value in asdict(Case()).items()
    if name not in ("degree", "level", "type", "pc", "source", "interior")
}


def is_papers(record: Record) -> bool:
    """Tell whether a record has the paper's parameters."""
    return is_solved(record) and all(record[name] == value for name, value in FIXED.items())


def differs_in(record: Record, names: Sequence[str]) -> bool:
    """Tell whether a record has the paper's parameters but for some."""
    return all(record[name] == value for name, value in FIXED.items() if name not in names)


def group(record: Record, *names: str) -> tuple[object, ...]:
    """Return the parameters but for some, and but for those that change no result."""
    kept = [name for name in asdict(Case()) if name not in (*names, "source", "interior")]
    return tuple(record[name] for name in kept)


def order(record: Record) -> tuple[object, ...]:
    """Return what sorts the rows of a table."""
    pc = str(record["pc"])
    place = PRECONDITIONERS.index(pc) if pc in PRECONDITIONERS else len(PRECONDITIONERS)
    return record["degree"], record["type"], record["level"], place


def seconds_an_iteration(record: Record) -> float:
    """Return the seconds of an iteration; of a whole solution where they were not taken alone."""
    seconds = record.get("seconds_iterations", record["seconds_solve"])
    return float(seconds) / record["iterations"]
