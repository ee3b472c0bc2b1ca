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
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from pathlib import Path

from dolfinx_feti.loading.steps import LoadStep
from dolfinx_feti.problems.history import NewtonStep

__all__ = ["write_history"]

COLUMNS = ("load_step", "load", "accepted", "newton_step", *(f.name for f in fields(NewtonStep)))


def write_history(path: Path | str, steps: Sequence[LoadStep]) -> None:
    """Write the history of load steps; the file is replaced as a whole.

    Args:
        path: The file, `*.csv`, which is replaced.
        steps: The load steps, as :func:`~dolfinx_feti.loading.load_steps.follow_load` returns them.

    Raises:
        OSError: The file cannot be written.

    Note:
        Serial: call it on one process.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.part")
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
