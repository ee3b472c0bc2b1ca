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
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import dolfinx

import dolfinx_feti
from dolfinx_feti.runtime.collective import error_message, on_root

#: A record: numbers, texts, lists and dictionaries, as JSON has them, by name.
Record = dict[str, Any]
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
            writer: Name of the study's page, for messages.

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
            return read_records(path, known, writer, allow_empty=True)

        self._path = path
        self._comm = comm
        self._records = [] if path is None else on_root(read_or_create, comm)

    def __iter__(self) -> Iterator[Record]:
        """Return an iterator over the records."""
        return iter(self._records)

    def all(self, key: Record) -> list[Record]:
        """Return all records whose values are those of the key."""
        return [
            record
            for record in self._records
            if all(name in record and record[name] == value for name, value in key.items())
        ]

    def keep(self, key: Record, values: Record) -> Record:
        """Add a record with the values of the first process, or replace the one with this key.

        It also gets the machine, the version, the date, the commit and the command. Collective.

        Args:
            key: Entries that distinguish the record from others.
            values: Measured values.

        Returns:
            The record, the same on all processes.

        Raises:
            OSError: The file cannot be written any more. On all processes; the file is as before.
        """
        origin = {
            "machine": describe_machine(),
            "version": dolfinx_feti.__version__,
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "commit": commit(),
            "command": shlex.join(sys.orig_argv),
        }
        record = self._comm.bcast(key | values | origin)
        earlier = self.all(key)
        if earlier:
            self._records[self._records.index(earlier[0])] = record
        else:
            self._records.append(record)
        if self._path is not None:
            path = self._path
            records = self._records
            on_root(lambda: _write(path, records), self._comm)
        return record


def describe_machine() -> dict[str, str | int]:
    """Return the processors, the memory [GiB], and the versions of Python, dolfinx and PETSc."""
    names: list[str] = []
    memory = 0
    with suppress(OSError, ValueError):  # systems other than Linux lack these
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


def read_records(
    path: Path, known: Known, writer: str, *, allow_empty: bool = False
) -> list[Record]:
    """Read the records of a study.

    Args:
        path: JSON file.
        known: Returns True for a record of the study.
        writer: Name of the study, for the message.
        allow_empty: Whether the file may be empty.

    Raises:
        OSError: The file cannot be read.
        ValueError: It holds something else, or nothing where it may not be empty.
    """
    try:
        records = json.loads(path.read_text().strip() or "[]")
        is_of_study = isinstance(records, list) and all(
            isinstance(record, dict) and known(record) for record in records
        )
    except ValueError:
        is_of_study = False
    if not is_of_study or not (records or allow_empty):
        other = "" if is_of_study else ", but something else"
        raise ValueError(f"'{path}' holds no records of {writer}{other}: name another")
    return records


def _write(path: Path, records: list[Record]) -> None:
    """Write all records to a temporary file and rename it, so that the file is always complete."""
    temporary = path.with_name(path.name + ".part")
    lines = (json.dumps(record, ensure_ascii=False) for record in records)
    try:
        temporary.write_text("[\n" + ",\n".join(lines) + "\n]\n")
        os.replace(temporary, path)
    except OSError as error:
        raise OSError(
            f"The records in '{path}' cannot be written ({error_message(error)}): make room, and "
            "run it again; what the file holds is not repeated."
        ) from error
    finally:
        temporary.unlink(missing_ok=True)
