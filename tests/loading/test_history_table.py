# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The history of a load as a table."""

from __future__ import annotations

import csv
from dataclasses import asdict

import pytest
from collective import COMM, agree, raises
from played import STEP

from dolfinx_feti.loading import LoadStep, write_history

STEPS = [
    LoadStep(0.5, 0.5, (STEP,), 0, (), 1.0),
    LoadStep(1.0, 0.5, (STEP, STEP), 1, (STEP,), 2.0),
]


@pytest.mark.parametrize("comm", [COMM, None])
def test_a_row_for_each_newton_step(tmp_path, comm):
    """Those of failed attempts first; each with all that is known of it."""
    path = tmp_path / "new/folder/history.csv"
    write_history(path, STEPS[:1], comm)
    write_history(path, STEPS, comm)
    COMM.Barrier()
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    places = [(r["load_step"], r["load"], r["accepted"], r["newton_step"]) for r in rows]
    agree(
        places
        == [
            ("1", "0.5", "1", "0"),
            ("2", "1.0", "0", "0"),
            ("2", "1.0", "1", "0"),
            ("2", "1.0", "1", "1"),
        ],
        places,
    )
    for row in rows:
        agree({name: str(value) for name, value in asdict(STEP).items()}.items() <= row.items())
    agree([p.name for p in path.parent.iterdir()] == ["history.csv"])


def test_what_cannot_be_written(tmp_path):
    """A file in place of the folder, a folder in place of the file: an error on all processes."""
    if COMM.rank == 0:
        (tmp_path / "file").write_text("")
        (tmp_path / "folder").mkdir()
    COMM.Barrier()
    for path in (tmp_path / "file/history.csv", tmp_path / "folder"):
        with raises(OSError, f"output file {path} cannot be written .*: choose another one"):
            write_history(path, STEPS, COMM)
    agree(sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder"])
