# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A JSON file of records, written after each case and read when a study is resumed."""

from __future__ import annotations

import json
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import dolfinx

import dolfinx_feti
from dolfinx_feti.runtime.collective import error_message, on_root

Record = dict[str, object]
#: Returns True if a record belongs to a study.
Known = Callable[[Record], bool]


class Records:
    """Records of a study, the same on all processes; they are kept in a file if a path is given."""

    def __init__(
        self, path: Path | None, comm: MPI.Comm, known: Known = lambda _: True, writer: str = ""
    ) -> None:
        """Read the records of the file, or create it. Collective.

        Args:
            path: JSON file, which the first process reads and writes; None for none.
            comm: Communicator.
            known: Returns True for a record of the study.
            writer: Name of the study, for messages.

        Raises:
            ValueError: The file cannot be written, or holds something else. On all processes.
        """

        def read_or_create() -> list[Record]:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.open("a").close()
            except OSError as error:
                message = f"--json '{path}' cannot be used: {error}. Name another file."
                raise ValueError(message) from error
            return read_records(path, known, writer, empty=True)

        self._path = path
        self._comm = comm
        self._records = [] if path is None else on_root(read_or_create, comm)

    def __iter__(self) -> Iterator[Record]:
        """Return an iterator over the records."""
        return iter(self._records)

    def all(self, key: Record) -> list[Record]:
        """Return all records whose values are those of the key."""
        same = key.items()
        return [r for r in self._records if all(r.get(n, ...) == value for n, value in same)]

    def keep(self, key: Record, found: Record) -> Record:
        """Add a record with the values of the first process, or replace the one with this key.

        It also gets the machine, the version, the date, the commit and the command. Collective.

        Args:
            key: Entries that distinguish the record from others.
            found: Measured values.

        Returns:
            The record, the same on all processes.

        Raises:
            OSError: The file cannot be written any more. On all processes; the file is as before.
        """
        made = {"machine": describe_machine(), "version": dolfinx_feti.__version__}
        made |= {"date": datetime.now(UTC).isoformat(timespec="seconds")}
        made |= {"commit": commit(), "command": shlex.join(sys.orig_argv)}
        record = self._comm.bcast(key | found | made)
        if known := self.all(key):
            self._records[self._records.index(known[0])] = record
        else:
            self._records.append(record)
        if self._path is not None:
            path = self._path
            records = self._records
            on_root(lambda: _write(path, records), self._comm)
        return record


def describe_machine() -> dict[str, str | int]:
    """Return the processors, the memory [GiB], and the versions of Python, dolfinx and PETSc."""
    names = list[str]()
    memory = 0
    with suppress(OSError, ValueError):  # this is Linux
        names = re.findall(r"model name\s*:\s*(.*)", Path("/proc/cpuinfo").read_text())
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return {
        "processor": f"{len(names)} × {names[0]}" if names else platform.machine(),
        "memory_gib": round(memory / 2**30),
        "python": platform.python_version(),
        "dolfinx": dolfinx.__version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
    }


def threads() -> int:
    """Return the threads that a process may use: OMP_NUM_THREADS, or its cores."""
    return int(os.environ.get("OMP_NUM_THREADS", 0)) or len(os.sched_getaffinity(0))


def commit() -> str | None:
    """Return the commit of the checkout, with a plus if files differ from it; None outside one."""
    words = ["git", "describe", "--always", "--abbrev=12", "--exclude=*", "--dirty=+"]
    try:
        return subprocess.check_output(
            words, cwd=Path(__file__).parent, stderr=subprocess.DEVNULL, text=True
        ).strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def read_records(path: Path, known: Known, writer: str, *, empty: bool = False) -> list[Record]:
    """Read the records of a study.

    Args:
        path: JSON file.
        known: Returns True for a record of the study.
        writer: Name of the study, for the message.
        empty: Whether the file may be empty.

    Raises:
        OSError: The file cannot be read.
        ValueError: It holds something else, or nothing where it may not be empty.
    """
    try:
        records = json.loads(path.read_text().strip() or "[]")
        sound = isinstance(records, list) and all(isinstance(r, dict) and known(r) for r in records)
    except ValueError:
        sound = False
    if not sound or not (records or empty):
        other = "" if sound else ", but something else"
        raise ValueError(f"'{path}' holds no records of {writer}{other}: name another")
    return records


def _write(path: Path, records: list[Record]) -> None:
    """Write all records to another file, then rename it: the file is complete at any time."""
    whole = path.with_name(path.name + ".part")
    lines = (json.dumps(each, ensure_ascii=False) for each in records)
    try:
        whole.write_text("[\n" + ",\n".join(lines) + "\n]\n")
        os.replace(whole, path)
    except OSError as error:
        raise OSError(
            f"The records in '{path}' cannot be written ({error_message(error)}): make room, and "
            "run it again; what the file holds is not repeated."
        ) from error
    finally:
        whole.unlink(missing_ok=True)
