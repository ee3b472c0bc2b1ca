# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Inf-sup constants: one that is known, stable and unstable pairs, and records that are kept."""

from __future__ import annotations

import json

import numpy as np
import pytest
from collective import agree, small

from benchmarks.inf_sup import page, run

pytestmark = pytest.mark.serial


def test_one_displacement():
    """2³ cubes, Q1–P0: a node moves; a pressure ±1 is felt by one component. ∫|∇φ|² = h/3 · 8/3."""
    found = run.constant(run.PAIRS["q1-p0"], 2)
    h = 0.5
    energy = 3 * (2 / h) * (2 * h / 3) ** 2  # ∫|∇φ|² of the node's hat function
    felt = h**2 / 4 * np.sqrt(8)  # ∫ ∂φ/∂x over a cell, times the root of the number of cells
    small(found["beta"] - felt / np.sqrt(energy) / np.sqrt(h**3), 1e-12)
    agree(found["spurious"] == 8 - 1 - 3 and found["displacements"] == 3)


def test_stable_and_unstable_pairs():
    stable, locking = (run.constant(run.PAIRS[name], 2) for name in ("q2-p1d", "p2-p1d"))
    agree(stable["spurious"] == 0 and stable["beta"] > 0.3)
    agree(locking["spurious"] > locking["displacements"])


def test_records_and_their_page(tmp_path):
    path = tmp_path / "inf_sup.json"
    words = ["--pair", "q2-p1d,q1-p0", "--cells", "2", "--json", str(path)]
    first = run.main(words)
    agree(run.main(words) == first == json.loads(path.read_text()))
    text = page.main([str(path), "--output", str(tmp_path)])
    agree("| Q2–P1disc | 0.395 | – | – | 0 |" in text, text)
