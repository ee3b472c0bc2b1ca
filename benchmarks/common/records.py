# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A JSON file of records that is written as a study goes on, and read when it is resumed."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from mpi4py import MPI

import dolfinx_feti
from benchmarks.common.machine import describe, now
from dolfinx_feti.runtime.collective import on_first, reason

__all__ = ["Record", "Records", "read_records"]

Record = dict[str, object]


class Records:
    """Records of a study, in a file if there is one; equal on all processes."""

    def __init__(self, path: Path | None, comm: MPI.Comm) -> None:
        """Read the file, or find out that it can be written. Collective.

        Args:
            path: The file; its folder is made. None keeps the records in memory.
            comm: The first of its processes reads and writes.

        Raises:
            ValueError: The file cannot be written, or holds something else. On all processes.
        """
        self._path, self._comm = path, comm
        self._records: list[Record] = []
        if path is not None:
            try:
                self._records = on_first(lambda: _read_or_create(path), comm)
            except (OSError, ValueError) as error:
                raise ValueError(
                    f"--json '{path}' cannot be used: {error}. Name another file."
                ) from error

    def __iter__(self) -> Iterator[Record]:
        """Go through the records."""
        return iter(self._records)

    def find(self, key: Record) -> Record | None:
        """Return the record that has these values, if there is one."""
        return next(iter(self.all(key)), None)

    def all(self, key: Record) -> list[Record]:
        """Return all records that have these values."""
        same = key.items()
        return [r for r in self._records if all(r.get(n, ...) == value for n, value in same)]

    def put(self, key: Record, record: Record) -> Record:
        """Put the first process's record in the place of that with the same key, and write it.

        Raises:
            OSError: The file cannot be written any more. On all processes; the file is as before.
        """
        record = self._comm.bcast(record)
        old = self.find(key)
        if old is None:
            self._records.append(record)
        else:
            self._records[self._records.index(old)] = record
        if self._path is not None:
            path, records = self._path, self._records
            try:
                on_first(lambda: _write(path, records), self._comm)
            except OSError as error:
                raise OSError(
                    f"The records in '{path}' cannot be written ({reason(error)}): make room, and "
                    "run it again; what the file holds is not repeated."
                ) from error
        return record

    def keep(self, key: Record, found: Record) -> Record:
        """Put what came of a case, with what it takes to run it again. Collective."""
        made = {"machine": describe(), "date": now(), "version": dolfinx_feti.__version__}
        made |= {"commit": commit(), "command": shlex.join(sys.orig_argv)}
        return self.put(key, key | found | made)


def commit() -> str | None:
    """Return the commit of the checkout, with a plus if files differ from it; None outside one."""
    try:
        said = subprocess.run(
            ["git", "describe", "--always", "--abbrev=12", "--exclude=*", "--dirty=+"],
            cwd=Path(__file__).parent,
            capture_output=True,
            check=True,
            text=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return said.stdout.strip()


def read_records(path: Path, known: Callable[[Record], bool], writer: str) -> list[Record]:
    """Read the records that a benchmark has written, told by ``known``.

    Raises:
        OSError: The file cannot be read.
        ValueError: It holds something else, or nothing.
    """
    try:
        records = _parse(path)
        sound = records and all(map(known, records))
        cause = "" if sound else "there are none, or some of another kind"
    except ValueError as error:
        cause = str(error)
    if cause:
        raise ValueError(f"{path} holds no records of {writer}: {cause}. Name a file of it.")
    return records


def _parse(path: Path) -> list[Record]:
    text = path.read_text()
    records = json.loads(text) if text.strip() else []
    if not isinstance(records, list) or not all(isinstance(record, dict) for record in records):
        raise ValueError("it holds something else than a list of records")
    return records


def _read_or_create(path: Path) -> list[Record]:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a"):
        pass
    return _parse(path)


def _write(path: Path, records: list[Record]) -> None:
    """Write all records beside the file, then put them in its place: there is one whole file."""
    whole = path.with_name(path.name + ".part")
    lines = (json.dumps(each, ensure_ascii=False) for each in records)
    try:
        whole.write_text("[\n" + ",\n".join(lines) + "\n]\n")
        os.replace(whole, path)
    finally:
        whole.unlink(missing_ok=True)
