# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Statements that the counts of the scaling study should confirm, and whether they do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from benchmarks.common.records import Record
from benchmarks.common.table import Table, number
from benchmarks.strong_scaling.groups import CHOICES, TYPES, series

__all__ = ["check_table"]

#: Processes from which on a process has as many neighbours as it ever will.
FLAT_FROM = 8

#: By how much a count may grow from there on.
GROWTH = 1.25

#: Most neighbours of a process and reductions of an iteration.
NEIGHBOURS, REDUCTIONS = 30, 3


def check_table(records: Sequence[Record]) -> Table:
    """Make the table of all checks."""
    rows = []
    for of_one in series(records):
        mine = [r for r in of_one.counted if r["processes"] >= FLAT_FROM]
        if mine:
            name = [TYPES[of_one.layers].replace("_", "-"), CHOICES[of_one.choices]]
            rows += [[*name, *cells] for cells in _checks(mine)]
    head = ["type", "choices", "quantity", "bound", "counted", "holds"]
    note = (
        f"From {FLAT_FROM} processes on; *grows* compares the most processes with the fewest, and "
        f"is bounded by {GROWTH:g}. Greatest of all processes."
    )
    return Table("What should not grow with the processes", head, rows, note)


def _checks(records: Sequence[Record]) -> Iterator[list[str]]:
    """Yield the rows of a series: quantity, bound, value, verdict."""
    neighbours = max(r["neighbours"] for r in records)
    yield _row("neighbours of a process", f"≤ {NEIGHBOURS}", neighbours, neighbours <= NEIGHBOURS)
    reductions = max(r["iteration"]["reductions"]["max"] for r in records)
    name = "reductions in an iteration"
    yield _row(name, f"≤ {REDUCTIONS}", reductions, reductions <= REDUCTIONS)
    for what, count in COUNTS.items():
        values = [count(record) for record in records]
        if len(values) > 1 and values[0] > 0.0:
            grown = values[-1] / values[0]
            yield _row(f"{what}, grows", f"≤ {GROWTH:g}", grown, grown <= GROWTH)


#: Counts that are to stay as they are.
COUNTS: dict[str, Callable[[Record], float]] = {
    "messages of a process, an iteration": lambda r: r["iteration"]["messages"]["mean"],
    "messages of the busiest process": lambda r: r["iteration"]["messages"]["max"],
    "reductions, an iteration": lambda r: r["iteration"]["reductions"]["max"],
    "bytes into reductions, an iteration": lambda r: r["iteration"]["contributed"]["max"],
    "coarse solves, an iteration": lambda r: r["coarse_solves"],
    "reductions, a set-up": lambda r: r["setup"]["reductions"]["max"],
    "bytes into reductions, a set-up": lambda r: r["setup"]["contributed"]["max"],
}


def _row(what: str, bound: str, value: float, holds: bool) -> list[str]:
    return [what, bound, number(value), "yes" if holds else "**no**"]
