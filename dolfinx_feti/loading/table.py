# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The history of a load as a table, a file of comma-separated values: a row for each Newton step.

Its columns are the number of the load step and its load, whether the attempt was accepted, the
number of the Newton step in it, and the attributes of
:class:`~dolfinx_feti.problems.history.NewtonStep` by their names.
"""

from __future__ import annotations

import csv
import os
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from pathlib import Path

from mpi4py import MPI

from dolfinx_feti.loading.steps import LoadStep
from dolfinx_feti.problems.history import NewtonStep
from dolfinx_feti.runtime.folders import try_to_write

__all__ = ["write_history"]

COLUMNS = ("load_step", "load", "accepted", "newton_step", *(f.name for f in fields(NewtonStep)))


def write_history(
    path: Path | str, steps: Sequence[LoadStep], comm: MPI.Comm | None = None
) -> None:
    """Write the history of load steps; the file is replaced as a whole.

    Args:
        path: The file, `*.csv`, which is replaced; its folder is made, with those above it.
        steps: The load steps, as :func:`~dolfinx_feti.loading.load_steps.follow_load` returns them.
        comm: Communicator of all who call: the first process writes. If not given, each of them
            writes the same whole file, and the last one stays.

    Raises:
        OSError: The file cannot be written.

    Note:
        Collective; raises on all processes.
    """
    comm = MPI.COMM_SELF if comm is None else comm
    try_to_write(lambda place: _write(place, steps), Path(path), "file", comm)


def _write(path: Path, steps: Sequence[LoadStep]) -> None:
    """Write a file of this process's own beside the path, and let it take the path's place."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")
    try:
        with part.open("w", newline="", encoding="utf-8") as file:
            table = csv.DictWriter(file, COLUMNS)
            table.writeheader()
            table.writerows(_rows(steps))
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def _rows(steps: Sequence[LoadStep]) -> Iterator[dict[str, object]]:
    """Yield the rows, those of the failed attempts first."""
    for number, step in enumerate(steps, 1):
        for accepted, history in ((False, step.lost), (True, step.history)):
            for i, newton in enumerate(history):
                head = {"load_step": number, "load": step.load, "accepted": int(accepted)}
                yield head | {"newton_step": i, **asdict(newton)}
