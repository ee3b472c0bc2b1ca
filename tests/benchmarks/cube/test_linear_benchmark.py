# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The whole linear study: its plan, how it is resumed, and other solvers on its matrix."""

from __future__ import annotations

import json

import pytest
from collective import COMM, agree, small
from wall_files import on_first

from benchmarks.cube import paper
from benchmarks.cube import plan as linear
from benchmarks.cube import run as cube
from benchmarks.cube.case import Case
from benchmarks.cube.solvers import SOLVERS


def test_plan_holds_the_papers_table_first_and_no_case_twice():
    plan = linear.plan()
    agree(len(plan) == len(set(plan)) > 100)
    agree(set(plan[:18]) == {Case(type=kind, pc=pc, level=level)
                             for kind, pc, level in paper.SOLVES if level < 4})  # fmt: skip
    agree({case.jump for case in plan} == {1.0, 1e2, 1e4, 1e6})
    agree({case.subdomains_per_edge for case in plan} == {2, 4, 8, 16, 32})


def test_whole_study_is_resumed(tmp_path, monkeypatch, capsys):
    cases = [Case(subdomains_per_edge=2, level=level) for level in (1, 2)]
    monkeypatch.setattr(cube, "plan", lambda sets: cases if sets == ["jumps"] else [])
    arguments = ["--sets", "jumps", "--json", str(tmp_path / "study.json")]
    agree(cube.main(arguments, COMM) == 0)
    records = on_first(lambda: json.loads((tmp_path / "study.json").read_text()))
    agree([r["level"] for r in records] == [1, 2])
    agree(all(0.0 < r["seconds_coarse"] < r["seconds_setup"] for r in records), records)
    agree(all(r["coarse_size"] == 48 and r["coarse_mib"] >= 0.0 for r in records))
    agree(cube.main(arguments, COMM) == 0)
    said = COMM.bcast(capsys.readouterr().out)
    agree("2 case(s) are in the records already" in said, said)


def test_solvers_of_the_assembled_matrix_agree_with_feti(tmp_path):
    path = tmp_path / "solvers.json"
    arguments = [
        "--solvers",
        "all",
        "--level",
        "2",
        "--subdomains-per-edge",
        "2",
        "--json",
        str(path),
    ]
    agree(cube.main(arguments, COMM) == 0)
    records = on_first(lambda: json.loads(path.read_text()))
    agree([r["solver"] for r in records] == list(SOLVERS))
    for record in records:
        agree(record["converged_reason"] > 0 and record["dofs"] == 1287, record)
        small(record["relative_residual"], 1e-8)
        small(record.get("difference_to_direct", 0.0), 1e-6)
        agree(record["seconds_setup"] > 0.0 and record["seconds_solve"] > 0.0)
    before = on_first(path.read_text)
    agree(cube.main(arguments, COMM) == 0)
    agree(on_first(path.read_text) == before, "nothing is run again")


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ("--sets jump", "argument --sets: 'jump' is none of: papers, choices, jumps"),
        ("--sets all --memory 0", "argument --memory: '0' is not a positive number"),
        ("--solvers lu", "argument --solvers: 'lu' is none of: feti_all_floating"),
    ],
)
def test_bad_input_of_the_whole_study(arguments, match, capsys, monkeypatch):
    monkeypatch.setattr(Case, "problem", lambda *_: pytest.fail("work was done"))
    with pytest.raises(SystemExit) as caught:
        cube.main(arguments.split(), COMM)
    agree(caught.value.code == 2)
    said = COMM.bcast(capsys.readouterr().err)
    agree(match in said, said)
