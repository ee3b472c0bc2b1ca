# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The history of a load as a table."""

from __future__ import annotations

import csv
from dataclasses import asdict

import pytest
from collective import agree
from played import STEP

from dolfinx_feti.loading import LoadStep, write_history

pytestmark = pytest.mark.serial

STEPS = [
    LoadStep(0.5, 0.5, (STEP,), 0, (), 1.0),
    LoadStep(1.0, 0.5, (STEP, STEP), 1, (STEP,), 2.0),
]


def test_a_row_for_each_newton_step(tmp_path):
    """Those of failed attempts first; each with all that is known of it."""
    path = tmp_path / "history.csv"
    write_history(path, STEPS[:1])
    write_history(path, STEPS)
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
    agree([p.name for p in tmp_path.iterdir()] == ["history.csv"])


def test_no_folder(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_history(tmp_path / "nowhere/history.csv", STEPS)
