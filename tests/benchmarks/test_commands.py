# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The commands of the benchmarks, and the pages of the documentation that they have made."""

from __future__ import annotations

import importlib
import re
import runpy
import sys

import pytest
from wall_files import ROOT

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.serial

STUDIES = sorted(path.parent.name for path in (ROOT / "benchmarks").glob("*/run.py"))
PAGES = [ROOT / "Makefile", ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
RESULTS = ROOT / "docs/results"

#: Studies, and the files of their pages.
MADE = {
    "cube": ("linear", "linear.json", "solvers.json"),
    "compare": ("speed", "speed.json"),
    "nonlinear": ("nonlinear", "nonlinear.json"),
    "tube": ("tube", "tube.json"),
    "scaling": ("scaling", "scaling.json"),
    "load_stepping": ("loading", "loading.json"),
    "subdomains": ("subdomains", "subdomains.json"),
    "inf_sup": ("inf_sup", "inf_sup.json"),
    "published": ("published", "published.json"),
    "random_walls": ("random_walls", "random_walls.json"),
}


@pytest.mark.parametrize("name", STUDIES)
def test_command_explains_itself(name, monkeypatch, capsys):
    """As ``python3 -m benchmarks.compare --help`` and ``python3 benchmarks/compare --help``."""
    folder = str(ROOT / "benchmarks" / name)
    monkeypatch.setattr(sys, "argv", [folder, "--help"])
    for run, what in ((runpy.run_module, f"benchmarks.{name}"), (runpy.run_path, folder)):
        with pytest.raises(SystemExit) as caught:
            run(what, run_name="__main__")
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
        assert re.search(r"[.:] \(\d+ cases", line), line


@pytest.mark.parametrize("name", STUDIES)
def test_page_explains_itself(name, capsys):
    page = importlib.import_module(f"benchmarks.{name}.page")
    with pytest.raises(SystemExit) as caught:
        page.main(["--help"])
    said = capsys.readouterr().out
    assert caught.value.code == 0
    assert said.startswith(f"usage: benchmarks.{name}.page ")
    assert "--output" in said


def test_commands_that_are_documented_exist():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    named = re.findall(r"-m\s+benchmarks\.(\w+(?:\.\w+)?)", text)
    modules = {f"benchmarks.{name}" for name in named}
    assert modules >= {f"benchmarks.{name}" for name in STUDIES}
    assert not [name for name in modules if importlib.util.find_spec(name) is None]
    files = re.findall(r"(?<!tests/)(?:benchmarks|demos|meshes)/\w+(?:/\w+)*\.py", text)
    assert not [name for name in set(files) if not (ROOT / name).is_file()]


@pytest.mark.parametrize("name", MADE)
def test_page_of_the_documentation_is_that_of_its_records(name, tmp_path):
    """So is each table: no number is there without a record, nor a record of another schema."""
    page, *records = MADE[name]
    module = importlib.import_module(f"benchmarks.{name}.page")
    module.main([*(str(RESULTS / file) for file in records), "--output", str(tmp_path)])
    made = {path.relative_to(tmp_path) for path in tmp_path.rglob(f"{page}*.[cm]*")}
    there = {path.relative_to(RESULTS) for path in RESULTS.rglob(f"{page}*.[cm]*")}
    assert made == there
    for path in made:
        assert (tmp_path / path).read_text() == (RESULTS / path).read_text(), path
