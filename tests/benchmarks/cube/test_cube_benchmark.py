# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The benchmark of the cube: its cases are resumed, and its command line is read."""

from __future__ import annotations

import pytest
from collective import COMM, agree
from linear_study import SMALL
from wall_files import on_first

from benchmarks.cube import run as cube
from benchmarks.cube import study
from benchmarks.cube.case import Case


def test_finished_cases_are_not_run_again(study_of, capsys, monkeypatch):
    _, first = study_of(*SMALL, "--level", "1")
    _, second = study_of(*SMALL, "--level", "1,2")
    said = COMM.bcast(capsys.readouterr().out)
    agree("1 case(s) are in the records already" in said, said)
    agree(second[:1] == first and [r["level"] for r in second] == [1, 2])
    with monkeypatch.context() as patched:
        patched.setattr(study, "run", lambda *_: pytest.fail("a finished case was run"))
        status, third = study_of(*SMALL, "--level", "1,2")
    agree(status == 0 and third == second)
    _, again = study_of(*SMALL, "--level", "1", "--again")
    agree(again[1:] == second[1:] and again[0]["condition_number"] is not None)
    agree(again[0]["seconds_solve"] != second[0]["seconds_solve"])


def test_records_are_written_after_each_case(study_of, monkeypatch):
    """Whoever ends a study finds what was finished."""
    real = study.run

    def run(case: Case, *rest: object) -> dict:
        if case.level == 2:
            raise KeyboardInterrupt
        return real(case, *rest)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(study, "run", run)
        study_of(*SMALL, "--level", "1,2")
    _, records = study_of(*SMALL, "--level", "1")
    agree(len(records) == 1)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ("--level 0", "argument --level: '0' would make more subdomains than cells"),
        ("--level 6", "argument --level: '6' is none of: 1, 2, 3, 4, 5"),
        ("--level 1,two", "argument --level: 'two' is none of"),
        ("--degree 3", "argument --degree: '3' is none of: 1, 2"),
        ("--pc ilu", "argument --pc: 'ilu' is none of: dirichlet, lumped, identity"),
        ("--subdomains-per-edge 0", "'0' is not a number 1, 2, 3"),
        ("--source 0.5,0.5,0.5", "'0.5,0.5,0.5' lies in the unit cube"),
        ("--source 1,0,0.2", "lies in the unit cube"),
        ("--source nan,2,2", "'nan,2,2' is not a point X,Y,Z"),
        ("--source 2,2", "'2,2' is not a point X,Y,Z"),
        ("--jump 1e3", "give both, how stiff and which subdomains"),
        ("--jump 0 --pattern layer", "'0' is not a positive number"),
        ("--memory many", "'many' is not a positive number"),
        ("--levels 1", "unrecognized arguments: --levels 1"),
    ],
)
def test_bad_input_ends_before_any_work(arguments, match, capsys, monkeypatch):
    monkeypatch.setattr(cube, "run_all", lambda *_, **__: pytest.fail("work was done"))
    with pytest.raises(SystemExit) as caught:
        cube.main(arguments.split(), COMM)
    agree(caught.value.code == 2)
    said = COMM.bcast(capsys.readouterr().err)
    agree(match in said, said)


@pytest.mark.skipif(COMM.size == 1, reason="one process can have all subdomains")
def test_more_processes_than_subdomains(capsys):
    with pytest.raises(SystemExit):
        cube.main(["--subdomains-per-edge", "1"], COMM)
    said = COMM.bcast(capsys.readouterr().err)
    agree(f"gives 1 subdomain(s) to {COMM.size} processes" in said, said)


def test_file_that_cannot_hold_the_records(tmp_path, capsys, monkeypatch):
    """A folder, a place below a file, and files with something else in them."""
    monkeypatch.setattr(cube, "run_all", lambda *_, **__: pytest.fail("work was done"))

    def write() -> None:
        (tmp_path / "text").write_text("mine")
        (tmp_path / "object").write_text('{"level": 1}')

    on_first(write)
    for name in (".", "text/records.json", "text", "object"):
        with pytest.raises(SystemExit) as caught:
            cube.main(["--json", str(tmp_path / name)], COMM)
        agree(caught.value.code == 2)
        said = COMM.bcast(capsys.readouterr().err)
        agree("cannot be used" in said and "Name another file" in said, said)
    agree(on_first(lambda: (tmp_path / "text").read_text()) == "mine")
