# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The benchmark of the nonlinear study: its records, what it refuses, its page."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from collective import COMM, agree, equal
from nonlinear_study import EVERYTHING
from wall_files import on_first

from benchmarks.nonlinear import page as nonlinear_page
from benchmarks.nonlinear import run as nonlinear

pytest.importorskip("gmsh")
pytest.importorskip("matplotlib")

SMALL = "--geometry tube --size 1 --subdomains 4 --kappa 10 --layers 1 --pc lumped".split()


def run(tmp_path: Path, *words: str) -> list[dict]:
    """Run the benchmark; return all records in its file."""
    place = ["--json", str(tmp_path / "nonlinear.json"), "--folder", str(tmp_path / "walls")]
    agree(nonlinear.main([*SMALL, *place, *words]) == 0)
    return on_first(lambda: json.loads((tmp_path / "nonlinear.json").read_text()))


def test_both_variants_with_both_choices(tmp_path, capsys):
    """They come to the same state; what is there is not run again."""
    records = run(tmp_path)
    agree(len(records) == 4, len(records))
    for record in records:
        its = record["linear_iterations_per_newton"]
        agree(len(its) == record["newton_iterations"] >= 2 and min(its) > 0, its)
        agree(record["min_J"] <= record["mean_J"] <= record["max_J"])
        agree(record["seconds_setup_per_newton"] > 0 and record["seconds_krylov_per_newton"] > 0)
        agree(record["multipliers"] > 0 and record["dofs"] > 0)
    for choices in ("paper", "default"):
        one, other = (r["min_J"] for r in records if r["choices"] == choices)
        equal(one, other, 1e-6)
    capsys.readouterr()
    agree(run(tmp_path) == records)
    said = COMM.bcast(capsys.readouterr().out)
    agree("4 case(s) are in the records already" in said, said)


@pytest.mark.serial
def test_iterations_are_cut_off_and_allowed_later(tmp_path):
    words = ["--type", "classical", "--choices", "default"]
    (first,) = run(tmp_path, *words, "--most-iterations", "2")
    agree(first["iterations_exceed"] == 2 and "failure" not in first, first)
    agree(run(tmp_path, *words, "--most-iterations", "2") == [first])
    (second,) = run(tmp_path, *words)
    agree("iterations_exceed" not in second and second["newton_iterations"] >= 2, second)


def test_papers_tangent_lets_cg_solve(tmp_path):
    (record,) = run(tmp_path, "--choices", "paper", "--type", "classical")
    agree("failure" not in record and set(record["linear_methods"]) == {"cg"}, record)
    agree(record["clock"] == ("processor" if COMM.size == 1 else "wall"), record)


def test_file_of_another_study_is_refused(tmp_path, capsys):
    path = tmp_path / "other.json"
    on_first(lambda: path.write_text('[{"solver": "mumps"}]'))
    with pytest.raises(SystemExit) as caught:
        nonlinear.main(["--json", str(path), "--folder", str(tmp_path / "walls")])
    agree(caught.value.code == 2)
    said = COMM.bcast(capsys.readouterr().err)
    agree("holds records of another study" in said, said)
    agree(on_first(lambda: not (tmp_path / "walls").exists()))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--geometry", "cube"], "invalid choice"),
        (["--degree", "3"], "none of"),
        (["--kappa", "10,-1"], "not a positive number"),
        (["--pc", "ilu"], "none of"),
        (["--layers", "3"], "none of"),
        (["--most-iterations", "0"], "not a number 1"),
        (["--json", "/dev/null/x.json"], "cannot be used"),
    ],
)
def test_bad_words(words, said, capsys):
    with pytest.raises(SystemExit) as caught:
        nonlinear.main(words)
    agree(caught.value.code == 2)
    text = COMM.bcast(capsys.readouterr().err)
    agree(said in text, text)


def test_too_many_subdomains(tmp_path, capsys):
    with pytest.raises(SystemExit) as caught:
        run(tmp_path, "--subdomains", "100000")
    agree(caught.value.code == 2)
    text = COMM.bcast(capsys.readouterr().err)
    agree("100000" in text, text)


@pytest.mark.serial
def test_page_of_the_papers_own_records(tmp_path):
    """Tables show the paper's numbers twice."""
    (tmp_path / "records.json").write_text(json.dumps(EVERYTHING))
    page = nonlinear_page.main([str(tmp_path / "records.json"), "--output", str(tmp_path)])
    assert "| all-floating | 1000 | dirichlet | 209 | 31.8 | 209 | 209 209 |" in page
    assert "| > 10 000 | – | > 10 000 | – | – | – |" in page
