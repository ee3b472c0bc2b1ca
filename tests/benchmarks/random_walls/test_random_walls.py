# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Three random walls to 120 mmHg: a bifurcation, a plaque, openings on springs."""

from __future__ import annotations

import dataclasses
import functools
import json
import re

import pytest
from collective import agree

from benchmarks.random_walls import page, run
from dolfinx_feti import NonlinearProblem
from dolfinx_feti.loading import Steps

pytestmark = pytest.mark.serial


def test_walls_arrive(tmp_path):
    path = tmp_path / "random_walls.json"
    words = ["--seeds", "3", "--json", str(path)]
    first = run.main(words)
    agree(run.main(words) == first == json.loads(path.read_text()))
    agree(all(record["reached"] == run.MMHG and not record["error"] for record in first))
    agree(all(record["newton"] <= run.MOST for record in first))
    text = page.main([str(path), "--output", str(tmp_path)])
    agree("**3 of 3 walls arrive, 3 with at most 80 Newton steps**" in text, text)


def test_wall_that_does_not_arrive(tmp_path, monkeypatch):
    """Too soft for the Newton steps it may take: record and page say where it ended, and why."""
    soft = {"layers": ("media",), "c": (1.0,), "k1": (0.0,), "angles": (30.0,), "plaque": 1.0}
    chance = dataclasses.replace(run.draw(2), **soft)
    monkeypatch.setattr(run, "draw", lambda _seed: chance)
    monkeypatch.setattr(run, "STEPS", Steps(first=2.0, least=2.0, growth=1.0))
    few = functools.partial(NonlinearProblem, petsc_options={"snes_max_it": 6})
    monkeypatch.setattr(run, "NonlinearProblem", few)
    path = tmp_path / "random_walls.json"
    (record,) = run.main(["--seeds", "1", "--json", str(path)])
    said = r"No equilibrium was found beyond a load of 2: .* no convergence within 6 steps"
    agree(record["reached"] == 2.0 and re.match(said, record["error"]), record)
    text = page.main([str(path), "--output", str(tmp_path)])
    agree("**0 of 1 walls arrive" in text and f"- 0: {record['error']}" in text, text)


def test_seeds_draw_all_kinds():
    drawn = [run.draw(seed) for seed in range(20)]
    agree({(chance.branches, chance.sac) for chance in drawn} >= {(2, True), (3, True), (3, False)})
    agree({len(chance.layers) for chance in drawn} == {1, 2, 3})
    agree(max(chance.plaque for chance in drawn) > 300)
    agree(any(all(c.springs) for c in drawn) and any(not any(c.springs) for c in drawn))
