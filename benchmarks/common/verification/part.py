# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Parts of the verification study: each has its own cases, records and sections of the page."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

from benchmarks.common.pages import Fields
from benchmarks.common.records import Record, Records
from benchmarks.common.study import Arguments, Keep, has_record, no_pictures


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A part of the study; its functions are those of a Study, for its own cases and records.

    Args:
        key: Key that distinguishes the records of this part from those of others.
        values: Values of this key.
        options: Adds the part's own options to the command line.
        cases: Yields the key of each case.
        run: Measures a case and keeps its records. Collective.
        fields: Returns the values of the part's sections from its records.
        done: Returns True if a case has all its records.
        draw: Draws pictures into a folder; returns a row for each.
    """

    key: str
    values: Collection[str]
    options: Callable[[argparse.ArgumentParser], None]
    cases: Callable[[Arguments, MPI.Comm], Iterator[Record]]
    run: Callable[[Record, Keep, Arguments, MPI.Comm], None]
    fields: Callable[[Sequence[Record]], Fields]
    done: Callable[[Record, Records, Arguments], bool] = has_record
    draw: Callable[[Sequence[Record], Path], Sequence[Fields]] = no_pictures

    def has(self, record: Record) -> bool:
        """Return True if a record, or the key of a case, is one of this part."""
        value = record.get(self.key)
        return isinstance(value, str) and value in self.values
