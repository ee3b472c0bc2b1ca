# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The commands of the benchmarks, and the pages of the documentation that they have made."""

from __future__ import annotations

import importlib
import json
import re
import runpy
import sys

import numpy as np
import pytest
from wall_files import ROOT

from benchmarks import compare, edit
from benchmarks.common.compare import tables
from benchmarks.common.pages import missing_fields
from benchmarks.common.records import describe_machine

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.serial

STUDIES = sorted(path.stem for path in (ROOT / "benchmarks").glob("[a-z]*.py"))
PAGES = [ROOT / "Makefile", ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
RESULTS = ROOT / "docs/results"
MADE = sorted(path.stem for path in (ROOT / "benchmarks").glob("*.md"))


@pytest.mark.filterwarnings("ignore:.*found in sys.modules")
@pytest.mark.parametrize("name", STUDIES)
def test_command_explains_itself(name, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit) as caught:
        runpy.run_module(f"benchmarks.{name}", run_name="__main__")
    said = capsys.readouterr().out
    assert caught.value.code == 0
    assert said.startswith(f"usage: {name} ")
    assert "--json" in said


def test_studies_are_listed(capsys):
    runpy.run_module("benchmarks", run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(STUDIES)
    for name, line in zip(STUDIES, lines, strict=True):
        assert line.startswith(f"python3 -m benchmarks.{name} ")
        if name in MADE:
            assert re.search(r"\. \(\d+ cases", line), line


def test_commands_that_are_documented_exist():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    named = re.findall(r"-m\s+benchmarks\.(\w+)", text)
    assert {name for name in STUDIES if name in MADE} <= set(named)
    files = re.findall(r"(?<!tests/)(?:benchmarks|demos|meshes)/\w+(?:/\w+)*\.py", text)
    assert not [name for name in set(files) if not (ROOT / name).is_file()]


@pytest.mark.parametrize("name", MADE)
def test_page_of_the_documentation_is_that_of_its_records(name, tmp_path):
    """Each number on it has a record, and no record has another schema."""
    study = importlib.import_module(f"benchmarks.{name}").STUDY
    study.main(["--page", str(tmp_path), "--json", str(RESULTS / f"{study.page}.json")])
    made = {path.relative_to(tmp_path) for path in tmp_path.rglob(f"{study.page}*.[cm]*")}
    there = {path.relative_to(RESULTS) for path in RESULTS.rglob(f"{study.page}*.[cm]*")}
    assert made == there
    for path in made:
        assert (tmp_path / path).read_text() == (RESULTS / path).read_text(), path


@pytest.mark.parametrize("name", MADE)
def test_each_field_of_a_template_has_a_value(name, tmp_path):
    """A field whose name is misspelt would be a column of dashes."""
    study = importlib.import_module(f"benchmarks.{name}").STUDY
    records = json.loads((RESULTS / f"{study.page}.json").read_text())
    assert missing_fields(study.template, study.page_fields(records, tmp_path)) == set()


@pytest.mark.parametrize("name", MADE)
def test_page_of_some_records(name, tmp_path):
    """If a file has one kind of case only, the page leaves out the sections of the others."""
    study = importlib.import_module(f"benchmarks.{name}").STUDY
    whole = (RESULTS / f"{study.page}.md").read_text().count("\n## ")
    records = json.loads((RESULTS / f"{study.page}.json").read_text())
    for record in {tuple(record): record for record in records}.values():
        (tmp_path / "some.json").write_text(json.dumps([record]))
        page = study.write_page([tmp_path / "some.json"], tmp_path)
        assert "| None |" not in page and page.count("\n## ") <= whole


def test_figure_leaves_out_a_route_without_a_record(tmp_path, monkeypatch):
    """It has no bar, not one of 0 s."""
    drawn = []
    monkeypatch.setattr("matplotlib.axes.Axes.barh", lambda _, at, s, *__, **___: drawn.append(s))
    edit.STUDY.draw([{"material": "HGO", "given": "dolfinx", "first": 2.0, "again": 1.0}], tmp_path)
    np.testing.assert_array_equal(drawn, np.transpose([[2.0, np.nan, np.nan, 1.0, np.nan, np.nan]]))


def test_ratios_are_those_of_the_faster_layouts(tmp_path):
    """FETI: 2 s on two processes; MUMPS: 4 s on two, 2.5 s on threads; the page has the faster."""
    case = {"geometry": "tube", "kappa": 1000.0, "degree": 2, "dofs": 60_000, "subdomains": 32}
    case |= dict.fromkeys(("path_mmhg", "loaded_mmhg", "wanted_subdomains"))
    case |= {"wanted_dofs": 60_000, "relative_residual": 3e-9, "iterations": 1}
    case |= {"converged": True, "note": ""}
    case |= {"machine": describe_machine(), "date": "2026-01-02T03:04:05+00:00"}
    records = [
        case
        | {"processes": P, "threads": 3 - P, "solver": solver, "peak_mib": mib}
        | {"seconds_setup": setup, "seconds_solve": solve}
        for solver, P, setup, solve, mib in (
            ("feti", 2, 1.5, 0.5, 300.0),
            ("feti", 1, 2.0, 1.0, 250.0),
            ("mumps", 2, 3.9, 0.1, 400.0),
            ("mumps", 1, 2.4, 0.1, 200.0),
        )
    ]
    (tmp_path / "records.json").write_text(json.dumps(records))
    page = compare.STUDY.write_page([tmp_path / "records.json"], tmp_path)
    first = "**1 process × 2 threads** | 2.40 | 0.10"
    second = "2 processes | 3.90 | 0.10"
    assert f"| MUMPS | {first} | 2.50 | 1 | 200 | 3e-9 | 0.80 | 1.50 |" in page
    assert f"| MUMPS | {second} | 4.00 | 1 | 400 | 3e-9 | 0.50 | 0.75 |" in page
    assert "| 32 | FETI | **2 processes** | 1.50 | 0.50 | 2.00 | 1 | 300 | 3e-9 | – | – |" in page


def test_figure_shows_the_fastest_of_plain_first_steps(tmp_path):
    """It leaves out paths, other κ, and numbers of subdomains that a command line chose."""
    plain = {"geometry": "tube", "kappa": 1000.0, "degree": 2, "dofs": 60_000, "converged": True}
    times = {"seconds_setup": 1.0, "seconds_solve": 0.0}
    records = [
        plain | times | {"solver": "mumps", "seconds_setup": 4.0},
        plain | times | {"solver": "pardiso", "seconds_setup": 3.0, "seconds_solve": 0.5},
        plain | times | {"solver": "mumps", "dofs": 100, "seconds_setup": 0.5},
    ]
    for special in (
        {"wanted_subdomains": 7},
        {"per": 2000},
        {"kappa": 10.0},
        {"path_mmhg": 10.0},
        {"loaded_mmhg": 10.0},
        {"degree": 1},
        {"converged": False},
    ):
        records.append(plain | times | {"solver": "cholmod"} | special)
    direct = ("mumps", "cholmod", "pardiso")
    assert tables.points(records, "tube", direct) == [(100, 0.5), (60_000, 3.5)]
    assert tables.points(records, "block", direct) == []
    tables.draw(records, tmp_path / "speed.png")
    assert (tmp_path / "speed.png").stat().st_size > 10_000
